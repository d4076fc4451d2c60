"""Membrane strain from a grid of printed dots."""
