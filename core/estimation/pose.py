"""The pose of a known object, tracked from contact patch to contact patch, and tracked poses as a CSV file."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from ..errors import CalibrationError, ExportError, TactuneError
from ..model.arrays import Float64Array
from ..model.files import atomic_path
from ..model.frames import Rig, rigid_transform
from ..model.patch import ContactPatch
from ..preset import Preset
from .object_mesh import ObjectMesh, import_open3d
from .pose_fit import (
    ON_MESH_M,
    Fit,
    Membrane,
    PatchPoints,
    Search,
    motion_between,
    moved,
    noise_density_m4,
    patch_points,
)

#: Fewest image tiles of a patch that can tell a pose, about 2 cm^2.
_MIN_TILES: Final = 27
#: A fit is good if this share of the patch lies on the mesh and its two-way residual is below; a worse one is compared
#: with others nearby. It is lost below the second share, or above the second residual, metres.
_GOOD_OVERLAP, _GOOD_M = 0.93, 0.0025
_LOST_OVERLAP, _LOST_M = 0.80, 0.0035
#: Another fit nearby replaces the present one if its two-way residual is below this share.
_BETTER: Final = 0.8
#: Searches nearby are at least this far apart, and searches everywhere while the object is lost, seconds.
_NEAR_PAUSE_S, _SEARCH_PAUSE_S = 0.1, 1.0
#: Time constants of the velocity: of its average, and of its decay along free directions, seconds.
_VELOCITY_S, _FREE_DECAY_S = 0.1, 0.5
#: Longest time between frames over which motion is predicted, seconds.
_MAX_GAP_S: Final = 0.5
#: Standard deviation of errors that all of a patch shares, metres, such as a bias that varies over the image.
_SHARED_M: Final = 0.0003


@dataclass(frozen=True, eq=False)
class PoseEstimate:
    """The object's pose in one frame.

    ``T_proximity_object`` (4, 4) takes the mesh's coordinates to the proximity depth frame, metres. ``free`` directions
    that the patch does not determine are held at the predicted motion, with a standard deviation of the object's size.
    ``covariance`` (6, 6) is in the order x, y, z, rx, ry, rz of ``geometry_msgs/PoseWithCovariance``: position of
    the mesh's origin, then rotation about fixed axes parallel to those of the proximity depth frame; m^2, m rad, rad^2.
    ``overlap`` is the share of the patch's points that lie on the mesh, ``residual_m`` their RMS distance along its
    normals, nan without any. A ``lost`` pose must not be used: there is no patch, or the mesh does not fit it.
    """

    sequence: int
    time_s: float
    T_proximity_object: Float64Array
    covariance: Float64Array
    free: int
    residual_m: float
    overlap: float
    lost: bool


@dataclass(frozen=True)
class PoseError:
    """How far an estimate is from the true pose in the directions that the patch determines: metres and radians."""

    position_m: float
    angle_rad: float


def pose_error(estimate: PoseEstimate, truth: npt.ArrayLike, mesh: ObjectMesh) -> PoseError:
    """Compare with the true pose, or the nearest that looks equal; what the patch leaves free does not count."""
    pose, radius_m = estimate.T_proximity_object, mesh.radius_m
    equal = (motion_between(np.asarray(truth) @ turn, pose, pose[:3, 3], radius_m) for turn in mesh.half_turns)
    error = min(equal, key=lambda motion: float(np.linalg.norm(motion)))
    lengths = np.diag([1.0] * 3 + [radius_m] * 3)
    free = np.linalg.eigh(lengths @ estimate.covariance @ lengths)[1][:, 6 - estimate.free :]
    error = error - free @ (free.T @ error)
    return PoseError(float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:])) / radius_m)


class PoseTracker:
    """Tracks the pose of a rigid object of known shape by its contact patches.

    The patch is used, not all that the proximity camera sees through the membrane: in contact both cameras measure the
    same surface, so a bias between them is removed and their noise is averaged, and it holds for membranes that
    scatter. A tracker serves one thread at a time.

    Parameters
    ----------
    mesh : ObjectMesh
        From `tactune.core.estimation.object_mesh.load_mesh`.
    preset : Preset
        The preset of the patches: the rig's noise and the alignment.
    rig : Rig
        The rig that takes the frames.

    Raises
    ------
    MissingExtraError
        Open3D is not installed.

    Examples
    --------
    >>> tracker = PoseTracker(load_mesh("cup.stl"), preset, source.rig)
    >>> pose = tracker.track(pipeline.process(frame), frame.proximity_time_s)
    >>> pose.lost or pose.T_proximity_object
    """

    def __init__(self, mesh: ObjectMesh, preset: Preset, rig: Rig) -> None:
        import_open3d()
        self.mesh = mesh
        self._preset, self._rig = preset, rig
        self._density_m4 = noise_density_m4(preset, rig)
        self._pose: Float64Array | None = None
        self._forget()

    def _forget(self) -> None:
        self._velocity, self._about_m = np.zeros(6), np.zeros(3)
        self._time_s = math.nan
        self._due_s = {False: -math.inf, True: -math.inf}

    def start(self, T_proximity_object: npt.ArrayLike) -> None:
        """Begin with a pose (4, 4), metres, off by less than 20 mm."""
        try:
            self._pose = np.asarray(rigid_transform(T_proximity_object), np.float64)
        except ValueError as error:
            raise CalibrationError(f"the object cannot start there: {error}") from error
        self._forget()

    @property
    def started(self) -> bool:
        return self._pose is not None

    def is_enough(self, patch: ContactPatch) -> bool:
        """Return whether a patch is large enough to tell a pose."""
        return len(patch_points(patch.points, self._rig, self._density_m4).points) >= _MIN_TILES

    def find(self, patch: ContactPatch, progress: Callable[[float], None] = lambda share: None) -> Float64Array:
        """Find the object in any orientation, begin there and return ``T_proximity_object``; takes some seconds.

        Of equally good poses, as those of a symmetric object, the one touched nearest its centre is taken. ``progress``
        is called with the share done, 0 to 1; it may raise to end the search. Raises a `CalibrationError` if the patch
        is too small, or the mesh fits it nowhere.
        """
        tiles = patch_points(patch.points, self._rig, self._density_m4)
        if len(tiles.points) < _MIN_TILES:
            raise CalibrationError(
                f"the patch is too small to find {self.mesh.name}: {len(tiles.points)} image tiles of contact, at "
                f"least {_MIN_TILES} are needed; press it deeper"
            )
        found = self._search(patch, tiles, progress).everywhere(None)
        if _is_lost(found):
            raise CalibrationError(
                f"the mesh {self.mesh.name} does not fit the contact: at best {100 * found.overlap:.0f} % of the "
                f"patch lies within {1e3 * ON_MESH_M:g} mm of it, and the two-way residual is {1e3 * found.cost_m:.1f} "
                "mm; check that it is the mesh of this object and its unit"
            )
        self.start(found.pose)
        return found.pose

    def track(
        self, patch: ContactPatch, time_s: float, progress: Callable[[float], None] = lambda share: None
    ) -> PoseEstimate:
        """Return the object's pose in the next frame, ``lost`` without a patch and where the mesh does not fit it.

        The first pose is searched for unless the tracker was started. Times, seconds, must increase; ``progress`` is
        that of each search, as for `find`.
        """
        tiles = patch_points(patch.points, self._rig, self._density_m4)
        found = None
        if len(tiles.points) >= _MIN_TILES:
            found = self._follow(self._search(patch, tiles, progress), time_s)
        if found is None:
            self._velocity, self._time_s = np.zeros(6), math.nan
            pose = self._pose if self._pose is not None else np.eye(4)
            unknown = np.diag([self.mesh.radius_m**2] * 3 + [1.0] * 3)
            return PoseEstimate(patch.sequence, time_s, pose, unknown, 6, math.nan, 0.0, lost=True)
        self._keep(found, time_s)
        covariance, free = _covariance(found, self.mesh.radius_m), int(found.free.sum())
        return PoseEstimate(
            patch.sequence, time_s, found.pose, covariance, free, found.residual_m, found.overlap, lost=False
        )

    def _search(self, patch: ContactPatch, tiles: PatchPoints, progress: Callable[[float], None]) -> Search:
        return Search(self.mesh, tiles, Membrane.of(patch, self._preset), len(patch.points), progress)

    def _follow(self, search: Search, time_s: float) -> Fit | None:
        """Return the fit of the next frame; None if there is none yet, or if the object is lost and not found."""
        pose = self._pose
        found: Fit | None = None
        # 1. From where the last motion leads. If that fits badly, a search near the last fit must be clearly better.
        if pose is not None:
            passed, start = time_s - self._time_s, pose
            if 0 < passed <= _MAX_GAP_S:  # moved on with constant velocity
                start = moved(pose, passed * self._velocity, self._about_m, self.mesh.radius_m)
            found = search.fitted(start)
            good = found.overlap > _GOOD_OVERLAP and found.cost_m < _GOOD_M
            if not good and self._may_search(time_s, everywhere=False):
                other = search.near(pose)
                if other.cost_m < _BETTER * found.cost_m:
                    found, self._time_s = other, math.nan  # a jump is no velocity
        # 2. In any orientation.
        if (found is None or _is_lost(found)) and self._may_search(time_s, everywhere=True):
            found, self._time_s = search.everywhere(pose), math.nan
        return None if found is None or _is_lost(found) else found

    def _may_search(self, time_s: float, *, everywhere: bool) -> bool:
        """Return whether the last search was long enough ago, and count this one."""
        if time_s < self._due_s[everywhere]:
            return False
        self._due_s[everywhere] = time_s + (_SEARCH_PAUSE_S if everywhere else _NEAR_PAUSE_S)
        return True

    def _keep(self, found: Fit, time_s: float) -> None:
        """Remember a pose and its velocity, which decays along free directions."""
        passed = time_s - self._time_s
        if self._pose is not None and 0 < passed <= _MAX_GAP_S:
            way = motion_between(self._pose, found.pose, found.centre_m, self.mesh.radius_m) / passed
            gain = 1 - math.exp(-passed / _VELOCITY_S)
            self._velocity = (1 - gain) * self._velocity + gain * way
            free = found.directions[:, found.free]
            self._velocity -= (1 - math.exp(-passed / _FREE_DECAY_S)) * free @ (free.T @ self._velocity)
        else:
            self._velocity = np.zeros(6)
        self._pose, self._time_s, self._about_m = found.pose, time_s, found.centre_m


def _is_lost(found: Fit) -> bool:
    return not (found.overlap >= _LOST_OVERLAP and found.cost_m <= _LOST_M)


def _covariance(found: Fit, radius_m: float) -> Float64Array:
    """Return the covariance of the mesh's origin and of the rotation about fixed axes."""
    sigmas = np.where(found.free, radius_m, np.hypot(np.minimum(found.sigmas_m, radius_m), _SHARED_M))
    to_origin = np.eye(6)
    x, y, z = (found.pose[:3, 3] - found.centre_m) / radius_m
    to_origin[:3, 3:] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]  # turn x (origin - centre)
    to_origin[3:, 3:] /= radius_m
    covariance = to_origin @ found.directions * sigmas
    return np.asarray(covariance @ covariance.T)


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
    """Yield a function that writes records of `pose_record` to a CSV, which keeps them also after a `TactuneError`."""
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
