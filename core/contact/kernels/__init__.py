"""Compiled loops over pixels, and the vector values that they are made of."""
