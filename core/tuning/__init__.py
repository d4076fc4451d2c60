"""Runs with many presets over many recordings and scenes, and which of them was best."""
