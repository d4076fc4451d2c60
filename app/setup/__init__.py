"""Setting up a rig: cameras or a recording, untouched frame, alignment, noise."""
