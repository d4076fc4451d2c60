"""Presets shipped with Tactune, and their JSON Schema."""
