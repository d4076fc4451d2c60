"""The document: the preset being edited, its history and its recovery after a crash."""
