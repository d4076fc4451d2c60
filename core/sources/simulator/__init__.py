"""A simulated sensor with ground truth."""
