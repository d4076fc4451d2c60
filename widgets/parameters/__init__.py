"""Editors of preset fields."""
