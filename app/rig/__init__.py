"""Windows about the rig: camera checks, and capture of the untouched frame."""
