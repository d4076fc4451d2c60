"""Reading, processing and recording frames on threads beside the window."""
