"""The calibration wizard: frames, points, helpers, model, quality, check."""
