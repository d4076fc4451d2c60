"""The pose of an object or of its scan in the proximity frame: from point pairs, and in a file."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from ..errors import CalibrationError, SourceError
from ..estimation.pose_files import read_text
from ..model.arrays import Float64Array
from ..model.files import atomic_path
from ..model.frames import Matrix4, rigid_transform

_MIN_PAIRS: Final = 3
#: Points count as collinear if their spread across the line is below this share of the spread along it.
_ON_A_LINE: Final = 0.02
#: Points within this distance count as coincident, metres.
_ONE_PLACE_M: Final = 1e-4
#: Size ratio between object and patch beyond which the unit must be wrong.
_OTHER_UNIT: Final = 3.0
HEADER: Final = ("scan_x", "scan_y", "scan_z", "patch_x_m", "patch_y_m", "patch_z_m")


def pose_from_pairs(object_points: npt.ArrayLike, patch_points: npt.ArrayLike) -> Matrix4:
    """Fit ``T_proximity_object`` to corresponding points, (N, 3) in metres each, by least squares (Kabsch 1976)."""
    mesh, patch = np.asarray(object_points, np.float64), np.asarray(patch_points, np.float64)
    if mesh.shape != patch.shape or mesh.ndim != 2 or len(mesh) < _MIN_PAIRS:
        raise CalibrationError(f"a pose needs at least {_MIN_PAIRS} pairs of points, not {len(mesh)}; pick more")
    if not (np.isfinite(mesh).all() and np.isfinite(patch).all()):
        raise CalibrationError("a picked point is nan or infinite; pick it again")
    spreads = []
    for points, where in ((mesh, "object"), (patch, "patch")):
        along, across, _ = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) / math.sqrt(len(points))
        if along < _ONE_PLACE_M:
            raise CalibrationError(f"the points on the {where} all lie at one place; pick some that are far apart")
        if across < _ON_A_LINE * along:
            raise CalibrationError(
                f"the points on the {where} lie on one line, which leaves a rotation open; pick one beside it"
            )
        spreads.append(along)
    ratio = spreads[0] / spreads[1]
    if not 1 / _OTHER_UNIT < ratio < _OTHER_UNIT:
        raise CalibrationError(
            f"the points lie {ratio:.3g} times as far apart on the object as on the patch; check the object's unit"
        )
    return fit_pose(mesh, patch)


def fit_pose(points: Float64Array, targets: Float64Array) -> Matrix4:
    """Return the pose that takes points to targets, (N, 3) each, with the least squared distance."""
    start, end = points.mean(axis=0), targets.mean(axis=0)
    rotation, _ = Rotation.align_vectors(targets - end, points - start)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation.as_matrix(), end - rotation.apply(start)
    return rigid_transform(matrix)


def transformed(pose: Matrix4, points: npt.ArrayLike) -> Float64Array:
    """Transform points, (N, 3), by a pose."""
    matrix = np.asarray(pose)
    return np.asarray(np.asarray(points, np.float64).reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3])


def save_transform(path: Path | str, pose: Matrix4) -> None:
    """Write a pose as JSON, ``{"T_proximity_scan": 4 x 4}``, atomically; raises `ExportError`."""
    rows = ",\n    ".join(json.dumps(row) for row in rigid_transform(pose))
    with atomic_path(path) as temporary:
        temporary.write_text(f'{{\n  "T_proximity_scan": [\n    {rows}\n  ]\n}}\n', encoding="utf-8")


def read_pairs(path: Path | str, unit_m: float = 1.0) -> tuple[Float64Array, Float64Array]:
    """Read point pairs for `pose_from_pairs` from a CSV file with the columns of `HEADER`.

    A line is a point in the object's frame and unit, as a mesh viewer shows it, and the same point in the proximity
    depth frame in metres. Returns both in metres, (N, 3) each.
    """
    text = read_text(path)
    try:
        rows = [row for row in csv.reader(text.splitlines()) if any(word.strip() for word in row)]
    except csv.Error as error:
        raise SourceError(f"{path} is no table of point pairs ({error}); each line is six numbers") from error
    if not rows or tuple(word.strip() for word in rows[0]) != HEADER:
        raise SourceError(f"{path} lacks the header {','.join(HEADER)}; put it into the first line")
    try:
        table = np.array(rows[1:], np.float64).reshape(-1, len(HEADER))
    except ValueError as error:
        raise SourceError(f"{path} has a line that is no pair; each is six numbers") from error
    if not np.isfinite(table).all():
        raise SourceError(f"{path} has a number that is not finite; each line is six finite numbers")
    return table[:, :3] * unit_m, table[:, 3:]
