"""What a fit says about the present pairs, in the terms of the pages."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import nan
from typing import TYPE_CHECKING

import numpy as np

from ...core.model.frames import Rig
from ...widgets.basics.point_table import PointRow
from ...widgets.images.marks import Mark, MarkKind
from .prediction import Alignment
from .state import ImageChoice, PointPair, SessionState, Side

if TYPE_CHECKING:
    from ...core.calibration import CalibrationReport

#: A residual is called worst when it is this many times the median and more than half a pixel.
_WORST_FACTOR = 2.5
_WORST_LEAST_PX = 0.5
_NAN_PAIR = (nan, nan)


@dataclass(frozen=True)
class PairFit:
    """Residuals of one pair in proximity pixels; nan where there are none."""

    dx: float = nan
    dy: float = nan
    residual_mm: float = nan
    left_out_px: float = nan
    used: bool = True

    @property
    def residual_px(self) -> float:
        """Length of the residual."""
        return float(np.hypot(self.dx, self.dy))


@dataclass(frozen=True, eq=False)
class Outcome:
    """A fit, or why there is none.

    Attributes
    ----------
    pairs : tuple of PointPair
        What it was made from.
    sentence : str
        The refusal, or one line on the fit.
    """

    pairs: tuple[PointPair, ...] = ()
    report: CalibrationReport | None = None
    alignment: Alignment | None = None
    sentence: str = ""
    fits: dict[int, PairFit] = field(default_factory=dict)

    @property
    def worst(self) -> frozenset[int]:
        """Keys of the pairs that stick out."""
        lengths = {key: fit.residual_px for key, fit in self.fits.items() if np.isfinite(fit.residual_px)}
        rejected = {key for key, fit in self.fits.items() if not fit.used}
        if len(lengths) < 5:
            return frozenset(rejected)
        limit = max(_WORST_FACTOR * float(np.median(list(lengths.values()))), _WORST_LEAST_PX)
        return frozenset(rejected | {key for key, length in lengths.items() if length > limit})


def at_least(value: float, unit: str, decimals: int = 2) -> str:
    """Write an error, never as zero: below the last decimal it is "below" that."""
    smallest = 10.0**-decimals
    return f"below {smallest:.{decimals}f} {unit}" if value < smallest else f"{value:.{decimals}f} {unit}"


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

    Those of the present snapshot, or with ``everywhere`` of all.
    """
    marks = []
    for pair in state.pairs:
        place = pair.place(side)
        if place is None or not (everywhere or pair.snapshot in {"", state.choices.snapshot}):
            continue
        if side == "proximity" and not same_pixels(pair, state.choices.proximity_image, rig):
            continue
        fit = outcome.fits.get(pair.key)
        arrow = (-fit.dx, -fit.dy) if side == "proximity" and fit is not None and np.isfinite(fit.dx) else None
        kind = _kind(pair, outcome)
        marks.append(Mark(pair.key, *place, str(pair.key), kind, pair.key in selected, arrow))
    return marks


def same_pixels(pair: PointPair, choice: ImageChoice, rig: Rig) -> bool:
    """Whether a pair's proximity place is in the pixels of the image that is shown."""
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
        return "This click waits for its partner in the other image; Esc takes it back."
    if pair.tactile_depth_m is None:
        return (
            "The tactile camera has no depth here, so only the homography can use this pair; "
            "move the right point by a few pixels, or average more frames."
        )
    if not fit.used:
        return "This pair contradicts the others and was left out of the fit; look at both points again."
    if pair.key in outcome.worst:
        return "This pair sticks out; look at both points again, or switch it off."
    return ""
