"""The tab Track: the pose of a known object, first by hand or found, then from frame to frame."""

from __future__ import annotations

import math
from collections import deque
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from PyQt6.QtCore import QEvent, Qt
from PyQt6.QtGui import QDragEnterEvent, QDropEvent
from PyQt6.QtWidgets import (
    QComboBox,
    QHBoxLayout,
    QVBoxLayout,
    QWidget,
)

from ...core.errors import MissingExtraError
from ...core.estimation.object_mesh import SUFFIXES, import_open3d
from ...core.estimation.pose import PoseEstimate
from ...core.estimation.pose_files import error_record, pose_record, save_poses
from ...core.estimation.start_pose import pair_errors_m
from ...core.model.arrays import Float64Array
from ...core.model.units import UNITS_M
from ...widgets.basics.controls import (
    AccentButton,
    CollapsibleSection,
    ProgressBar,
    caption,
    push_button,
    wrapped_label,
)
from ...widgets.basics.dialogs import local_files
from ...widgets.basics.layouts import hbox, scrolling, splitter, vbox
from ...widgets.basics.messages import Messages, Severity
from ...widgets.clouds.pick_view import PickView
from ...widgets.plots.pose_plot import PosePlot
from ..context import Context
from ..worker.jobs import Job
from ..worker.results import Result
from .tab import AnalysisTab, undo_buttons
from .track_views import PosePanel, TrackViews
from .track_work import FrameTracker, Model, Tracked, read_model, simulated_model
from .truth_panels import AlignPanel
from .truth_state import MIN_PAIRS, FrozenPatch, Side, TruthSession, TruthState

_FILTER: Final = f"Meshes ({' '.join(f'*{suffix}' for suffix in SUFFIXES)})"
_EXPORTS: Final = ["Table (*.csv)", "TUM trajectory (*.tum)"]
_BY_SIZE: Final = "by size"
_PANEL_WIDTH: Final = 340
#: Poses that are kept for the export: the newest hour at 30 frames/s.
_KEPT: Final = 108_000


class TrackTab(AnalysisTab):
    """A model, the patch with the model in its pose, and what is known about the pose."""

    def __init__(self, context: Context) -> None:
        super().__init__()
        self._settings, self._dialogs, self._worker = context.settings, context.dialogs, context.worker
        self.session = TruthSession(self, "model")
        self.model: Model | None = None
        self.tracked: Tracked | None = None
        self._path: Path | None = None
        self._result: Result | None = None
        self._live: FrozenPatch | None = None
        self._tracker: FrameTracker | None = None
        self._records: deque[dict[str, Any]] = deque(maxlen=_KEPT)
        self._loading, self._finding, self._tracking, self._writing = Job(self), Job(self), Job(self), Job(self)
        self.messages = Messages(self)
        self.guide = wrapped_label(verdict=True)
        self.open_button = push_button("&Open mesh…", "Open the object's mesh: OBJ, PLY or STL (or drop it here)")
        self.simulated = push_button("&Simulated object", "Use the mesh of the object that the simulator presses")
        self.unit = QComboBox()
        self.find_button = push_button("Fi&nd", "Find the object in any orientation by this patch, then track it")
        self.track_button = AccentButton(
            "Trac&k", "Track the object from frame to frame; off: keep the pose and move it by hand"
        )
        self.export = push_button("E&xport…", "Write the tracked poses: a table (CSV), or a TUM trajectory for evo")
        self.progress, self.cancel = ProgressBar(), push_button("Cancel", "Stop reading or searching")
        self.views = TrackViews(PickView("Model"), PickView("Patch and model"))
        self.pose, self.plot = PosePanel(), PosePlot()
        self.align = AlignPanel("Start pose", "model", "model", refines=False)
        self._lay_out()
        self._connect()
        self._show_busy(1.0, "")
        self._show()
        self.setAcceptDrops(True)

    @property
    def goes_on(self) -> bool:
        """Tracking goes on behind other tabs, since the pose may be published."""
        return self.track_button.isChecked()

    def show_result(self, result: Result) -> None:
        """Track the object in a frame of the main window, or show its patch."""
        self._result = result
        simulated = result.source.name.removeprefix("live:").startswith("sim:")
        if simulated != self.simulated.isVisibleTo(self):
            self.simulated.setVisible(simulated)
            self._show()
        if self.track_button.isChecked():
            self._step()
        elif self.session.state.patch is None:
            self._live = FrozenPatch.of(result, "")
            self._show()

    def shut_down(self) -> None:
        """Stop all threads."""
        for job in (self._loading, self._finding, self._tracking, self._writing):
            job.stop()

    # Building

    def _lay_out(self) -> None:
        self.simulated.hide()
        self.unit.addItems([_BY_SIZE, *UNITS_M])
        self.unit.setToolTip("Length unit of the mesh; by size: metres if the object is then 10 mm to 2 m, else mm")
        self.progress.setMaximumWidth(240)
        top = QHBoxLayout()
        unit = caption("&Unit", self.unit)
        row: tuple[QWidget, ...] = (self.open_button, self.simulated, unit, self.unit)
        for widget in (*row, self.find_button, self.track_button):
            top.addWidget(widget)
        top.addStretch(1)
        for button in (*undo_buttons(self, self.session.undo_stack), self.export):
            top.addWidget(button)
        state = hbox((self.guide, 1), self.progress, self.cancel)
        policy = self.cancel.sizePolicy()
        policy.setRetainSizeWhenHidden(True)
        self.cancel.setSizePolicy(policy)
        panels = QWidget()
        column = QVBoxLayout(panels)
        column.setContentsMargins(0, 0, 4, 0)
        self.errors = CollapsibleSection("Errors")
        vbox(self.plot, within=self.errors.body, margins=(8, 4, 8, 8))
        for panel in (self.pose, self.errors, self.align):
            column.addWidget(panel)
        column.addStretch(1)
        across = splitter(Qt.Orientation.Horizontal, (self.views, 1), scrolling(panels, _PANEL_WIDTH))
        vbox(top, state, (across, 1), within=self, margins=0)

    def _connect(self) -> None:
        self.session.changed.connect(lambda _: self._show())
        self.session.refused.connect(partial(self._complain, "pose"))
        for job, done, subject in (
            (self._loading, self._opened, "mesh"),
            (self._finding, self._found, "find"),
            (self._tracking, self._follow, "track"),
            (self._writing, self._wrote, "export"),
        ):
            job.done.connect(done)
            job.failed.connect(partial(self._failed, subject))
            if job is not self._tracking:
                job.progress.connect(self._show_busy)
        self.open_button.clicked.connect(self._ask_mesh)
        self.simulated.clicked.connect(self._open_simulated)
        self.unit.activated.connect(self._read_again)
        self.find_button.clicked.connect(self._search)
        self.cancel.clicked.connect(self._give_up)
        self.track_button.toggled.connect(self._toggled)
        self.export.clicked.connect(lambda: self._ask_export(list(self._records)))
        self.views.model.pointClicked.connect(lambda _, place: self._click("scan", place))
        self.views.scene.pointClicked.connect(lambda _, place: self._click("patch", place))
        self.views.scene.nudged.connect(lambda change, gesture: self.session.nudge(change, None, gesture))
        self.views.follow.clicked.connect(lambda: self.session.freeze(None))
        self.align.selectionChanged.connect(self.views.select)
        self.align.removeRequested.connect(self.session.remove)
        self.align.clear.clicked.connect(self.session.remove_all)
        self.align.center.clicked.connect(self._center)
        self.align.poseEdited.connect(
            lambda pose, gesture: self.session.set_pose(pose, "hand", "Type the model's pose", None, gesture)
        )

    # The mesh

    def open_mesh(self, path: Path) -> None:
        """Read a mesh in the chosen unit; the present one stays until that has succeeded."""
        self._path = path
        unit = self.unit.currentText()
        self._open(partial(read_model, path, None if unit == _BY_SIZE else unit))

    def _ask_mesh(self) -> None:
        self._dialogs.over(self.window() or self).open_file("mesh", "Open a mesh", _FILTER, self.open_mesh)

    def _open_simulated(self) -> None:
        if self._result is not None:
            self._path = None  # another unit would read that file again
            self._open(partial(simulated_model, self._result.source.name))

    def _read_again(self) -> None:
        if self._path is not None:
            self.open_mesh(self._path)

    def _open(self, work: Any) -> None:
        self._complain("mesh", "")
        self._show_busy(0.0, "Reading the mesh")
        self._loading.start(work)

    def _opened(self, model: Model) -> None:
        self._show_busy(1.0, "")
        self._finding.cancel()  # it searches for the former object
        self.track_button.setChecked(False)
        former, records = self.model, list(self._records)
        if former is not None and records:
            sentence = f"Tracking {former.mesh.name} ended after {len(records)} poses, because a mesh was opened."
            ask = partial(self._ask_export, records)
            self.messages.show_message("former", Severity.INFO, sentence, [("Save them…", ask)])
        self.model, self.tracked = model, None
        self._records.clear()
        self.plot.clear()
        self.session.start(TruthState())
        self.messages.show_message("mesh", Severity.INFO, f"{model.mesh.assumed}.")
        self.views.show_model(model)
        self._show()

    def dragEnterEvent(self, event: QDragEnterEvent | None) -> None:
        """Accept one mesh."""
        if event is not None and any(path.suffix.lower() in SUFFIXES for path in local_files(event.mimeData())):
            event.acceptProposedAction()

    def dropEvent(self, event: QDropEvent | None) -> None:
        """Open the dropped mesh."""
        if event is not None:
            event.acceptProposedAction()
            self.open_mesh(next(p for p in local_files(event.mimeData()) if p.suffix.lower() in SUFFIXES))

    # The start

    @property
    def _patch(self) -> FrozenPatch | None:
        """The patch on the screen."""
        if self.track_button.isChecked() and self.tracked is not None:
            return self.tracked.patch
        return self.session.state.patch or self._live

    def _click(self, side: Side, place: tuple[float, float, float]) -> None:
        if self.model is not None and not self.track_button.isChecked():
            self.session.click(side, place, self._patch)

    def _center(self) -> None:
        """Move the model's centre onto the patch's."""
        patch = self._patch
        if self.model is None or patch is None or not len(patch.points):
            self._complain("pose", "There is no patch to move the model onto; press the object into the membrane.")
            return
        pose = np.eye(4) if self.session.state.pose is None else np.array(self.session.state.pose)
        pose[:3, 3] += patch.points.mean(axis=0, dtype=np.float64) - self.model.centre(pose)
        self.session.set_pose(pose, "hand", "Move the model onto the patch", None)

    def _search(self) -> None:
        if self.model is None or self._result is None:
            return
        self.track_button.setChecked(False)
        self._complain("find", "")
        finder, result = FrameTracker(self.model.mesh, None), self._result
        self._show_busy(0.0, f"Searching for {self.model.mesh.name}")
        self._finding.start(partial(finder.find, result))
        self._show()

    def _found(self, pose: Float64Array) -> None:
        self._show_busy(1.0, "")
        self.session.set_pose(pose, "ICP", "Find the object", None)
        self.track_button.setChecked(True)

    def _give_up(self) -> None:
        """Cancel reading and searching."""
        for job in (self._loading, self._finding):
            job.cancel()

    # Tracking

    def _toggled(self, on: bool) -> None:
        if on and self.model is not None:
            try:
                import_open3d()
            except MissingExtraError as error:
                self._complain("track", f"{error}.")
                self.track_button.setChecked(False)
                return
            if self.session.state.patch is not None:
                self.session.freeze(None)
            self._tracker = FrameTracker(self.model.mesh, self.session.state.pose)
            self.tracked = None
            self._complain("track", "")
            self._step()
        elif not on:
            self._tracker = None
            tracked = self.tracked
            if tracked is not None and not tracked.estimate.lost:
                pose = tracked.estimate.T_proximity_object
                self.session.set_pose(pose, "ICP", "Keep the tracked pose", None)
            self._live = None if self._result is None else FrozenPatch.of(self._result, "")
        self._show()

    def _step(self) -> None:
        """Track in the newest frame; one that waits for the present step is replaced by a newer one."""
        tracker, result = self._tracker, self._result
        if tracker is not None and result is not None:
            self._tracking.start(lambda _: (tracker, self._track(tracker, result)))

    def _track(self, tracker: FrameTracker, result: Result) -> Tracked | None:
        """Track in a frame; the pose is published at once, not when the window has time."""
        tracked = tracker.track(result)
        if tracked is not None and not tracked.estimate.lost and tracker is self._tracker:
            self._worker.put_pose(tracked.estimate)
        return tracked

    def _follow(self, done: tuple[FrameTracker, Tracked | None]) -> None:
        tracker, tracked = done
        if tracker is not self._tracker or tracked is None:
            return
        self.tracked = tracked
        estimate, error = tracked.estimate, tracked.error
        nan = math.nan
        self.plot.add(
            estimate.time_s,
            1e3 * estimate.residual_m,
            nan if error is None else 1e3 * error.position_m,
            nan if error is None else math.degrees(error.angle_rad),
        )
        self._records.append(pose_record(estimate) | error_record(error))
        if self.isVisible():
            self._show()

    # Files

    def _ask_export(self, records: list[dict[str, Any]]) -> None:
        self._dialogs.over(self.window() or self).save_file(
            "export", "Export the poses", "poses.csv", _EXPORTS, partial(self._write, records)
        )

    def _write(self, records: list[dict[str, Any]], path: Path) -> None:
        def write(_progress: object) -> str:
            save_poses(path, records)
            return f"{len(records)} poses were written to {path}."

        self._writing.start(write)

    def _wrote(self, sentence: str) -> None:
        self.messages.show_message("export", Severity.INFO, sentence)

    # Display

    def _failed(self, subject: str, sentence: str) -> None:
        self._show_busy(1.0, "")
        self._show()
        self._complain(subject, sentence and f"{sentence[0].upper()}{sentence[1:]}.")

    def _complain(self, subject: str, sentence: str) -> None:
        self.messages.state(subject, Severity.WARNING, sentence)

    def _show_busy(self, share: float, words: str) -> None:
        busy = share < 1
        for widget in (self.progress, self.cancel):
            widget.setVisible(busy)
        self.progress.show_share(share, words)

    def _show(self) -> None:
        model, state, tracking = self.model, self.session.state, self.track_button.isChecked()
        estimate = self.tracked.estimate if tracking and self.tracked is not None else None
        self.guide.setText(self._next_step(estimate))
        for widget in (self.find_button, self.track_button):
            widget.setEnabled(model is not None and self._result is not None)
        self.export.setEnabled(bool(self._records))
        self.align.setEnabled(model is not None and not tracking)
        for panel, shown in ((self.pose, tracking), (self.errors, self.plot.filled), (self.align, not tracking)):
            panel.setVisible(shown)
        if not tracking:
            apart = () if state.pose is None else pair_errors_m(state.pose, *state.matched)
            self.align.show_pairs(state.pairs, [1e3 * float(metres) for metres in apart])
            self.align.show_pose(state.pose, model.centre(state.pose) if model and state.pose else None)
        self.pose.show_estimate(estimate)
        self.views.show_patch(self._patch, model, state, estimate, tracking)

    def _next_step(self, estimate: PoseEstimate | None) -> str:
        """Return the state of tracking or the next step, as a sentence."""
        state, patch = self.session.state, self._patch
        if self.model is None:
            other = "Press Simulated object, or open" if self.simulated.isVisibleTo(self) else "Open"
            return f"{other} the mesh of the object that is pressed, or drop it here."
        if patch is None:
            return "There is no frame yet: open a source in the main window."
        if self.track_button.isChecked():
            return "Searching…" if estimate is None else tracking_words(estimate, contact=len(patch.points) > 0)
        return "Searching for the object…" if self._finding.busy else placing_words(state)

    def changeEvent(self, event: QEvent | None) -> None:
        """Follow the theme."""
        super().changeEvent(event)
        if event is not None and event.type() == QEvent.Type.PaletteChange and hasattr(self, "align"):
            self._show()


def placing_words(state: TruthState) -> str:
    """Return the next step of placing the model by hand."""
    if state.pending is not None:
        other = "patch" if state.pending.patch is None else "model"
        return f"Pair {len(state.pairs)}: now click the same point on the {other}."
    if state.pose is None:
        return f"Press Find; or click a point on the model, then the same on the patch, {MIN_PAIRS} times; then Track."
    return "Press Track; or drag the model's arrows and rings, or type numbers, until it lies on the patch."


def tracking_words(estimate: PoseEstimate, *, contact: bool) -> str:
    """Return the state of tracking."""
    if estimate.lost and contact:
        return "Lost: the model does not fit the patch; searching."
    if estimate.lost:
        return "No contact: waiting for the object."
    free = ", ".join(direction.name for direction in estimate.free)
    return f"Tracking; not determined: {free}." if free else "Tracking."
