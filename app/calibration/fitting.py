"""Fitting the session's pairs on another thread, and the fit's result for each pair."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import nan

import numpy as np
from PyQt6.QtCore import QObject, pyqtSignal

from ...core.calibration import CalibrationReport, Correspondence, calibrate
from ...core.calibration.correspondences import enabled_pairs
from ...core.calibration.distortion import DistortionAdvice, advise_distortion
from ...core.calibration.report import standing_out
from ...core.errors import CalibrationError, counted
from ...core.model.arrays import Float64Array
from ...core.model.clouds import valid_depth
from ...core.model.frames import Rig, SensorFrame
from ...widgets.basics.point_table import PointRow
from ...widgets.images.marks import Mark, MarkKind
from ..worker.jobs import Job
from .pictures import membrane_grid, tactile_depth_at
from .prediction import Alignment
from .session import ImageChoice, PointPair, Session, SessionState, Side, Snapshot

#: With more pairs, only those that stand out or are selected have their numbers drawn.
_MAX_LABELS = 120
_NAN_PAIR = (nan, nan)


@dataclass(frozen=True)
class PairFit:
    """Residuals of one pair in proximity pixels; nan if unknown."""

    dx: float = nan
    dy: float = nan
    residual_mm: float = nan
    left_out_px: float = nan
    used: bool = True

    @property
    def residual_px(self) -> float:
        """Norm of the residual, pixels."""
        return float(np.hypot(self.dx, self.dy))


@dataclass(frozen=True, eq=False)
class Outcome:
    """A fit, or the reason why there is none.

    Attributes
    ----------
    pairs : tuple of PointPair
        The pairs that were fitted.
    sentence : str
        The reason, or a summary of the fit in one line.
    distortion : DistortionAdvice
        Lens distortion that the pairs show.
    """

    pairs: tuple[PointPair, ...] = ()
    report: CalibrationReport | None = None
    alignment: Alignment | None = None
    sentence: str = ""
    fits: dict[int, PairFit] = field(default_factory=dict)
    distortion: DistortionAdvice = field(default_factory=DistortionAdvice)

    @property
    def rejected(self) -> frozenset[int]:
        """Keys of the pairs that the fit rejects, because the others contradict them."""
        return frozenset(key for key, fit in self.fits.items() if not fit.used)

    @property
    def worst(self) -> frozenset[int]:
        """Keys of the pairs that stand out."""
        return frozenset() if self.report is None else frozenset(map(int, standing_out(self.report.chosen)))


def at_least(value: float, unit: str) -> str:
    """Format an error. A value below 0.01 is written as "below" it, never as zero."""
    return f"below 0.01 {unit}" if value < 0.01 else f"{value:.2f} {unit}"


def table_rows(state: SessionState, outcome: Outcome) -> list[PointRow]:
    """Return the rows of the point table."""
    return [_row(state, pair, outcome) for pair in state.pairs]


def image_marks(
    state: SessionState,
    outcome: Outcome,
    side: Side,
    rig: Rig,
    selected: tuple[int, ...],
    *,
    everywhere: bool = False,
) -> list[Mark]:
    """Return the marks of one image: pairs clicked in images with the same pixels.

    Only pairs of the current snapshot, or of all snapshots with ``everywhere``.
    """
    marks = []
    few = len(state.pairs) <= _MAX_LABELS
    for pair in state.pairs:
        place = pair.place(side)
        if place is None or not (everywhere or pair.snapshot in {"", state.choices.snapshot}):
            continue
        if side == "proximity" and not same_pixels(pair, state.choices.proximity_image, rig):
            continue
        fit = outcome.fits.get(pair.key)
        arrow = (-fit.dx, -fit.dy) if side == "proximity" and fit is not None and np.isfinite(fit.dx) else None
        kind, chosen = _kind(pair, outcome), pair.key in selected
        label = str(pair.key) if few or chosen or kind is MarkKind.WORST else ""
        marks.append(Mark(pair.key, *place, label, kind, chosen, arrow))
    return marks


def same_pixels(pair: PointPair, choice: ImageChoice, rig: Rig) -> bool:
    """Whether a pair's proximity pixel refers to the image that is shown."""
    if rig.proximity_color is None:
        return True
    return (pair.proximity_image == "color") == (choice == "color")


def missing_depth(state: SessionState) -> list[int]:
    """Return the pairs whose tactile click has no depth."""
    return [pair.key for pair in state.pairs if pair.tactile is not None and pair.tactile_depth_m is None]


def _kind(pair: PointPair, outcome: Outcome) -> MarkKind:
    if not pair.complete:
        return MarkKind.PENDING
    if not pair.enabled:
        return MarkKind.OFF
    return MarkKind.WORST if pair.key in outcome.worst else MarkKind.POINT


def _row(state: SessionState, pair: PointPair, outcome: Outcome) -> PointRow:
    fit = outcome.fits.get(pair.key, PairFit())
    return PointRow(
        key=pair.key,
        enabled=pair.enabled,
        left=pair.proximity or _NAN_PAIR,
        right=pair.tactile or _NAN_PAIR,
        depth_m=nan if pair.tactile_depth_m is None else pair.tactile_depth_m,
        dx=fit.dx,
        dy=fit.dy,
        residual_px=fit.residual_px,
        residual_mm=fit.residual_mm,
        left_out_px=fit.left_out_px,
        note=_origin(state, pair),
        worst=pair.key in outcome.worst,
        hint=_hint(pair, fit, outcome),
    )


def _origin(state: SessionState, pair: PointPair) -> str:
    snapshot = state.snapshot_of(pair)
    parts = [f"{pair.origin} in {'colour' if pair.proximity_image == 'color' else 'depth'}"]
    if snapshot is not None:
        parts.append(snapshot.name)
    return ", ".join(parts)


def _hint(pair: PointPair, fit: PairFit, outcome: Outcome) -> str:
    if not pair.complete:
        return "Click the same point in the other image, or press Esc to remove this click."
    if pair.tactile_depth_m is None:
        return (
            "The tactile camera has no depth here, so only the homography can use this pair; "
            "move the right point by a few pixels, or average more frames."
        )
    if not fit.used:
        return "This pair is rejected, because the others contradict it; check both points."
    if pair.key in outcome.worst:
        return "This pair may be wrong, or its residual is large; check both points, or disable it."
    return ""


MIN_PAIRS = 4
#: Number of membrane points over which the uncertainty is averaged: enough for a map, fast enough to be instant.
MIN_PLACES, MAX_PLACES = 20, 120
_GRID_PX = 32
_WINDOW = 2
_SMOOTH_M = 0.004
#: A proximity depth counts as measured at contact if it differs from the tactile depth by less than this share.
_CONTACT_SHARE = 0.06


class Fitter(QObject):
    """Fits the session's pairs whenever they change. Only the newest state is fitted.

    Signals
    -------
    fitted(Outcome)
    busyChanged(bool)
    """

    fitted = pyqtSignal(object)
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
        choices = state.choices
        asked = (state.complete_pairs, choices.model, choices.depth_fit, choices.estimate_distortion)
        if asked == self._asked:
            return
        self._asked = asked
        self._job.start(lambda _: fit(state, rig))

    def close(self) -> None:
        """Stop permanently."""
        self._job.stop()


def fit(state: SessionState, rig: Rig) -> Outcome:
    """Fit the complete pairs of a state.

    Returns
    -------
    Outcome
        Without a report if there are too few pairs, or if they determine no alignment or contradict each other; its
        sentence says so.
    """
    pairs = state.complete_pairs
    missing = missing_pairs(state)
    if missing:
        return Outcome(pairs, sentence=missing)
    found = correspondences(state, rig)
    try:
        report = calibrate(
            found,
            rig,
            model=state.choices.model,
            depth_fit=state.choices.depth_fit,
            membrane=_membrane(state, rig),
            estimate_distortion=state.choices.estimate_distortion,
        )
    except CalibrationError as error:
        return Outcome(pairs, sentence=str(error), distortion=advise_distortion(enabled_pairs(found), rig))
    return outcome_of(pairs, report)


def missing_pairs(state: SessionState) -> str:
    """Say how many pairs a first fit still needs; empty if there are enough."""
    enabled = sum(pair.enabled for pair in state.complete_pairs)
    more = MIN_PAIRS - enabled
    return f"{counted(enabled, 'pair')}; {counted(more, 'pair')} more for a first fit." if more > 0 else ""


def outcome_of(pairs: tuple[PointPair, ...], report: CalibrationReport) -> Outcome:
    """Convert a report for the pages."""
    chosen = report.chosen
    fits = {
        int(pair.id): PairFit(pair.residual_u, pair.residual_v, pair.residual_mm, pair.left_out_px, pair.used)
        for pair in chosen.pairs
    }
    return Outcome(pairs, report, alignment_of(report), _line(report), fits, report.distortion)


def alignment_of(report: CalibrationReport) -> Alignment:
    """Return the alignment of the model that was chosen."""
    if report.model == "rigid" and report.rigid is not None:
        pose = report.rigid.pose
        return Alignment(pose=report.rigid.T_proximity_tactile, scale=pose.scale, offset_m=pose.offset_m)
    assert report.homography is not None
    return Alignment(homography=report.homography.H_p_t)


def correspondences(state: SessionState, rig: Rig) -> list[Correspondence]:
    """Convert the complete pairs to correspondences."""
    numbers = {snapshot.digest: number for number, snapshot in enumerate(state.snapshots)}
    found = []
    for pair in state.complete_pairs:
        assert pair.proximity is not None and pair.tactile is not None
        found.append(
            Correspondence(
                id=str(pair.key),
                proximity_u=pair.proximity[0],
                proximity_v=pair.proximity[1],
                tactile_u=pair.tactile[0],
                tactile_v=pair.tactile[1],
                tactile_depth_m=pair.tactile_depth_m,
                enabled=pair.enabled,
                proximity_image=pair.proximity_image,
                snapshot=numbers.get(pair.snapshot),
                proximity_depth_m=_contact_depth(pair, state.snapshot_of(pair), rig),
            )
        )
    return found


def pairs_of(points: Sequence[Correspondence], state: SessionState, rig: Rig, origin: str) -> list[PointPair]:
    """Convert imported points to pairs. A missing tactile depth is read from their snapshot or the current one."""
    pairs = []
    for number, point in enumerate(points):
        known = point.snapshot is not None and point.snapshot < len(state.snapshots)
        snapshot = state.snapshots[point.snapshot] if known and point.snapshot is not None else state.snapshot
        depth = point.tactile_depth_m
        if depth is None and snapshot is not None:
            depth = tactile_depth_at(snapshot.frame, rig, *point.tactile)
        pairs.append(
            PointPair(
                key=number + 1,
                enabled=point.enabled,
                proximity=point.proximity,
                tactile=point.tactile,
                tactile_depth_m=depth,
                proximity_image=point.proximity_image,
                snapshot=snapshot.digest if known and snapshot is not None else "",
                origin=origin,
            )
        )
    return pairs


def _membrane(state: SessionState, rig: Rig) -> Float64Array | None:
    """Return membrane points of all snapshots, where the alignment matters; None without snapshots."""
    grids = [membrane_grid(snapshot.frame, rig, _GRID_PX) for snapshot in state.snapshots]
    places = np.concatenate(grids) if grids else np.empty((0, 3))
    if len(places) < MIN_PLACES:
        return None
    return places[:: -(-len(places) // MAX_PLACES)]


def _contact_depth(pair: PointPair, snapshot: Snapshot | None, rig: Rig) -> float | None:
    """Return the proximity depth under a click in the depth image if it was measured at contact, else None."""
    if pair.proximity_image != "depth" or snapshot is None or pair.proximity is None or pair.tactile_depth_m is None:
        return None
    depth = _smooth_proximity_depth(snapshot.frame, rig, *pair.proximity)
    if depth is None or abs(depth - pair.tactile_depth_m) > _CONTACT_SHARE * depth:
        return None
    return depth


def _smooth_proximity_depth(frame: SensorFrame, rig: Rig, u: float, v: float) -> float | None:
    """Return the median proximity depth of a small window; None at an edge or a hole."""
    height, width = frame.proximity_depth.shape
    column, row = round(u), round(v)
    if not (_WINDOW <= column < width - _WINDOW and _WINDOW <= row < height - _WINDOW):
        return None
    window = frame.proximity_depth[row - _WINDOW : row + _WINDOW + 1, column - _WINDOW : column + _WINDOW + 1]
    depths = window[valid_depth(window)] * rig.proximity.depth_unit_m
    if len(depths) < window.size // 2 or np.ptp(depths) > _SMOOTH_M:
        return None
    return float(np.median(depths))


def _line(report: CalibrationReport) -> str:
    """Summarise the fit in one line."""
    chosen = report.chosen
    used = sum(pair.used for pair in chosen.pairs)
    parts = [f"{report.model}, {counted(used, 'pair')}"]
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
