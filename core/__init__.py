"""The headless core: presets, the contact pipeline, sources. Never imports Qt or OpenGL."""
