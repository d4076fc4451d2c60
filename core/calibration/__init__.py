"""Calibration: pairs of clicked points in, an alignment and an honest statement of its quality out.

`calibrate` is the main entry: it fits both models, cross-validates them and recommends one. The other
modules are the steps that lead there (`correspondences`, `detect`, `texture`, `snapshots`) and back
(`recheck`).
"""

from .calibrate import calibrate
from .correspondences import Correspondence, read_points, write_points
from .report import CalibrationReport

__all__ = ["CalibrationReport", "Correspondence", "calibrate", "read_points", "write_points"]
