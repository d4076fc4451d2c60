"""Live cameras in the window: which ones, and how they are set."""
