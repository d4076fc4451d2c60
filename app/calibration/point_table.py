"""The table of point pairs: how deep they are, how well they agree with the fit, and what to do about them."""

from __future__ import annotations

from dataclasses import dataclass
from math import nan

from PyQt6.QtCore import Qt

from ...core.calibration.report import PairQuality
from ...core.model.alignment import PointPair
from ...widgets.basics.record_table import Column, RecordTable
from .fitting import Outcome
from .session import SessionState


@dataclass(frozen=True)
class PointRow:
    """A pair under the fit, and where it comes from or what to do about it; marked if it stands out."""

    pair: PointPair
    fit: PairQuality
    note: str = ""
    marked: bool = False


def table_rows(state: SessionState, outcome: Outcome) -> list[PointRow]:
    fits, worst = outcome.fits, outcome.worst
    rows = []
    for pair in state.pairs:
        fit = fits.get(pair.id, PairQuality(pair.id))
        snapshot = state.snapshot_of(pair)
        note = f"{pair.origin} in {'colour' if pair.proximity_image == 'color' else 'depth'}"
        if snapshot is not None:
            note += f", {snapshot.name}"
        if not pair.complete:
            note = "Click the same point in the other image, or press Esc to remove this click"
        elif pair.tactile_depth_m is None:
            note = "No depth under the right point: only the homography can use this pair; move the point a few pixels"
        elif pair.id in fits and not fit.used:
            note = "Rejected, because the others contradict it; check both points"
        elif pair.id in worst:
            note = "The residual is large; check both points, or disable the pair"
        rows.append(PointRow(pair, fit, note, pair.id in worst))
    return rows


class PointTable(RecordTable):
    """Shows pairs; sorted by any column, the worst on top at first, those that stand out highlighted."""

    def __init__(self) -> None:
        def number(title: str, tip: str, value: str, decimals: int = 2) -> Column:
            return Column(title, lambda row: getattr(row.fit, value), tip, decimals, sample="-0000.00")

        def depth_mm(row: PointRow) -> float:
            return nan if row.pair.tactile_depth_m is None else 1e3 * row.pair.tactile_depth_m

        columns = (
            Column("#", lambda row: float(row.pair.id), "Number of the pair", 0, sample="000"),
            Column(
                "On",
                lambda row: "",
                "Whether the fit uses the pair (space)",
                ticked=lambda row: row.pair.enabled,
                sample="000",
            ),
            number("Res. px", "Distance in the left image between the click and its fitted place", "residual_px"),
            number("Res. mm", "The residual at the point's depth, millimetres", "residual_mm"),
            Column("Depth mm", depth_mm, "Tactile depth at the right point, millimetres", 1, sample="-0000.00"),
            Column("Note", lambda row: row.note, hint=lambda row: row.note),
        )
        super().__init__(
            columns,
            "Point pairs",
            "Point pairs and their residuals: left is proximity, right is tactile",
            key=lambda row: row.pair.id,
            marked=lambda row: row.marked,
            sortable=True,
        )
        self.sortByColumn(2, Qt.SortOrder.DescendingOrder)
