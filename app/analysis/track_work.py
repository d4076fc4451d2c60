"""Work of the tab Track off the window's thread: the mesh, and the pose in one frame after the other."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from ...core.errors import CalibrationError, MissingExtraError
from ...core.estimation.object_mesh import ObjectMesh, import_open3d, load_mesh, simulated_mesh
from ...core.estimation.pose import PoseError, PoseEstimate, PoseTracker, pose_error
from ...core.model.arrays import Float64Array
from ...core.model.frames import Matrix4
from ...core.sources.simulator.names import read_name
from ...core.sources.simulator.scenes import read_options, resolve_scene
from ..worker.jobs import Progress
from ..worker.results import Result
from .truth_state import FrozenPatch
from .truth_views import Rgb

#: Points that a model is drawn with, and the blues that shade it by its normals.
_MODEL_POINTS: Final = 9000
_SHADES: Final = 5
_LIGHT: Final = np.array([-0.4, -0.7, -0.6]) / math.sqrt(1.01)
MODEL_RGB: Final[Rgb] = (24, 120, 230)
FREE_RGB: Final[Rgb] = (224, 49, 49)
AXIS_RGB: Final[Rgb] = (128, 134, 142)
#: Points of a drawn axis; its half length as a multiple of the mesh's radius.
_AXIS_POINTS, _AXIS_REACH = 300, 2.0


@dataclass(frozen=True, eq=False)
class Model:
    """A mesh and the points that it is drawn with, in its own frame, each group with its shade."""

    mesh: ObjectMesh
    groups: tuple[tuple[Float64Array, Rgb], ...]

    def centre(self, pose: Matrix4 | Float64Array) -> Float64Array:
        """Return the centre of the surface in the proximity frame, metres."""
        matrix = np.asarray(pose)
        return np.asarray(matrix[:3, :3] @ self.mesh.centre_m + matrix[:3, 3])

    def posed(self, pose: Matrix4 | Float64Array) -> list[tuple[Float64Array, Rgb]]:
        """Return the groups in the proximity frame."""
        matrix = np.asarray(pose)
        return [(points @ matrix[:3, :3].T + matrix[:3, 3], rgb) for points, rgb in self.groups]


@dataclass(frozen=True, eq=False)
class Tracked:
    """The pose in one frame of the main window, the error where the truth is known, and the patch to draw."""

    estimate: PoseEstimate
    error: PoseError | None
    patch: FrozenPatch


def read_model(path: Path, unit: str | None, progress: Progress) -> Model:
    """Read a mesh; raises as `load_mesh` does."""
    progress(0.1, f"Reading {path.name}")
    mesh = load_mesh(path, unit)
    progress(0.6, "Preparing the view")
    return shown(mesh)


def simulated_model(name: str, progress: Progress) -> Model:
    """Make the mesh of a simulated source's object, such as that of ``sim:cup?move=slide``."""
    progress(0.1, "Meshing the simulated object")
    rest = name.removeprefix("live:").removeprefix("sim:")
    values = read_name(rest)
    scene = resolve_scene(values["scene"], read_options(name, values)[0])
    return shown(simulated_mesh(scene, values["scene"]))


def shown(mesh: ObjectMesh) -> Model:
    """Return a mesh with points spread evenly over its surface."""
    with suppress(MissingExtraError):  # told when tracking starts; importing takes seconds and would stall the window
        import_open3d()
    points, normals = mesh.sample(_MODEL_POINTS)
    lit = 0.5 - 0.5 * (normals @ _LIGHT)
    shade = np.minimum((lit * _SHADES).astype(int), _SHADES - 1)
    groups = []
    for number in range(_SHADES):
        red, green, blue = (round(channel * (0.45 + 0.55 * number / (_SHADES - 1))) for channel in MODEL_RGB)
        groups.append((points[shade == number], (red, green, blue)))
    return Model(mesh, tuple(groups))


def axes_of(estimate: PoseEstimate, mesh: ObjectMesh) -> list[tuple[Float64Array, Rgb]]:
    """Return the directions that are free as red lines, and the mesh's own axes as grey ones."""
    if estimate.lost:
        return []
    reach = np.linspace(-1.0, 1.0, _AXIS_POINTS)[:, None] * _AXIS_REACH * mesh.radius_m
    pose = estimate.T_proximity_object
    centre = pose[:3, :3] @ mesh.centre_m + pose[:3, 3]
    grey = [centre + 0.7 * reach * axis for axis in pose[:3, :3].T]
    red = [np.array(free.point_m) + reach * np.array(free.axis) for free in estimate.free]
    lines = [(np.concatenate(grey), AXIS_RGB)]
    return [*lines, (np.concatenate(red), FREE_RGB)] if red else lines


class FrameTracker:
    """A `PoseTracker` for the frames of the main window, made anew where preset or rig change.

    It serves one thread at a time.
    """

    def __init__(self, mesh: ObjectMesh, pose: Matrix4 | None) -> None:
        self.mesh = mesh
        self._pose: Matrix4 | Float64Array | None = pose
        self._tracker: PoseTracker | None = None
        self._made_for: tuple[object, object] | None = None
        self._time_s = -math.inf

    def find(self, result: Result, progress: Progress) -> Float64Array:
        """Search the whole patch for the object; raises as `PoseTracker.find` does."""
        if result.patch is None or not len(result.patch.points):
            raise CalibrationError("there is no contact to find the object by; press it into the membrane")
        return self._ready(result).find(result.patch, lambda share: progress(share, f"Searching for {self.mesh.name}"))

    def track(self, result: Result) -> Tracked | None:
        """Return the pose in a frame; None if the frame has no patch because the preset does not fit the rig."""
        if result.patch is None:
            return None
        tracker = self._ready(result)
        estimate = tracker.track(result.patch, result.frame.proximity_time_s)
        if not estimate.lost:
            self._pose = estimate.T_proximity_object
        truth = result.frame.truth
        true = truth.T_proximity_object if truth is not None else None
        error = None if true is None or estimate.lost else pose_error(estimate, true, self.mesh)
        return Tracked(estimate, error, FrozenPatch.of(result, ""))

    def _ready(self, result: Result) -> PoseTracker:
        """Return the tracker for a frame; after a jump back in time it starts anew from the last pose."""
        made_for = result.preset, result.source
        time_s = result.frame.proximity_time_s
        if (
            self._tracker is None
            or self._made_for is None
            or any(old is not new for old, new in zip(self._made_for, made_for, strict=True))
        ):
            self._tracker, self._made_for = PoseTracker(self.mesh, result.preset, result.source.rig), made_for
            self._time_s = math.inf
        if time_s <= self._time_s and self._pose is not None:
            self._tracker.start(self._pose)
        self._time_s = time_s
        return self._tracker
