"""The table of point pairs: where they are, how deep, and how well they agree with the fit."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isfinite, nan

from PyQt6.QtCore import Qt

from ...core.calibration.report import PairQuality
from ...core.model.alignment import PointPair
from ...widgets.basics.record_table import Column, RecordTable


@dataclass(frozen=True)
class PointRow:
    """A pair under the fit, where it comes from, and what to do about it; marked if it stands out."""

    pair: PointPair
    fit: PairQuality = field(default_factory=lambda: PairQuality(""))
    note: str = ""
    hint: str = ""
    marked: bool = False


class PointTable(RecordTable):
    """Shows pairs; sorted by any column, those that stand out highlighted."""

    def __init__(self) -> None:
        self._pending = False

        def fitted(title: str, tip: str, name: str) -> Column:
            def shown(row: PointRow) -> float | str:
                residual: float = getattr(row.fit, name)
                return "…" if self._pending and row.pair.enabled and not isfinite(residual) else residual

            return Column(title, shown, tip, 2, hint=lambda row: row.hint, sample="-0000.00")

        def placed(title: str, tip: str, name: str, scale: float = 1.0) -> Column:
            def shown(row: PointRow) -> float | str:
                value = getattr(row.pair, name)
                return nan if value is None else scale * value

            return Column(title, shown, tip, 2 if scale == 1.0 else 1, hint=lambda row: row.hint, sample="-0000.00")

        columns = (
            Column(
                "#", lambda row: float(row.pair.id), "Number of the pair", 0, hint=lambda row: row.hint, sample="000"
            ),
            Column(
                "On",
                lambda row: "",
                "Whether the fit uses the pair (space)",
                ticked=lambda row: row.pair.enabled,
                sample="000",
            ),
            placed("Left u", "Column in the left image, pixels", "proximity_u"),
            placed("Left v", "Row in the left image, pixels", "proximity_v"),
            placed("Right u", "Column in the right image, pixels", "tactile_u"),
            placed("Right v", "Row in the right image, pixels", "tactile_v"),
            placed("Depth mm", "Tactile depth at the right point, millimetres", "tactile_depth_m", 1e3),
            fitted("dX px", "Horizontal residual in the left image, pixels, positive to the right", "dx"),
            fitted("dY px", "Vertical residual in the left image, pixels, positive downwards", "dy"),
            fitted("Res. px", "Length of the residual in the left image, pixels", "residual_px"),
            fitted("Res. mm", "The residual at the point's depth, millimetres", "residual_mm"),
            fitted(
                "Left out px",
                "Residual in a fit without this pair, pixels. If much larger than the residual, the fit depends on it",
                "left_out_px",
            ),
            Column(
                "Origin",
                lambda row: row.note,
                "Image and snapshot that were clicked, or the helper that found it",
                hint=lambda row: row.hint or row.note,
            ),
        )
        super().__init__(
            columns,
            "Point pairs: left is proximity, right is tactile",
            "Point pairs and their residuals: left is proximity, right is tactile",
            key=lambda row: row.pair.id,
            marked=lambda row: row.marked,
            sortable=True,
        )
        titles = [column.title for column in columns]
        self.sortByColumn(titles.index("Res. px"), Qt.SortOrder.DescendingOrder)  # the worst on top

    def show_pending(self, pending: bool) -> None:
        """Show that a fit is being computed: "…" instead of a dash where a residual is not known yet."""
        self._pending = pending
        self.set_records(self.records())
