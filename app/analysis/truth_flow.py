"""The work on a scan in the ground-truth tab, without widgets: threads, undo, saving."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from PyQt6.QtCore import QObject, QTimer, pyqtSignal

from ...core.errors import TactuneError
from ...core.estimation.start_pose import load_transform, pair_errors_m, save_transform
from ...core.lab.scan import PaintSettings
from ...core.model.arrays import Float64Array
from ...core.model.frames import Matrix4
from ...core.model.units import UNITS_M
from ...widgets.basics.messages import Severity
from ..worker.jobs import Job
from ..worker.results import Result
from .truth_state import MIN_PAIRS, FrozenPatch, Place, Side, TruthKeeper, TruthSession, TruthState
from .truth_work import (
    LoadedScan,
    Refinement,
    ScanContact,
    Scorer,
    Scores,
    centered_on,
    find_contact,
    load,
    pivot_of,
    refine,
)

_SCORE_DELAY_MS = 250
#: Pairs with a larger residual were clicked wrongly, or the scan has another shape.
_FAR_MM = 5.0


class TruthFlow(QObject):
    """Reads one scan at a time, finds its paint, aligns and scores it.

    Parameters
    ----------
    folder : Path
        Where work on scans is saved.
    preset_name : callable
        Returns the main window's preset for ``--preset``; empty if it is not saved.

    Signals
    -------
    scanChanged()
        The scan or its contact has changed.
    patchChanged()
        The displayed patch has changed.
    scoresChanged()
        `scores`, or the reason why there are none, has changed.
    refinedChanged()
        `refinement` has changed.
    message(key: str, severity: Severity, sentence: str)
        A message about one subject; an empty sentence removes the last one.
    loadProgress(share: float, words: str), refineProgress(share: float, words: str)
        A share of 1 or more, or below 0, means that it has ended.
    """

    scanChanged = pyqtSignal()
    patchChanged = pyqtSignal()
    scoresChanged = pyqtSignal()
    refinedChanged = pyqtSignal()
    message = pyqtSignal(str, object, str)
    loadProgress = pyqtSignal(float, str)
    refineProgress = pyqtSignal(float, str)

    def __init__(self, folder: Path, preset_name: Callable[[], str], parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._preset_name = preset_name
        self.session = TruthSession(self)
        self.keeper = TruthKeeper(self.session, folder, self)
        self.loaded: LoadedScan | None = None
        self.contact: ScanContact | None = None
        self.refinement: Refinement | None = None
        self.scores: Scores | None = None
        self._live: FrozenPatch | None = None
        self._live_result: Result | None = None
        self._result: Result | None = None
        self._shown: FrozenPatch | None = None
        self._wanted_paint: PaintSettings | None = None
        self._refined_on: FrozenPatch | None = None
        self._filed: tuple[Path, Matrix4] | None = None
        self._loading, self._finding, self._refining, self._scoring = Job(self), Job(self), Job(self), Job(self)
        self._scorer = Scorer()
        self._score_timer = QTimer(self)
        self._score_timer.setSingleShot(True)
        self._score_timer.setInterval(_SCORE_DELAY_MS)
        self._score_timer.timeout.connect(self._score)
        self._connect()

    def _connect(self) -> None:
        self.session.changed.connect(self._state_changed)
        self.session.refused.connect(lambda sentence: self.message.emit("pose", Severity.WARNING, sentence))
        self.keeper.failed.connect(lambda sentence: self.message.emit("keeping", Severity.WARNING, sentence))
        self._loading.progress.connect(self.loadProgress)
        self._loading.done.connect(self._scan_read)
        self._loading.failed.connect(self._scan_failed)
        self._finding.done.connect(self._contact_found)
        self._finding.failed.connect(lambda sentence: self.message.emit("paint", Severity.ERROR, sentence))
        self._refining.progress.connect(self.refineProgress)
        self._refining.done.connect(self._refined)
        self._refining.failed.connect(self._refining_failed)
        self._scoring.done.connect(self._scored)
        self._scoring.failed.connect(lambda sentence: self.message.emit("scores", Severity.WARNING, sentence))

    @property
    def state(self) -> TruthState:
        """The state of the current scan."""
        return self.session.state

    @property
    def patch(self) -> FrozenPatch | None:
        """The displayed patch: the frozen one, or else the main window's."""
        return self.state.patch or self._live

    @property
    def busy_loading(self) -> bool:
        """Whether a scan is being read."""
        return self._loading.busy

    @property
    def busy_refining(self) -> bool:
        """Whether ICP is running."""
        return self._refining.busy

    # The scan

    def open_scan(self, path: Path, unit: str) -> None:
        """Read a scan whose numbers are in a unit of `UNITS_M`; the current scan stays until that has succeeded."""
        self.message.emit("scan", Severity.ERROR, "")
        self.loadProgress.emit(0.0, f"Reading {path.name}")
        self._loading.start(partial(load, path, UNITS_M[unit]))

    def cancel_loading(self) -> None:
        """Keep the current scan."""
        self._loading.cancel()

    def _scan_read(self, loaded: LoadedScan) -> None:
        self.message.emit("scan", Severity.ERROR, "")  # of a unit that was passed on the way to this one
        self._refining.cancel()
        self.loaded, self.contact = loaded, None
        self._wanted_paint = None
        self._forget_refinement()
        kept_at = self.keeper.switch_to(loaded.key)
        self.loadProgress.emit(1.0, "")
        taken_up = f"Your work on this scan of {kept_at:%d %B %Y, %H:%M} was restored." if kept_at else ""
        self.message.emit("kept", Severity.INFO, taken_up)
        self.scanChanged.emit()

    def _scan_failed(self, sentence: str) -> None:
        self.loadProgress.emit(1.0, "")
        self.message.emit("scan", Severity.ERROR, sentence)

    def _contact_found(self, contact: ScanContact) -> None:
        if contact.loaded is not self.loaded:
            return
        self.contact = contact
        self.message.emit("paint", Severity.ERROR, "")
        self.scanChanged.emit()
        self._score_timer.start()

    # The patch

    def show_result(self, result: Result) -> None:
        """Show and score a frame of the main window, unless a patch is frozen."""
        self._result = result
        if self.state.patch is None:
            self._refresh_live()
            self._show_patch()
            if not self._score_timer.isActive():
                self._score_timer.start()

    def take_present(self) -> None:
        """Freeze the main window's current patch, in place of an earlier one."""
        self._refresh_live()
        if self._live is not None:
            self.session.freeze(self._live)

    def _refresh_live(self) -> None:
        if self._result is not None and self._result is not self._live_result:
            self._live, self._live_result = FrozenPatch.of(self._result, self._preset_name()), self._result

    @property
    def result(self) -> Result | None:
        """The main window's newest frame."""
        return self._result

    def _show_patch(self) -> None:
        if self.patch is not self._shown:
            self._shown = self.patch
            self.patchChanged.emit()

    # Alignment

    def click(self, side: Side, place: Place) -> None:
        """Process a clicked point, in the scan frame or the proximity frame."""
        self.session.click(side, place, self.patch)

    def residuals_mm(self) -> list[float]:
        """Return the distance between both points of each complete pair, in order; empty without a pose."""
        pose = self.state.pose
        return [] if pose is None else [1e3 * float(apart) for apart in pair_errors_m(pose, *self.state.matched)]

    def center_on_patch(self) -> None:
        """Move the scan's contact onto the patch without rotation, as a start for manual alignment."""
        patch = self.patch
        if self.contact is None or patch is None or not len(self.contact.points) or not len(patch.points):
            self.message.emit("pose", Severity.WARNING, "The scan cannot be aligned: scan and patch need contact.")
            return
        self.session.set_pose(centered_on(self.contact, patch.points), "hand", "Move the scan onto the patch", patch)

    def pivot(self) -> Float64Array | None:
        """Return the centre of rotation in the proximity frame; None without a pose."""
        if self.contact is None or self.state.pose is None:
            return None
        pose = np.asarray(self.state.pose)
        centre: Float64Array = pose[:3, :3] @ pivot_of(self.contact) + pose[:3, 3]
        return centre

    def refine(self, reach_m: float) -> None:
        """Refine the pose by ICP."""
        state, contact = self.state, self.contact
        if state.pose is None or contact is None or self.patch is None or self.busy_refining:
            return
        self.message.emit("refine", Severity.WARNING, "")
        self.refineProgress.emit(0.0, "Refining")
        self._refined_on = self.patch
        self._refining.start(partial(refine, contact, self.patch.points, state.pose, reach_m))

    def cancel_refining(self) -> None:
        """Cancel the refinement; the pose is unchanged."""
        self._refining.cancel()

    def _refined(self, refinement: Refinement) -> None:
        self.refineProgress.emit(1.0, "")
        if refinement.start != self.state.pose:
            self.message.emit("refine", Severity.INFO, "The scan was moved, so its refinement was discarded.")
            return
        self.session.set_pose(refinement.found.T_proximity_scan, "ICP", "Refine by ICP", self._refined_on)
        self.refinement = refinement
        self.refinedChanged.emit()

    def _refining_failed(self, sentence: str) -> None:
        self.refineProgress.emit(1.0, "")
        self.message.emit("refine", Severity.WARNING, sentence and f"{sentence[0].upper()}{sentence[1:]}.")

    def _forget_refinement(self) -> None:
        if self.refinement is not None:
            self.refinement = None
            self.refinedChanged.emit()

    # Files

    def save_transform(self, path: Path) -> None:
        """Write the pose for ``tactune evaluate recording --transform``."""
        if self.state.pose is None:
            return
        try:
            save_transform(path, self.state.pose)
        except TactuneError as error:
            self.message.emit("file", Severity.ERROR, str(error))
            return
        self._filed = path, self.state.pose
        self.message.emit("file", Severity.INFO, f"The transform was written to {path}.")
        self.scoresChanged.emit()

    def load_transform(self, path: Path) -> None:
        """Read the pose from a file."""
        try:
            pose = load_transform(path)
        except TactuneError as error:
            self.message.emit("file", Severity.ERROR, str(error))
            return
        self.message.emit("file", Severity.ERROR, "")
        self.session.set_pose(pose, "file", f"Load {path.name}", self.patch)

    def command(self) -> str:
        """Return the command line that repeats the scores; empty without scores."""
        loaded, patch = self.loaded, self.patch
        if loaded is None or patch is None or self.state.pose is None:
            return ""
        path, pose = self._filed or (self.keeper.transform_file, self.state.pose)
        transform = path if pose == self.state.pose else self.keeper.transform_file
        unit = next(name for name, metres in UNITS_M.items() if metres == loaded.unit_m)
        words = ["tactune", "evaluate", "recording", "--source", patch.source, "--frame", str(patch.frame)]
        words += ["--scan", str(loaded.path), "--unit", unit, "--transform", str(transform)]
        words += ["--preset", patch.preset] if patch.preset else []
        return shlex.join(words + _paint_words(self.state.paint))

    # Following the state

    def _state_changed(self, state: TruthState) -> None:
        if state.patch is None:
            self._refresh_live()
        self._show_patch()
        if self.loaded is not None and state.paint != self._wanted_paint:
            self._wanted_paint = state.paint
            self._finding.start(partial(find_contact, self.loaded, state.paint))
        if self.refinement is not None and state.pose != self.refinement.found.T_proximity_scan:
            self._forget_refinement()
        if self.scores is not None and state.pose != self.scores.pose:
            self.scores = None
            self.scoresChanged.emit()
        self._score_timer.start()

    def _score(self) -> None:
        pose, contact, patch = self.state.pose, self.contact, self.patch
        if pose is None or contact is None or patch is None:
            if self.scores is not None:
                self.scores = None
                self.scoresChanged.emit()
            return
        self._scoring.start(partial(self._scorer.score, contact, patch.points, patch.area_mm2, pose))

    def _scored(self, scores: Scores) -> None:
        self.message.emit("scores", Severity.WARNING, "")
        self.scores = scores if scores.pose == self.state.pose else None
        self.scoresChanged.emit()

    def shut_down(self) -> None:
        """Stop all threads and save the last state."""
        for job in (self._loading, self._finding, self._refining, self._scoring):
            job.stop()
        self._score_timer.stop()
        self.keeper.close()
        self.session.close()


def _paint_words(paint: PaintSettings) -> list[str]:
    """Return the options for settings that differ from the default paint."""
    usual, words = PaintSettings(), []
    for name in ("hue", "saturation", "value"):
        low, high = getattr(paint, name)
        if (low, high) != getattr(usual, name):
            words += ["--paint", f"{name}={low}:{high}"]
    if paint.least_area_mm2 != usual.least_area_mm2:
        words += ["--paint", f"least_area_mm2={paint.least_area_mm2:g}"]
    if paint.largest != usual.largest:
        words += ["--paint", f"largest={paint.largest}"]
    return words


def next_step(flow: TruthFlow) -> str:
    """Return the next step for the user, as a sentence."""
    loaded, contact, patch = flow.loaded, flow.contact, flow.patch
    if loaded is None:
        words = "Reading the scan…" if flow.busy_loading else "Open the object's painted scan, or drop it here."
    elif contact is None:
        words = "Finding the paint…"
    elif not contact.vertices.any():
        words = "No part of the scan has the touched paint's colour: pick it with the eyedropper."
    elif patch is None:
        words = "There is no frame yet: open a source in the main window to get a patch."
    elif not len(patch.points):
        words = "The patch is empty: show a frame with contact in the main window."
    elif flow.busy_refining:
        words = "Refining…"
    elif flow.state.pending is not None or flow.state.pose is None:
        words = _picking(flow.state)
    else:
        words = _nudging(flow)
    return words


def _picking(state: TruthState) -> str:
    pending, left = state.pending, MIN_PAIRS - len(state.matched[0])
    if pending is not None:
        other = "patch" if pending.patch is None else "scan"
        return f"Pair {len(state.pairs)}: now click the same point on the {other}."
    if left == MIN_PAIRS:
        return f"Click a point on the scan, then the same point on the patch: {MIN_PAIRS} pairs are needed."
    if left > 0:
        return f"{left} more pair{'s' if left > 1 else ''}: click far from the others, on the scan or the patch."
    return "These pairs do not determine a pose: add one elsewhere, or delete a wrong one."


def _nudging(flow: TruthFlow) -> str:
    if flow.state.origin == "ICP":
        return "Refined. Check it from several sides; save the transform, or move the handles and refine again."
    if flow.state.origin != "pairs":
        return "Move the scan's contact onto the patch: drag arrows and rings, or type numbers; then refine by ICP."
    worst = max(flow.residuals_mm(), default=0.0)
    if worst > _FAR_MM:
        return f"One pair is {worst:.1f} mm off: delete it or click it again, or refine by ICP if it looks right."
    return f"Fitted: the pairs agree within {worst:.1f} mm. Refine by ICP, or drag the handles."
