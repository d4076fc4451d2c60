"""Suggestions for the preset, shown with their evidence."""
