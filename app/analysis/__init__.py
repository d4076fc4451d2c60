"""The window that judges contact patches: methods side by side, ground truth, strain."""
