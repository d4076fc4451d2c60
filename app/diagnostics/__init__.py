"""The window that checks the cameras: quality, skew, interference."""
