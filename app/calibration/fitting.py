"""From the session's pairs to the core's fit and back to the pages, on another thread."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PyQt6.QtCore import QObject, pyqtSignal

from ...core.calibration import CalibrationReport, Correspondence, calibrate
from ...core.model.arrays import Float64Array
from ...core.model.clouds import valid_depth
from ...core.model.frames import Rig, SensorFrame
from ..worker.jobs import Job
from .outcome import Outcome, PairFit, at_least
from .pictures import tactile_depth_at
from .prediction import Alignment
from .session import Session
from .state import PointPair, SessionState, Snapshot
from .uncertainty import membrane_grid

FEWEST_PAIRS = 4
#: Places of the membrane over which the uncertainty is averaged: enough for a map, few enough for an instant.
FEWEST_PLACES, MOST_PLACES = 20, 120
_GRID_PX = 32
_WINDOW = 2
_SMOOTH_M = 0.004
#: A proximity depth counts as measured at contact where it is this near to the tactile depth, relatively.
_CONTACT_SHARE = 0.06


class Fitter(QObject):
    """Fits the session's pairs whenever they change; the newest state wins.

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
        """Whether a fit is going on."""
        return self._job.busy

    def refit(self) -> None:
        """Fit anew if anything that the fit rests on has changed."""
        state, rig = self._session.state, self._session.rig
        asked = (state.complete_pairs, state.choices.model, state.choices.fit_depth)
        if asked == self._asked:
            return
        self._asked = asked
        self._job.start(lambda _: fit(state, rig))

    def close(self) -> None:
        """Stop for good."""
        self._job.stop()


def fit(state: SessionState, rig: Rig) -> Outcome:
    """Fit the complete pairs of a state.

    Returns
    -------
    Outcome
        Without a report where there are too few pairs; its sentence says so.

    Raises
    ------
    CalibrationError
        The pairs determine nothing, or contradict each other.
    """
    pairs = state.complete_pairs
    enabled = sum(pair.enabled for pair in pairs)
    if enabled < FEWEST_PAIRS:
        return Outcome(pairs, sentence=f"{_pairs(enabled)}; {_pairs(FEWEST_PAIRS - enabled)} more for a first fit.")
    report = calibrate(
        correspondences(state, rig),
        rig,
        model=state.choices.model,
        depth_scale=state.choices.fit_depth,
        membrane=_membrane(state, rig),
    )
    return outcome_of(pairs, report)


def outcome_of(pairs: tuple[PointPair, ...], report: CalibrationReport) -> Outcome:
    """Bring a report to the terms of the pages."""
    chosen = report.chosen
    fits = {
        int(pair.id): PairFit(pair.residual_u, pair.residual_v, pair.residual_mm, pair.left_out_px, pair.used)
        for pair in chosen.pairs
    }
    return Outcome(pairs, report, alignment_of(report), _line(report), fits)


def alignment_of(report: CalibrationReport) -> Alignment:
    """Return the alignment of the model that was chosen."""
    if report.model == "rigid" and report.rigid is not None:
        pose = report.rigid.pose
        return Alignment(pose=report.rigid.T_proximity_tactile, scale=pose.scale, offset_m=pose.offset_m)
    assert report.homography is not None
    return Alignment(homography=report.homography.H_p_t)


def correspondences(state: SessionState, rig: Rig) -> list[Correspondence]:
    """Return the complete pairs as the core takes them."""
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
    """Bring read points to pairs; those without a tactile depth get it from their snapshot or the present one."""
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
    """Return places of the membrane in all snapshots, over which the alignment matters; None without snapshots."""
    grids = [membrane_grid(snapshot.frame, rig, _GRID_PX) for snapshot in state.snapshots]
    places = np.concatenate(grids) if grids else np.empty((0, 3))
    if len(places) < FEWEST_PLACES:
        return None
    return places[:: -(-len(places) // MOST_PLACES)]


def _contact_depth(pair: PointPair, snapshot: Snapshot | None, rig: Rig) -> float | None:
    """Return the proximity depth under a click in the depth image, where it was measured at contact."""
    if pair.proximity_image != "depth" or snapshot is None or pair.proximity is None or pair.tactile_depth_m is None:
        return None
    depth = _smooth_proximity_depth(snapshot.frame, rig, *pair.proximity)
    if depth is None or abs(depth - pair.tactile_depth_m) > _CONTACT_SHARE * depth:
        return None
    return depth


def _smooth_proximity_depth(frame: SensorFrame, rig: Rig, u: float, v: float) -> float | None:
    """Return the median proximity depth of a small window, None at an edge or a hole."""
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
    """Say in one line how the fit stands."""
    chosen = report.chosen
    used = sum(pair.used for pair in chosen.pairs)
    parts = [f"{report.model}, {_pairs(used)}"]
    if chosen.rms_px is None:
        parts.append("an exact fit says nothing about quality: click at least six pairs")
    else:
        parts.append(f"residual {chosen.rms_px:.2f} px")
        if chosen.cross_validated_px is not None:
            parts.append(f"left out {chosen.cross_validated_px:.2f} px")
        parts.append(f"error {at_least(chosen.alignment_mm, 'mm')}")
    if chosen.excluded:
        parts.append(f"{len(chosen.excluded)} excluded")
    return ", ".join(parts)


def _pairs(number: int) -> str:
    return "1 pair" if number == 1 else f"{number} pairs"
