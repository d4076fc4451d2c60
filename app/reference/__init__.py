"""The preset's reference in the window: captured, kept until the preset is saved, recorded along."""
