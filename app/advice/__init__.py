"""Suggestions for the preset, shown with their evidence, and the examples of contact that they are made from."""
