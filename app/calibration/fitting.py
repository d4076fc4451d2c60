"""Fitting the session's pairs on another thread, and the fit's result for each pair."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np
from pydantic import BaseModel
from PyQt6.QtCore import QObject, pyqtSignal

from ...core.calibration.calibrate import calibrate
from ...core.calibration.geometry import Alignment
from ...core.calibration.report import CalibrationReport, PairQuality
from ...core.errors import CalibrationError, counted
from ...core.model.alignment import PointPair, Side, SnapshotRecord
from ...core.model.arrays import Float64Array
from ...core.model.frames import Rig
from ...core.preset import Preset
from ...widgets.images.marks import Mark, MarkKind
from ..worker.jobs import Job
from .pictures import membrane_grid
from .session import ImageChoice, Session, SessionState, Snapshot, tactile_depth

#: With more pairs, only those that stand out or are selected have their numbers drawn.
_MAX_LABELS = 120
MIN_PAIRS = 4
#: Number of membrane points over which the uncertainty is averaged: enough for a map, fast enough to be instant.
_MIN_PLACES, _MAX_PLACES = 20, 120
_GRID_PX = 32
#: The preset fields that a calibration determines.
_FITTED = (
    "alignment.model",
    "alignment.rigid.T_proximity_tactile",
    "alignment.homography.H_p_t",
    "alignment.depth_scale",
    "alignment.depth_offset_m",
    "alignment.calibration",
    "rig",
)


@dataclass(frozen=True, eq=False)
class Outcome:
    """The fit of some pairs, or the reason why there is none."""

    pairs: tuple[PointPair, ...] = ()
    report: CalibrationReport | None = None
    problem: str = ""

    @property
    def alignment(self) -> Alignment | None:
        return None if self.report is None else self.report.chosen.fit.alignment

    @property
    def fits(self) -> dict[str, PairQuality]:
        return {} if self.report is None else {pair.id: pair for pair in self.report.chosen.pairs}

    @property
    def rejected(self) -> frozenset[str]:
        """Ids of the pairs that the fit rejects, because the others contradict them."""
        return frozenset() if self.report is None else frozenset(self.report.chosen.excluded)

    @property
    def standing_out(self) -> frozenset[str]:
        """Ids of the pairs that stand out."""
        return frozenset() if self.report is None else self.report.chosen.standing_out


class Fitter(QObject):
    """Fits the session's pairs whenever they change. Only the newest state is fitted."""

    fitted = pyqtSignal(object)  # Outcome

    def __init__(self, session: Session, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._session = session
        self._asked: tuple[object, ...] = ()
        self.job = Job(self, self.fitted.emit, lambda sentence: self.fitted.emit(Outcome(problem=sentence)))
        session.changed.connect(self.refit)

    def refit(self) -> None:
        state, rig = self._session.state, self._session.rig
        asked = (state.complete_pairs, state.choices.model)
        if asked != self._asked:
            self._asked = asked
            self.job.start(lambda _: fit(state, rig))


def fit(state: SessionState, rig: Rig) -> Outcome:
    """Fit the complete pairs of a state; without a report, the outcome's problem says why."""
    pairs = state.complete_pairs
    missing = missing_pairs(state)
    if missing:
        return Outcome(pairs, problem=missing)
    grids = [membrane_grid(snapshot.frame, rig, _GRID_PX) for snapshot in state.snapshots]
    places = np.concatenate([np.empty((0, 3)), *grids])
    membrane: Float64Array | None = places[:: -(-len(places) // _MAX_PLACES)] if len(places) >= _MIN_PLACES else None
    try:
        return Outcome(pairs, calibrate(pairs, rig, state.choices.model, membrane=membrane))
    except CalibrationError as error:
        return Outcome(pairs, problem=str(error))


def report_changes(report: CalibrationReport, preset: Preset, snapshots: Sequence[Snapshot]) -> dict[str, Any]:
    """Return the preset fields that a calibration changes, and their new values."""
    records = tuple(
        SnapshotRecord(name=snapshot.name, sha256=snapshot.digest, frames=snapshot.averaged) for snapshot in snapshots
    )
    applied = report.apply_to(preset, snapshots=records)
    values = {path: applied.value(path) for path in _FITTED}
    return {
        path: value.model_dump(mode="json") if isinstance(value, BaseModel) else value for path, value in values.items()
    }


def missing_pairs(state: SessionState) -> str:
    """Say how many pairs a first fit still needs; empty if there are enough."""
    enabled = sum(pair.enabled for pair in state.complete_pairs)
    more = MIN_PAIRS - enabled
    return f"{counted(enabled, 'pair')}; {counted(more, 'pair')} more for a first fit." if more > 0 else ""


def at_least(value: float, unit: str) -> str:
    """Format an error. A value below 0.01 is written as "below" it, never as zero."""
    return f"below 0.01 {unit}" if value < 0.01 else f"{value:.2f} {unit}"


def image_marks(
    state: SessionState,
    outcome: Outcome,
    side: Side,
    rig: Rig,
    selected: tuple[str, ...],
    *,
    everywhere: bool = False,
) -> list[Mark]:
    """Return the marks of one image: pairs of the current snapshot, or of all, clicked in images with its pixels."""
    marks = []
    few, fits, standing_out = len(state.pairs) <= _MAX_LABELS, outcome.fits, outcome.standing_out
    for pair in state.pairs:
        place = pair.place(side)
        if place is None or not (everywhere or pair.snapshot in {None, state.number}):
            continue
        if side == "proximity" and not same_pixels(pair, state.choices.image, rig):
            continue
        fit = fits.get(pair.id)
        arrow = (-fit.dx, -fit.dy) if side == "proximity" and fit is not None and isfinite(fit.dx) else None
        kind = MarkKind.POINT if pair.complete else MarkKind.PENDING
        if pair.complete and (not pair.enabled or pair.id in standing_out):
            kind = MarkKind.STANDING_OUT if pair.enabled else MarkKind.OFF
        chosen = pair.id in selected
        label = pair.id if few or chosen or kind is MarkKind.STANDING_OUT else ""
        marks.append(Mark(pair.id, *place, label, kind, chosen, arrow))
    return marks


def same_pixels(pair: PointPair, choice: ImageChoice, rig: Rig) -> bool:
    """Whether a pair's proximity pixel refers to the image that is shown."""
    return rig.proximity_color is None or pair.proximity_image == choice


def with_depth(points: Sequence[PointPair], state: SessionState, rig: Rig, origin: str) -> list[PointPair]:
    """Return imported pairs; a missing tactile depth is read from their snapshot or the current one."""
    pairs = []
    for point in points:
        snapshot = state.snapshot_of(point)
        values: dict[str, object] = {"snapshot": point.snapshot if snapshot is not None else None, "origin": origin}
        at = snapshot or state.snapshot
        if point.tactile_depth_m is None and at is not None and point.tactile is not None:
            values["tactile_depth_m"] = tactile_depth(at.frame, rig, *point.tactile)
        pairs.append(point.model_copy(update=values))
    return pairs
