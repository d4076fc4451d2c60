"""Parameter sweeps: run many presets on many recordings and scenes, and rank them."""
