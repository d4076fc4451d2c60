"""Calibration: from clicked correspondences to an alignment and a statement of its quality.

`calibrate` is the main entry: it fits both models, cross-validates them and recommends one. Correspondences come from
clicks (`correspondences`), targets (`detect`) or texture (`texture`) on averaged frames (`snapshots`). `recheck` tests
whether an older calibration still holds.
"""

from .calibrate import calibrate
from .correspondences import Correspondence, read_points, write_points
from .report import CalibrationReport

__all__ = ["CalibrationReport", "Correspondence", "calibrate", "read_points", "write_points"]
