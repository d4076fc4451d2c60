"""Painted 3D scans of the object as ground truth."""
