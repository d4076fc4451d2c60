"""The pose of a known object, tracked from contact patch to contact patch."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from ..contact.checks import rig_in_use
from ..errors import CalibrationError
from ..model.arrays import Float64Array
from ..model.frames import Rig, rigid_transform
from ..model.patch import ContactPatch
from ..preset import Preset
from .object_mesh import ObjectMesh, import_open3d
from .pose_fit import ON_MESH_M, Fit, PatchPoints, motion_between, moved, noise_density_m4, patch_points
from .pose_search import Membrane, Search, Searched

Vector3 = tuple[float, float, float]

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
#: A motion is a slide if its turn is below this share.
_SLIDE: Final = 0.2


@dataclass(frozen=True)
class FreeDirection:
    """One motion of the object that the patch does not determine.

    Attributes
    ----------
    kind : {"turn", "slide"}
    axis : (float, float, float)
        Unit vector in the proximity depth frame: the axis of the turn, or the direction of the slide.
    point_m : (float, float, float)
        A point of the turn's axis; for a slide a point of the patch. Metres, proximity depth frame.
    """

    kind: Literal["turn", "slide"]
    axis: Vector3
    point_m: Vector3


@dataclass(frozen=True, eq=False)
class PoseEstimate:
    """The object's pose in one frame.

    Attributes
    ----------
    sequence : int
        The frame's number.
    time_s : float
        The frame's time, seconds.
    T_proximity_object : float64, shape (4, 4)
        Takes the mesh's coordinates to the proximity depth frame, metres. Free directions are held at the motion that
        was predicted.
    covariance : float64, shape (6, 6)
        Order x, y, z, rx, ry, rz as in ``geometry_msgs/PoseWithCovariance``: position of the mesh's origin, then
        rotation about fixed axes parallel to those of the proximity depth frame; m^2, m rad, rad^2. A free direction
        has a standard deviation of the object's size.
    free : tuple of FreeDirection
        Directions that the patch does not determine, slides first.
    residual_m : float
        RMS distance to the mesh, along its normals, of the patch's points that lie on it, metres; nan without any.
    overlap : float
        Share of the patch's points that lie on the mesh, 0 to 1.
    lost : bool
        Whether the pose must not be used: there is no patch, or the mesh does not fit it.
    """

    sequence: int
    time_s: float
    T_proximity_object: Float64Array
    covariance: Float64Array
    free: tuple[FreeDirection, ...]
    residual_m: float
    overlap: float
    lost: bool


@dataclass(frozen=True)
class PoseError:
    """How far an estimate is from the true pose: of the mesh's origin, metres, and of the rotation, radians.

    The first two are in the directions that the patch determines, the others in all directions.
    """

    position_m: float
    angle_rad: float
    full_position_m: float
    full_angle_rad: float


def pose_error(estimate: PoseEstimate, truth: npt.ArrayLike, mesh: ObjectMesh) -> PoseError:
    """Compare an estimate with the true ``T_proximity_object``; of poses that look equal, the nearest one is true."""
    pose, radius_m = estimate.T_proximity_object, mesh.radius_m
    centre = pose[:3, :3] @ mesh.centre_m + pose[:3, 3]
    for direction in estimate.free:  # on the axis, even a large free turn moves nothing
        if direction.kind == "turn":
            centre = np.array(direction.point_m)
            break
    equal = (motion_between(np.asarray(truth) @ turn, pose, centre, radius_m) for turn in mesh.half_turns)
    full = min(equal, key=lambda motion: float(np.linalg.norm(motion)))
    free = np.zeros((6, len(estimate.free)))
    for column, direction in zip(free.T, estimate.free, strict=True):
        axis = np.array(direction.axis)
        if direction.kind == "slide":
            column[:3] = axis
        else:
            column[:] = *np.cross(axis, centre - direction.point_m), *(axis * radius_m)
    known = full - free @ (np.linalg.pinv(free) @ full) if estimate.free else full
    sizes = []
    for motion in (known, full):
        turn = motion[3:] / radius_m
        at_origin = motion[:3] + np.cross(turn, pose[:3, 3] - centre)
        sizes += [float(np.linalg.norm(at_origin)), float(np.linalg.norm(turn))]
    return PoseError(*sizes)


class PoseTracker:
    """Tracks the pose of a rigid object of known shape by its contact patches.

    The patch is used, not all that the proximity camera sees through the membrane: in contact both cameras measure the
    same surface, so a bias between them is removed and their noise is averaged, and it holds for membranes that
    scatter. ``scripts/measure_track.py`` compares. A tracker serves one thread at a time.

    Parameters
    ----------
    mesh : ObjectMesh
        From `tactune.core.estimation.object_mesh.load_mesh`.
    preset : Preset
        The preset of the patches: the rig's noise and the alignment.
    rig : Rig
        The rig that takes the frames, unless the preset has one of its own.

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
        self._preset, self._rig = preset, rig_in_use(preset, rig)
        self._density_m4 = noise_density_m4(preset, rig)
        self._pose: Float64Array | None = None
        self._forget()

    def _forget(self) -> None:
        self._velocity, self._about_m = np.zeros(6), np.zeros(3)
        self._last: Fit | None = None
        self._time_s = math.nan
        self._due_s = {False: -math.inf, True: -math.inf}

    def start(self, T_proximity_object: npt.ArrayLike) -> None:
        """Begin with a pose.

        Parameters
        ----------
        T_proximity_object : array_like, shape (4, 4)
            Takes the mesh's coordinates to the proximity depth frame, metres; off by less than 20 mm.

        Raises
        ------
        CalibrationError
            It is no rigid transform.
        """
        try:
            self._pose = np.asarray(rigid_transform(T_proximity_object), np.float64)
        except ValueError as error:
            raise CalibrationError(f"the object cannot start there: {error}") from error
        self._forget()

    @property
    def started(self) -> bool:
        """Whether there is a pose to track from."""
        return self._pose is not None

    def is_enough(self, patch: ContactPatch) -> bool:
        """Return whether a patch is large enough to tell a pose."""
        return len(patch_points(patch.points, self._rig, self._density_m4).points) >= _MIN_TILES

    def find(self, patch: ContactPatch, progress: Callable[[float], None] = lambda share: None) -> Float64Array:
        """Find the object in any orientation and begin there; takes some seconds.

        Of many starts a pose with the smallest two-way residual is taken, within 0.1 mm: the patch lies on the mesh,
        and no part of the mesh lies in front of the membrane. Of equally good ones, as those of a symmetric object,
        the one touched nearest its centre is taken.

        Parameters
        ----------
        patch : ContactPatch
        progress : callable
            Called with the share done, 0 to 1; may raise to end the search.

        Returns
        -------
        float64, shape (4, 4)
            ``T_proximity_object``.

        Raises
        ------
        CalibrationError
            The patch is too small, or the mesh fits it nowhere.
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
                f"the mesh {self.mesh.name} does not fit the contact: at best {100 * found.fit.overlap:.0f} % of the "
                f"patch lies within {1e3 * ON_MESH_M:g} mm of it, and the two-way residual is {1e3 * found.cost_m:.1f} "
                "mm; check that it is the mesh of this object and its unit"
            )
        self.start(found.fit.pose)
        self._last = found.fit
        return found.fit.pose

    def track(
        self, patch: ContactPatch, time_s: float, progress: Callable[[float], None] = lambda share: None
    ) -> PoseEstimate:
        """Return the object's pose in the next frame; the first one is searched for unless the tracker was started.

        Parameters
        ----------
        patch : ContactPatch
            Of the next frame.
        time_s : float
            The frame's time, seconds; must increase.
        progress : callable
            As for `find`, of each search.

        Returns
        -------
        PoseEstimate
            ``lost`` without a patch, and where the mesh does not fit it.
        """
        tiles = patch_points(patch.points, self._rig, self._density_m4)
        found = None
        if len(tiles.points) >= _MIN_TILES:
            found = self._follow(self._search(patch, tiles, progress), time_s)
        if found is None:
            self._velocity, self._time_s = np.zeros(6), math.nan
            pose = self._pose if self._pose is not None else np.eye(4)
            unknown = np.diag([self.mesh.radius_m**2] * 3 + [1.0] * 3)
            return PoseEstimate(patch.sequence, time_s, pose, unknown, (), math.nan, 0.0, lost=True)
        fit = found.fit
        self._keep(fit, time_s)
        radius_m = self.mesh.radius_m
        covariance, free = _covariance(fit, radius_m), free_directions(fit, radius_m)
        return PoseEstimate(patch.sequence, time_s, fit.pose, covariance, free, fit.residual_m, fit.overlap, lost=False)

    def _search(self, patch: ContactPatch, tiles: PatchPoints, progress: Callable[[float], None]) -> Search:
        return Search(self.mesh, tiles, Membrane.of(patch, self._preset), len(patch.points), progress)

    def _follow(self, search: Search, time_s: float) -> Searched | None:
        """Return the fit of the next frame; None if there is none yet, or if the object is lost and not found."""
        pose = self._pose
        found: Searched | None = None
        # 1. From where the last motion leads. If that fits badly, a search near the last fit must be clearly better.
        if pose is not None:
            found = search.fitted(self._predicted(pose, time_s))
            good = found.fit.overlap > _GOOD_OVERLAP and found.cost_m < _GOOD_M
            if not good and self._may_search(time_s, everywhere=False):
                other = search.near(self._last or found.fit, pose)
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

    def _predicted(self, pose: Float64Array, time_s: float) -> Float64Array:
        """Return the last pose moved on with constant velocity."""
        passed = time_s - self._time_s
        if not 0 < passed <= _MAX_GAP_S:
            return pose
        return moved(pose, passed * self._velocity, self._about_m, self.mesh.radius_m)

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
        self._pose, self._time_s, self._about_m, self._last = found.pose, time_s, found.centre_m, found


def _is_lost(found: Searched) -> bool:
    return not (found.fit.overlap >= _LOST_OVERLAP and found.cost_m <= _LOST_M)


def _covariance(found: Fit, radius_m: float) -> Float64Array:
    """Return the covariance of the mesh's origin and of the rotation about fixed axes."""
    sigmas = np.where(found.free, radius_m, np.hypot(np.minimum(found.sigmas_m, radius_m), _SHARED_M))
    to_origin = np.eye(6)
    x, y, z = (found.pose[:3, 3] - found.centre_m) / radius_m
    to_origin[:3, 3:] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]  # turn x (origin - centre)
    to_origin[3:, 3:] /= radius_m
    covariance = to_origin @ found.directions * sigmas
    return np.asarray(covariance @ covariance.T)


def free_directions(found: Fit, radius_m: float) -> tuple[FreeDirection, ...]:
    """Return the free directions of a fit as slides and turns, slides first."""
    free = found.directions[:, found.free]
    if free.shape[1] == 0:
        return ()
    _, turning, mixed = np.linalg.svd(free[3:], full_matrices=True)
    turning = np.append(turning, np.zeros(len(mixed) - len(turning)))
    slides, turns = list[FreeDirection](), list[FreeDirection]()
    for turn, motion in zip(turning, (free @ mixed.T).T, strict=True):
        if turn < _SLIDE:
            slides.append(FreeDirection("slide", _unit(motion[:3]), _vector(found.centre_m)))
        else:
            spin = motion[3:] / radius_m
            point = found.centre_m + np.cross(spin, motion[:3]) / (spin @ spin)
            turns.append(FreeDirection("turn", _unit(spin), _vector(point)))
    return *slides, *turns


def _unit(values: Float64Array) -> Vector3:
    return _vector(values / np.linalg.norm(values))


def _vector(values: Float64Array) -> Vector3:
    x, y, z = (float(value) for value in values)
    return x, y, z
