"""Calibration: from clicked pairs of points to an alignment and a statement of its quality."""

from .calibrate import calibrate
from .points import read_points, write_points
from .report import CalibrationReport

__all__ = ["CalibrationReport", "calibrate", "read_points", "write_points"]
