"""The tab Track: the pose of a known object, found by its patch and tracked from frame to frame."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from PyQt6.QtCore import Qt
from PyQt6.QtGui import QColor
from PyQt6.QtWidgets import QLabel
from scipy.spatial.transform import Rotation

from ...core.errors import MissingExtraError, minus
from ...core.estimation.object_mesh import SUFFIXES, ObjectMesh, import_open3d, load_mesh, simulated_mesh
from ...core.estimation.pose import PoseError, PoseEstimate, PoseTracker, pose_error, pose_record
from ...core.model.arrays import Float64Array, Uint8Array
from ...core.sources.simulator.scenes import read_name, resolve_scene
from ...widgets.basics.colormaps import CONTACT_COLOR, CONTACT_ROW, patch_lut
from ...widgets.basics.controls import choice_button, push_button, wrapped_label
from ...widgets.basics.layouts import STRETCH, hbox, holding, splitter, vbox
from ...widgets.basics.messages import Severity
from ...widgets.basics.theme import THEME, theme_colors
from ...widgets.clouds.cloud_data import free_cloud
from ...widgets.clouds.cloud_view import CloudView
from ..context import Context
from ..worker.jobs import Job, JobRow, Progress, Work
from ..worker.results import Result
from .tab import LiveTab, Row

_FILTER: Final = f"Meshes ({' '.join(f'*{suffix}' for suffix in SUFFIXES)})"
_MODEL_RGB: Final = (24, 120, 230)
#: A component with a larger standard deviation is not determined, metres and radians.
_FREE_M, _FREE_RAD = 0.02, 0.3
_NOBODY: Final = PoseEstimate(0, 0.0, np.eye(4), np.eye(6), 6, math.nan, 0.0, lost=True)
#: Points that a model is drawn with, and the number of blues that shade it by its normals.
_MODEL_POINTS: Final = 9000
_SHADES: Final = 5
_LIGHT: Final = np.array([-0.4, -0.7, -0.6]) / math.sqrt(1.01)


# Off the window's thread: the mesh, and the pose in one frame after the other


@dataclass(frozen=True, eq=False)
class Model:
    """A mesh, the points that it is drawn with, in its own frame, and the number of each point's shade."""

    mesh: ObjectMesh
    points: Float64Array
    shades: Uint8Array


def read_model(path: Path, progress: Progress) -> Model:
    progress(0.1, f"Reading {path.name}")
    mesh = load_mesh(path)
    progress(0.6, "Preparing the view")
    return _shown(mesh)


def simulated_model(name: str, progress: Progress) -> Model:
    """Make the mesh of a simulated source's object, such as that of ``sim:cup?move=slide``."""
    progress(0.1, "Meshing the simulated object")
    options = read_name(name.removeprefix("live:").removeprefix("sim:"))
    return _shown(simulated_mesh(resolve_scene(options["scene"], options["variant"]), options["scene"]))


def _shown(mesh: ObjectMesh) -> Model:
    """Return a mesh with points spread evenly over its surface."""
    with suppress(MissingExtraError):  # told when tracking starts; importing takes seconds and would stall the window
        import_open3d()
    points, normals = mesh.sample(_MODEL_POINTS)
    shades = np.minimum((0.5 - 0.5 * (normals @ _LIGHT)) * _SHADES, _SHADES - 1).astype(np.uint8)
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


# The tab


class TrackTab(LiveTab):
    """The patch with the model in its pose, and the numbers of the pose."""

    COLUMNS = tuple(pose_record(_NOBODY))
    EXPORT = "poses"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self.model: Model | None = None
        self.tracked: Tracked | None = None
        self._tracker: FrameTracker | None = None
        self._loading = Job(self, self._opened, partial(self.messages.state, "mesh", Severity.WARNING))
        self.open_button = push_button("&Open mesh…", "Open the object's mesh: OBJ, PLY or STL")
        self.simulated = push_button("&Simulated object", "Use the mesh of the object that the simulator presses")
        self.track_button = choice_button(
            "Find and trac&k", "Find the object in any orientation by its patch, then track it from frame to frame"
        )
        self.guide = wrapped_label(verdict=True)
        self.scene = CloudView("Patch and model")
        self.scene.set_point_size(2)
        self.scene.set_message("No patch yet: show a frame with contact in the main window")
        self.pose = QLabel()
        self.pose.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.pose.setToolTip(
            "Position of the mesh's origin and rotation about the camera's axes, each with its standard deviation; "
            "red: the patch does not determine it"
        )
        self.simulated.hide()
        self.top.addLayout(hbox(self.open_button, self.simulated, self.track_button, STRETCH))
        side = holding(vbox(self.guide, self.pose, JobRow(self._loading), STRETCH, margins=0))
        self.column.addWidget(splitter(Qt.Orientation.Horizontal, (self.scene, 1), side, sizes=(600, 340)))
        self.open_button.clicked.connect(self._ask_mesh)
        self.simulated.clicked.connect(self._open_simulated)
        self.track_button.toggled.connect(self._toggled)
        self.job.failed.connect(self._stop_after)
        self.working.cancel.clicked.connect(lambda: self.track_button.setChecked(False))
        self._loading.busyChanged.connect(lambda _: self._show())
        THEME.changed.connect(self._show)
        self._show()

    @property
    def goes_on(self) -> bool:
        """Tracking goes on behind other tabs, since the pose may be published."""
        return self.track_button.isChecked()

    def shut_down(self) -> None:
        super().shut_down()
        self._loading.stop()

    # The mesh

    def open_mesh(self, path: Path) -> None:
        """Read a mesh; the present one stays until that has succeeded."""
        self._loading.start(partial(read_model, path))

    def _ask_mesh(self) -> None:
        dialogs = self.context.dialogs.over(self.window() or self)
        dialogs.open_file("mesh", "Open a mesh", _FILTER, self.open_mesh)

    def _open_simulated(self) -> None:
        if self.result is not None:
            self._loading.start(partial(simulated_model, self.result.source.name))

    def _opened(self, model: Model) -> None:
        self.job.cancel()  # it may search for the former object
        self.track_button.setChecked(False)
        self.forget()
        self.model = model
        self.messages.show_message("mesh", Severity.INFO, f"{model.mesh.assumed}.")
        self._show()

    # Tracking

    def _toggled(self, on: bool) -> None:
        self._tracker = FrameTracker(self.model.mesh) if on and self.model is not None else None
        self.tracked = None
        if on:
            self.messages.clear("work")
        else:
            self.job.cancel()
        self._show()
        self.again()

    def _stop_after(self, sentence: str) -> None:
        """End tracking after an error; what another source cancelled goes on with that source."""
        if sentence:
            self.track_button.setChecked(False)

    def begin(self, result: Result) -> None:
        self.simulated.setVisible(result.source.name.removeprefix("live:").startswith("sim:"))

    def work(self, result: Result) -> Work:
        """Return the tracking of a frame. Its pose is published at once, not when the window has time."""
        tracker = self._tracker

        def track(progress: Any) -> Tracked | None:
            tracked = None if tracker is None else tracker.track(result, progress)
            if tracked is not None and not tracked.estimate.lost and tracker is self._tracker:
                self.context.worker.put_pose(tracked.estimate)
            return tracked

        return track

    def show_found(self, result: Result, found: Any) -> Row | None:
        self.tracked = found if self._tracker is not None else None
        self._show()
        if self.tracked is None:
            return None
        return tuple(pose_record(self.tracked.estimate, self.tracked.error).values())

    # Display

    def _show(self) -> None:
        tracked, model, result = self.tracked, self.model, self.result
        self.track_button.setEnabled(model is not None and result is not None)
        self.guide.setText("Preparing the mesh of the object…" if self._loading.busy else self._next_step())
        self.pose.setText("" if tracked is None else pose_text(tracked))
        patch = np.zeros((0, 3)) if result is None or result.patch is None else result.patch.points
        points, colors, legend = patch, np.full(len(patch), CONTACT_ROW, np.uint8), [("patch", CONTACT_COLOR)]
        lut = patch_lut(THEME.name).copy()
        if tracked is not None and model is not None and not tracked.estimate.lost:
            pose = tracked.estimate.T_proximity_object
            points = np.concatenate([patch, model.points @ pose[:3, :3].T + pose[:3, 3]])
            colors = np.concatenate([colors, model.shades])
            for row in range(_SHADES):
                lut[row, :3] = [round(channel * (0.45 + 0.55 * row / (_SHADES - 1))) for channel in _MODEL_RGB]
                lut[row, 3] = 255
            legend.append(("model", QColor(*_MODEL_RGB)))
        self.scene.set_cloud(free_cloud(points, colors, lut, count=len(patch)) if len(points) else None)
        self.scene.header.set_entries(legend)

    def _next_step(self) -> str:
        if self.model is None:
            other = "Press Simulated object, or open" if self.simulated.isVisibleTo(self) else "Open"
            return f"{other} the mesh of the object that is pressed."
        if self.result is None:
            return "There is no frame yet: open a source in the main window."
        if self._tracker is None:
            return f"Press Find and track to find {self.model.mesh.name} by its patch."
        if self.tracked is None:
            return "Searching for the object…"
        if not self.tracked.estimate.lost:
            return "Tracking."
        contact = self.result.patch is not None and len(self.result.patch.points)
        return (
            "Lost: the model does not fit the patch; searching." if contact else "No contact: waiting for the object."
        )


def pose_text(tracked: Tracked) -> str:
    """Return the pose with its standard deviations as a table for people; what is not determined is red."""
    estimate, error = tracked.estimate, tracked.error
    if estimate.lost:
        return ""
    pose, sigmas = estimate.T_proximity_object, np.sqrt(np.diag(estimate.covariance))
    turns = Rotation.from_matrix(pose[:3, :3]).as_euler("xyz", degrees=True)
    lines = []
    for row, name in enumerate(("x", "y", "z", "roll", "pitch", "yaw")):
        if row < 3:
            value, sigma, limit, unit = 1e3 * pose[row, 3], 1e3 * sigmas[row], 1e3 * _FREE_M, " mm"
        else:
            value, sigma, limit, unit = turns[row - 3], math.degrees(sigmas[row]), math.degrees(_FREE_RAD), "°"
        color = f' style="color: {theme_colors().error}"' if sigma > limit else ""
        cells = (name, minus(f"{value:z.1f}{unit}"), "free" if sigma > limit else f"± {sigma:.2f}{unit}")
        lines.append(f"<tr{color}>" + "".join(f'<td align="right">{cell}&nbsp;&nbsp;</td>' for cell in cells) + "</tr>")
    fit = f"Residual {1e3 * estimate.residual_m:.2f} mm, {100 * estimate.overlap:.0f} % on the model"
    true = ""
    if error is not None:
        true = f"<br>True error {1e3 * error.position_m:.2f} mm, {math.degrees(error.angle_rad):.2f}°"
    return f"<table>{''.join(lines)}</table>{fit}{true}"
