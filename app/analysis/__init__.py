"""The window that judges contact patches: tilt, pose, search."""
