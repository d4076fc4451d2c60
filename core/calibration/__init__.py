"""Calibration: from clicked pairs of points to an alignment and a statement of its quality."""
