"""Windows about the rig: camera checks, and the untouched membrane as the preset's reference."""
