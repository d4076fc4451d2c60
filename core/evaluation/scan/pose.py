"""The scan's pose in the proximity frame: fitted to point pairs, refined by ICP, kept in a file."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from ...errors import CalibrationError, SourceError
from ...model.arrays import Float64Array, IndexArray
from ...model.files import atomic_path, user_path
from ...model.frames import Matrix4, rigid_transform
from ...model.loading import parse_json, read_file

_MIN_PAIRS: Final = 3
#: Iterations of ICP, at most.
ICP_ROUNDS: Final = 300
#: Points count as collinear if their spread across the line is below this share of the spread along it.
_ON_A_LINE: Final = 0.02
#: Points within this distance count as coincident, metres.
_ONE_PLACE_M: Final = 1e-4
#: Size ratio between scan and patch beyond which the unit must be wrong.
_OTHER_UNIT: Final = 3.0
#: ICP uses at most this many points of each cloud, every n-th.
_ICP_POINTS: Final = 20_000
#: ICP has converged if no point moves farther than this in an iteration, metres.
_CONVERGED_M: Final = 1e-7
_FILE_BYTES: Final = 100_000

#: Called with the number of iterations and the RMSE in metres; returns False to stop.
GoOn = Callable[[int, float], bool]
HEADER: Final = ("scan_x", "scan_y", "scan_z", "patch_x_m", "patch_y_m", "patch_z_m")
_PAIRS_FILE_BYTES: Final = 10_000_000


def pose_from_pairs(scan_points: npt.ArrayLike, patch_points: npt.ArrayLike) -> Matrix4:
    """Fit the scan's pose to picked point pairs by least squares, without scale.

    Kabsch (1976); the same as Umeyama (1991) with scale 1.

    Parameters
    ----------
    scan_points, patch_points : array_like, shape (N, 3), N >= 3
        Corresponding points on the scan (scan frame) and on the patch (proximity frame), metres.

    Returns
    -------
    4 x 4 nested tuples
        ``T_proximity_scan``.

    Raises
    ------
    CalibrationError
        There are fewer than three pairs, the points coincide or are collinear, or the unit is wrong.
    """
    scan, patch = _pairs(scan_points, patch_points)
    for points, name in ((scan, "on the scan"), (patch, "on the patch")):
        _check_spread(points, name)
    ratio = _spread(scan)[0] / _spread(patch)[0]
    if not 1 / _OTHER_UNIT < ratio < _OTHER_UNIT:
        raise CalibrationError(
            f"the points lie {ratio:.3g} times as far apart on the scan as on the patch; check the scan's unit"
        )
    rotation, _ = Rotation.align_vectors(patch - patch.mean(axis=0), scan - scan.mean(axis=0))
    return _pose(rotation, patch.mean(axis=0) - rotation.apply(scan.mean(axis=0)))


def pair_errors_m(pose: Matrix4, scan_points: npt.ArrayLike, patch_points: npt.ArrayLike) -> Float64Array:
    """Return the distance between the points of each pair under a pose, metres, shape (N,)."""
    apart = transformed(pose, scan_points) - np.asarray(patch_points, np.float64).reshape(-1, 3)
    return np.asarray(np.linalg.norm(apart, axis=1))


def transformed(pose: Matrix4, points: npt.ArrayLike) -> Float64Array:
    """Transform points, (N, 3), from the scan's frame to the proximity frame."""
    matrix = np.asarray(pose)
    return np.asarray(np.asarray(points, np.float64).reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3])


@dataclass(frozen=True)
class RefinedPose:
    """Result of ICP.

    Attributes
    ----------
    T_proximity_scan : 4 x 4
    rmse_m : float
        Root mean square distance of the pairs used, under this pose.
    pairs : int
        Number of pairs used.
    iterations : int
    converged : bool
        False if the iterations ran out or the callback stopped them.
    """

    T_proximity_scan: Matrix4
    rmse_m: float
    pairs: int
    iterations: int
    converged: bool


def refine_pose(
    contact_points: npt.ArrayLike,
    patch_points: npt.ArrayLike,
    start: Matrix4,
    *,
    both_ways: bool = True,
    farthest_m: float = 0.010,
    most_iterations: int = ICP_ROUNDS,
    go_on: GoOn | None = None,
) -> RefinedPose:
    """Refine a pose by ICP, point to point (Besl and McKay 1992).

    Each contact point is paired with the nearest patch point, and each patch point with the nearest contact point.
    Contact is smooth, so mainly its outline determines the lateral position. If one cloud lies within the other, only
    the pairs that start at the larger cloud show the offset. On the simulator's cup and cube at medium press, initial
    errors of 1 to 28 mm end at 0.7 to 0.9 mm; with pairs in one direction only, at 0.7 to 2.0 mm.

    Parameters
    ----------
    contact_points : array_like, shape (K, 3)
        Contact on the scan, in the scan's frame, metres.
    patch_points : array_like, shape (N, 3)
        Patch in the proximity frame, metres.
    start : 4 x 4
        Initial ``T_proximity_scan``, such as from `pose_from_pairs`.
    both_ways : bool
        False pairs contact points with patch points only; for a patch that extends far beyond the scan.
    farthest_m : float
        Maximum distance of a pair, metres; should exceed the initial error.
    most_iterations : int
    go_on : callable, optional
        Called before each iteration with the number of iterations done and the RMSE in metres; False stops.

    Raises
    ------
    CalibrationError
        A cloud is too small, the clouds are out of reach of each other, or a parameter is out of range.
    ValueError
        ``start`` is no rigid transform.
    """
    if not (farthest_m > 0 and most_iterations >= 1):
        raise CalibrationError(
            f"ICP needs a reach above 0 m and at least one iteration; got {farthest_m}, {most_iterations}"
        )
    contact, patch = _thinned(contact_points, "the scan's contact"), _thinned(patch_points, "the patch")
    pairing = _Pairing(contact, patch, both_ways, farthest_m)
    pose, shift, iteration = rigid_transform(start), math.inf, 0
    while True:
        pairs = pairing.nearest(pose)
        if shift < _CONVERGED_M or iteration == most_iterations or (go_on and not go_on(iteration, pairs.rmse_m)):
            return RefinedPose(pose, pairs.rmse_m, len(pairs.contact), iteration, shift < _CONVERGED_M)
        better = _best_pose(pairs)
        shift = float(np.abs(transformed(better, contact) - transformed(pose, contact)).max())
        pose, iteration = better, iteration + 1


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Paired points, (N, 3) each, and their RMSE."""

    contact: Float64Array
    patch: Float64Array
    rmse_m: float


class _Pairing:
    """Pairs the points of two clouds under a pose."""

    def __init__(self, contact: Float64Array, patch: Float64Array, both_ways: bool, farthest_m: float) -> None:
        self._contact, self._patch = contact, patch
        self._contact_tree, self._patch_tree = cKDTree(contact), cKDTree(patch)
        self._both_ways, self._farthest_m = both_ways, farthest_m

    def nearest(self, pose: Matrix4) -> _Pairs:
        """Pair the points within reach."""
        used, nearest, distances = self._one_way(self._patch_tree, transformed(pose, self._contact))
        contact, patch = self._contact[used], self._patch[nearest]
        if self._both_ways:
            back = rigid_transform(np.linalg.inv(pose))
            used, nearest, apart = self._one_way(self._contact_tree, transformed(back, self._patch))
            contact = np.concatenate([contact, self._contact[nearest]])
            patch = np.concatenate([patch, self._patch[used]])
            distances = np.concatenate([distances, apart])
        if len(distances) < _MIN_PAIRS:
            raise CalibrationError(
                f"the scan's contact is nowhere within {1e3 * self._farthest_m:g} mm of the patch; "
                "align it better by hand first"
            )
        return _Pairs(contact, patch, math.sqrt(float(np.mean(distances**2))))

    def _one_way(self, tree: cKDTree, points: Float64Array) -> tuple[IndexArray, IndexArray, Float64Array]:
        """Return indices of the points within reach of the tree, of their nearest neighbours, and the distances."""
        found = tree.query(points, distance_upper_bound=self._farthest_m)
        distances, nearest = np.asarray(found[0], np.float64), np.asarray(found[1], np.intp)
        used = np.flatnonzero(np.isfinite(distances))
        return used, nearest[used], distances[used]


def _best_pose(pairs: _Pairs) -> Matrix4:
    if _spread(pairs.contact)[1] < _ONE_PLACE_M / 10:
        raise CalibrationError("the contact within reach of the patch is collinear; align it better by hand first")
    contact, patch = pairs.contact.mean(axis=0), pairs.patch.mean(axis=0)
    rotation, _ = Rotation.align_vectors(pairs.patch - patch, pairs.contact - contact)
    return _pose(rotation, patch - rotation.apply(contact))


def save_transform(path: Path | str, pose: Matrix4) -> None:
    """Write a pose as JSON, ``{"T_proximity_scan": 4 x 4}``, atomically.

    Raises
    ------
    ExportError
        The file cannot be written.
    """
    rows = ",\n    ".join(json.dumps(row) for row in rigid_transform(pose))
    with atomic_path(path) as temporary:
        temporary.write_text(f'{{\n  "T_proximity_scan": [\n    {rows}\n  ]\n}}\n', encoding="utf-8")


def load_transform(path: Path | str) -> Matrix4:
    """Read a pose from a file of `save_transform`, or from four lines of four numbers.

    Raises
    ------
    SourceError
        The file cannot be read or holds no rigid transform in metres.
    """
    path = user_path(path)
    try:
        return rigid_transform(_matrix(read_file(path, _FILE_BYTES).decode("utf-8")))
    except OSError as error:
        raise SourceError(f"cannot read {path}: {error.strerror or error}; check the path") from error
    except (ValueError, TypeError) as error:
        detail = " ".join(str(error).split())
        raise SourceError(
            f'{path} holds no pose of a scan ({detail}); it is JSON {{"T_proximity_scan": 4 x 4}} or '
            "four lines of four numbers, metres"
        ) from error


def _matrix(text: str) -> object:
    if text.lstrip().startswith("{"):
        found = parse_json(text)
        if found.keys() != {"T_proximity_scan"}:
            raise ValueError(f"its keys are {sorted(found)}")
        return found["T_proximity_scan"]
    rows = [_row(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    if [len(row) for row in rows] != [4, 4, 4, 4]:
        raise ValueError("it is not four lines of four numbers")
    return rows


def _row(number: int, line: str) -> list[float]:
    try:
        return [float(word) for word in line.replace(",", " ").split()]
    except ValueError as error:
        raise ValueError(f"line {number} is {line.strip()[:80]!r}, not four numbers") from error


def _pose(rotation: Rotation, translation: Float64Array) -> Matrix4:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation.as_matrix(), translation
    try:
        return rigid_transform(matrix)
    except ValueError as error:
        raise CalibrationError(f"the points give no pose: {error}; check the units") from error


def _pairs(scan_points: npt.ArrayLike, patch_points: npt.ArrayLike) -> tuple[Float64Array, Float64Array]:
    scan, patch = np.asarray(scan_points, np.float64), np.asarray(patch_points, np.float64)
    if scan.shape != patch.shape or scan.ndim != 2 or scan.shape[1] != 3:
        raise CalibrationError(
            f"points on the scan {scan.shape} and on the patch {patch.shape} make no pairs; give (N, 3)"
        )
    if len(scan) < _MIN_PAIRS:
        raise CalibrationError(f"a pose needs at least {_MIN_PAIRS} pairs of points, not {len(scan)}; pick more")
    if not (np.isfinite(scan).all() and np.isfinite(patch).all()):
        raise CalibrationError("a picked point is nan or infinite; pick it again")
    return scan, patch


def _check_spread(points: Float64Array, where: str) -> None:
    along, across = _spread(points)
    if along < _ONE_PLACE_M:
        raise CalibrationError(f"the points {where} all lie at one place; pick some that are far apart")
    if across < _ON_A_LINE * along:
        raise CalibrationError(f"the points {where} lie on one line, which leaves a rotation open; pick one beside it")


def _spread(points: Float64Array) -> tuple[float, float]:
    """Return the RMS extent along the first and along the second principal direction."""
    values = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) / math.sqrt(len(points))
    return float(values[0]), float(values[1])


def _thinned(points: npt.ArrayLike, name: str) -> Float64Array:
    array = np.asarray(points, np.float64).reshape(-1, 3)
    if len(array) < _MIN_PAIRS:
        raise CalibrationError(f"{name} has {len(array)} points, too few to align; check the paint or the patch")
    if not np.isfinite(array).all():
        raise CalibrationError(f"{name} has a point that is nan or infinite")
    step = max(math.ceil(len(array) / _ICP_POINTS), 1)
    return array[::step]


def read_pairs(path: Path | str, unit_m: float = 1.0) -> tuple[Float64Array, Float64Array]:
    """Read point pairs for `pose_from_pairs` from a CSV file.

    Parameters
    ----------
    path : path
        CSV with the header ``scan_x,scan_y,scan_z,patch_x_m,patch_y_m,patch_z_m``. Each line is a point in the scan's
        frame and unit, as a mesh viewer shows it, and the same point in the proximity depth frame in metres.
    unit_m : float
        Length of the scan's unit in metres.

    Returns
    -------
    scan_points, patch_points : float64, each shape (N, 3)
        Metres.

    Raises
    ------
    SourceError
        The file cannot be read, has another header, or a value that is no finite number.
    """
    path = user_path(path)
    try:
        text = read_file(path, _PAIRS_FILE_BYTES).decode("utf-8-sig")
        lines = csv.reader(text.splitlines())
        rows = [(lines.line_num, row) for row in lines if any(word.strip() for word in row)]
    except OSError as error:
        raise SourceError(f"cannot read {path}: {error.strerror or error}; check the path") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise SourceError(f"{path} is no CSV file; write the pairs as text") from error
    if not rows or tuple(word.strip() for word in rows[0][1]) != HEADER:
        raise SourceError(f"{path} lacks the header {','.join(HEADER)}; put it into the first line")
    for number, row in rows[1:]:
        if len(row) != len(HEADER) or not all(map(_finite, row)):
            raise SourceError(f"{path}, line {number}: {','.join(row)[:80]!r} is no pair; give six finite numbers")
    table = np.array([row for _, row in rows[1:]], np.float64).reshape(-1, len(HEADER))
    return table[:, :3] * unit_m, table[:, 3:]


def _finite(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False
