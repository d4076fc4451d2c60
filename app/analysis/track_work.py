"""Work of the tab Track off the window's thread: the mesh, and the pose in one frame after the other."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from ...core.errors import MissingExtraError
from ...core.estimation.object_mesh import ObjectMesh, import_open3d, load_mesh, simulated_mesh
from ...core.estimation.pose import PoseError, PoseEstimate, PoseTracker, pose_error
from ...core.model.arrays import Float64Array, Uint8Array
from ...core.sources.simulator.names import read_name, source_options
from ...core.sources.simulator.scenes import resolve_scene
from ..worker.jobs import Progress
from ..worker.results import Result

#: Points that a model is drawn with, and the number of blues that shade it by its normals.
_MODEL_POINTS: Final = 9000
SHADES: Final = 5
_LIGHT: Final = np.array([-0.4, -0.7, -0.6]) / math.sqrt(1.01)


@dataclass(frozen=True, eq=False)
class Model:
    """A mesh, the points that it is drawn with, in its own frame, and the number of each point's shade."""

    mesh: ObjectMesh
    points: Float64Array
    shades: Uint8Array


def read_model(path: Path, unit: str | None, progress: Progress) -> Model:
    """Read a mesh; raises as `load_mesh` does."""
    progress(0.1, f"Reading {path.name}")
    mesh = load_mesh(path, unit)
    progress(0.6, "Preparing the view")
    return _shown(mesh)


def simulated_model(name: str, progress: Progress) -> Model:
    """Make the mesh of a simulated source's object, such as that of ``sim:cup?move=slide``."""
    progress(0.1, "Meshing the simulated object")
    options = source_options(read_name(name.removeprefix("live:").removeprefix("sim:")))
    return _shown(simulated_mesh(resolve_scene(options["scene"], options["variant"]), options["scene"]))


def _shown(mesh: ObjectMesh) -> Model:
    """Return a mesh with points spread evenly over its surface."""
    with suppress(MissingExtraError):  # told when tracking starts; importing takes seconds and would stall the window
        import_open3d()
    points, normals = mesh.sample(_MODEL_POINTS)
    shades = np.minimum((0.5 - 0.5 * (normals @ _LIGHT)) * SHADES, SHADES - 1).astype(np.uint8)
    return Model(mesh, points, shades)


@dataclass(frozen=True, eq=False)
class Tracked:
    """The pose in one frame of the main window, and the error where the truth is known."""

    estimate: PoseEstimate
    error: PoseError | None


class FrameTracker:
    """A `PoseTracker` for the frames of the main window, made anew where preset or rig change; for one thread."""

    def __init__(self, mesh: ObjectMesh) -> None:
        self.mesh = mesh
        self._tracker: PoseTracker | None = None
        self._made_for: tuple[object, object] = (None, None)
        self._pose: Float64Array | None = None
        self._time_s = -math.inf

    def track(self, result: Result, progress: Progress) -> Tracked | None:
        """Return the pose in a frame; None without a patch. The first patch that is large enough is searched."""
        patch = result.patch
        if patch is None:
            return None
        tracker, time_s = self._tracker, result.frame.proximity_time_s
        if tracker is None or self._made_for[0] is not result.preset or self._made_for[1] is not result.source:
            tracker = self._tracker = PoseTracker(self.mesh, result.preset, result.source.rig)
            self._made_for = result.preset, result.source
            self._time_s = math.inf
        if time_s <= self._time_s and self._pose is not None:  # a new tracker, or a jump back in time
            tracker.start(self._pose)
        self._time_s = time_s
        if not tracker.started and tracker.is_enough(patch):
            tracker.find(patch, lambda share: progress(share, f"Searching for {self.mesh.name}"))
        estimate = tracker.track(patch, time_s)
        if not estimate.lost:
            self._pose = estimate.T_proximity_object
        true = result.frame.truth.T_proximity_object if result.frame.truth is not None else None
        return Tracked(estimate, None if true is None or estimate.lost else pose_error(estimate, true, self.mesh))
