"""Opening a source: the dialog *Open…*, topics of a recording, the rig of a folder, cameras and their settings."""
