"""Opening a source: the dialogs *Open…* and *Create rig…*, the cameras and their settings."""
