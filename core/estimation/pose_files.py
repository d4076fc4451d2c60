"""Tracked poses as a table in a CSV file."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

from ..errors import ExportError, TactuneError
from ..model.files import atomic_path
from .pose import PoseError, PoseEstimate

Record = dict[str, Any]

AXES: Final = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")
_QUATERNION: Final = ("qx", "qy", "qz", "qw")
_ERRORS: Final = ("position_error_mm", "angle_error_deg")


def pose_record(pose: PoseEstimate, error: PoseError | None = None) -> Record:
    """Return one frame as a line of a table; unknown values are empty."""
    matrix = pose.T_proximity_object
    quaternion = Rotation.from_matrix(matrix[:3, :3]).as_quat()
    record: Record = {"sequence": pose.sequence, "time_s": pose.time_s, "lost": int(pose.lost)}
    record |= dict(zip((*AXES[:3], *_QUATERNION), [*matrix[:3, 3].tolist(), *quaternion.tolist()], strict=True))
    sigmas = np.sqrt(np.diag(pose.covariance)).tolist()
    record |= {f"sigma_{key}": value for key, value in zip(AXES, sigmas, strict=True)}
    record["free"] = pose.free
    record["residual_mm"] = round(1e3 * pose.residual_m, 4) if math.isfinite(pose.residual_m) else ""
    record["overlap"] = round(pose.overlap, 4)
    if error is None:
        return record | dict.fromkeys(_ERRORS, "")
    errors = (1e3 * error.position_m, math.degrees(error.angle_rad))
    return record | {key: round(value, 4) for key, value in zip(_ERRORS, errors, strict=True)}


@contextmanager
def open_poses(path: Path) -> Iterator[Callable[[Mapping[str, Any]], None]]:
    """Yield a function that writes a record of `pose_record` into a CSV file, which gets its name when this ends.

    After a `TactuneError`, such as of an unplugged camera, the poses until then are kept.
    """
    rows, known = 0, False
    failure: TactuneError | None = None
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")

        def write(record: Mapping[str, Any]) -> None:
            nonlocal rows, known
            table.writerows([record.values()] if rows else [record, record.values()])
            rows, known = rows + 1, known or not record["lost"]

        try:
            yield write
        except TactuneError as error:
            if not known:
                raise
            failure = error
        if not rows:
            raise ExportError(f"the object was in no frame, so {path} would be empty")
    if failure is not None:
        raise failure
