"""What a robot reads from a patch: its tilt, and the pose of a known object."""
