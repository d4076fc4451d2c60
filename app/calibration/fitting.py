"""Fitting the session's pairs on another thread, and the fit's result for each pair."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np
from PyQt6.QtCore import QObject, pyqtSignal

from ...core.calibration import CalibrationReport, calibrate
from ...core.calibration.geometry import Alignment
from ...core.calibration.report import PairQuality
from ...core.errors import CalibrationError, counted
from ...core.model.alignment import PointPair, Side
from ...core.model.arrays import Float64Array
from ...core.model.clouds import valid_depth
from ...core.model.frames import Rig
from ...widgets.images.marks import Mark, MarkKind
from ..worker.jobs import Job
from .pictures import membrane_grid, tactile_depth_at
from .point_table import PointRow
from .session import ImageChoice, Session, SessionState, Snapshot

#: With more pairs, only those that stand out or are selected have their numbers drawn.
_MAX_LABELS = 120
MIN_PAIRS = 4
#: Number of membrane points over which the uncertainty is averaged: enough for a map, fast enough to be instant.
_MIN_PLACES, _MAX_PLACES = 20, 120
_GRID_PX = 32
_WINDOW, _SMOOTH_M = 2, 0.004
#: A proximity depth counts as measured at contact if it differs from the tactile depth by less than this share.
_CONTACT_SHARE = 0.06


@dataclass(frozen=True, eq=False)
class Outcome:
    """The fit of some pairs with a summary in one line, or the reason why there is none."""

    pairs: tuple[PointPair, ...] = ()
    report: CalibrationReport | None = None
    sentence: str = ""

    @property
    def alignment(self) -> Alignment | None:
        """The alignment of the chosen model."""
        return None if self.report is None else self.report.chosen.fit.alignment

    @property
    def fits(self) -> dict[str, PairQuality]:
        """The pairs under the fit, by id."""
        return {} if self.report is None else {pair.id: pair for pair in self.report.chosen.pairs}

    @property
    def rejected(self) -> frozenset[str]:
        """Ids of the pairs that the fit rejects, because the others contradict them."""
        return frozenset() if self.report is None else frozenset(self.report.chosen.excluded)

    @property
    def worst(self) -> frozenset[str]:
        """Ids of the pairs that stand out."""
        return frozenset() if self.report is None else self.report.chosen.standing_out


def at_least(value: float, unit: str) -> str:
    """Format an error. A value below 0.01 is written as "below" it, never as zero."""
    return f"below 0.01 {unit}" if value < 0.01 else f"{value:.2f} {unit}"


def table_rows(state: SessionState, outcome: Outcome) -> list[PointRow]:
    """Return the rows of the point table."""
    fits, worst = outcome.fits, outcome.worst
    return [
        PointRow(
            pair=pair,
            fit=fits.get(pair.id, PairQuality(pair.id)),
            note=_origin(state, pair),
            hint=_hint(pair, fits.get(pair.id), pair.id in worst),
            marked=pair.id in worst,
        )
        for pair in state.pairs
    ]


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
    few, fits, worst = len(state.pairs) <= _MAX_LABELS, outcome.fits, outcome.worst
    for pair in state.pairs:
        place = pair.place(side)
        if place is None or not (everywhere or pair.snapshot in {None, state.number}):
            continue
        if side == "proximity" and not same_pixels(pair, state.choices.proximity_image, rig):
            continue
        fit = fits.get(pair.id)
        arrow = (-fit.dx, -fit.dy) if side == "proximity" and fit is not None and isfinite(fit.dx) else None
        kind = MarkKind.POINT if pair.complete else MarkKind.PENDING
        if pair.complete and (not pair.enabled or pair.id in worst):
            kind = MarkKind.WORST if pair.enabled else MarkKind.OFF
        chosen = pair.id in selected
        label = pair.id if few or chosen or kind is MarkKind.WORST else ""
        marks.append(Mark(pair.id, *place, label, kind, chosen, arrow))
    return marks


def same_pixels(pair: PointPair, choice: ImageChoice, rig: Rig) -> bool:
    """Whether a pair's proximity pixel refers to the image that is shown."""
    return rig.proximity_color is None or (pair.proximity_image == "color") == (choice == "color")


def _origin(state: SessionState, pair: PointPair) -> str:
    snapshot = state.snapshot_of(pair)
    where = f"{pair.origin} in {'colour' if pair.proximity_image == 'color' else 'depth'}"
    return where if snapshot is None else f"{where}, {snapshot.name}"


def _hint(pair: PointPair, fit: PairQuality | None, stands_out: bool) -> str:
    if not pair.complete:
        return "Click the same point in the other image, or press Esc to remove this click."
    if pair.tactile_depth_m is None:
        return (
            "The tactile camera has no depth here, so only the homography can use this pair; "
            "move the right point by a few pixels, or average more frames."
        )
    if fit is not None and not fit.used:
        return "This pair is rejected, because the others contradict it; check both points."
    return "The residual of this pair is large; check both points, or disable it." if stands_out else ""


class Fitter(QObject):
    """Fits the session's pairs whenever they change. Only the newest state is fitted."""

    fitted = pyqtSignal(object)  # Outcome
    busyChanged = pyqtSignal(bool)

    def __init__(self, session: Session, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._session = session
        self._asked: tuple[object, ...] = ()
        self._job = Job(self)
        self._job.done.connect(self.fitted)
        self._job.failed.connect(lambda sentence: self.fitted.emit(Outcome(sentence=sentence)))
        self._job.busyChanged.connect(self.busyChanged)
        session.changed.connect(self.refit)

    @property
    def busy(self) -> bool:
        """Whether a fit is running."""
        return self._job.busy

    def refit(self) -> None:
        """Fit again if any input of the fit has changed."""
        state, rig = self._session.state, self._session.rig
        asked = (state.complete_pairs, state.choices.model, state.choices.depth_fit)
        if asked != self._asked:
            self._asked = asked
            self._job.start(lambda _: fit(state, rig))

    def close(self) -> None:
        """Stop permanently."""
        self._job.stop()


def fit(state: SessionState, rig: Rig) -> Outcome:
    """Fit the complete pairs of a state; without a report, the outcome's sentence says why."""
    pairs = state.complete_pairs
    missing = missing_pairs(state)
    if missing:
        return Outcome(pairs, sentence=missing)
    grids = [membrane_grid(snapshot.frame, rig, _GRID_PX) for snapshot in state.snapshots]
    places = np.concatenate([np.empty((0, 3)), *grids])
    membrane: Float64Array | None = places[:: -(-len(places) // _MAX_PLACES)] if len(places) >= _MIN_PLACES else None
    try:
        report = calibrate(
            with_contact(state, rig),
            rig,
            model=state.choices.model,
            depth_fit=state.choices.depth_fit,
            membrane=membrane,
        )
    except CalibrationError as error:
        return Outcome(pairs, sentence=str(error))
    return Outcome(pairs, report, _line(report))


def missing_pairs(state: SessionState) -> str:
    """Say how many pairs a first fit still needs; empty if there are enough."""
    enabled = sum(pair.enabled for pair in state.complete_pairs)
    more = MIN_PAIRS - enabled
    return f"{counted(enabled, 'pair')}; {counted(more, 'pair')} more for a first fit." if more > 0 else ""


def with_contact(state: SessionState, rig: Rig) -> list[PointPair]:
    """Return the complete pairs with the proximity depth of those that were clicked at contact."""
    pairs = state.complete_pairs
    return [pair.model_copy(update={"proximity_depth_m": _contact_m(pair, state, rig)}) for pair in pairs]


def with_depth(points: Sequence[PointPair], state: SessionState, rig: Rig, origin: str) -> list[PointPair]:
    """Return imported pairs; a missing tactile depth is read from their snapshot or the current one."""
    pairs = []
    for point in points:
        snapshot = state.snapshot_of(point)
        values: dict[str, object] = {"snapshot": point.snapshot if snapshot is not None else None, "origin": origin}
        at: Snapshot | None = snapshot or state.snapshot
        if point.tactile_depth_m is None and at is not None and point.tactile is not None:
            values["tactile_depth_m"] = tactile_depth_at(at.frame, rig, *point.tactile)
        pairs.append(point.model_copy(update=values))
    return pairs


def _contact_m(pair: PointPair, state: SessionState, rig: Rig) -> float | None:
    """Return the proximity depth under a click in the depth image if it was measured at contact, else None.

    It is the median of a small window without edges and holes.
    """
    snapshot = state.snapshot_of(pair)
    if pair.proximity_image != "depth" or snapshot is None or pair.proximity is None or pair.tactile_depth_m is None:
        return None
    counts = snapshot.frame.proximity_depth
    column, row = (max(round(value) - _WINDOW, 0) for value in pair.proximity)
    window = counts[row : row + 2 * _WINDOW + 1, column : column + 2 * _WINDOW + 1]
    depths = window[valid_depth(window)] * rig.proximity.depth_unit_m
    if len(depths) < (2 * _WINDOW + 1) ** 2 // 2 or np.ptp(depths) > _SMOOTH_M:
        return None
    depth = float(np.median(depths))
    return depth if abs(depth - pair.tactile_depth_m) <= _CONTACT_SHARE * depth else None


def _line(report: CalibrationReport) -> str:
    """Summarise the fit in one line."""
    chosen = report.chosen
    parts = [f"{report.model}, {counted(sum(pair.used for pair in chosen.pairs), 'pair')}"]
    if chosen.rms_px is None:
        parts.append("an exact fit says nothing about quality: click at least six pairs")
    else:
        parts.append(f"residual {chosen.rms_px:.2f} px")
        if chosen.cross_validated_px is not None:
            parts.append(f"cross-validated residual {chosen.cross_validated_px:.2f} px")
        parts.append(f"error {at_least(chosen.alignment_mm, 'mm')}")
    if chosen.excluded:
        parts.append(f"{len(chosen.excluded)} rejected")
    return ", ".join(parts)
