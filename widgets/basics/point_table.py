"""The table of point pairs: where they are, how deep, and how well they agree with the fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isfinite, nan

from PyQt6.QtCore import Qt, pyqtSignal

from .record_table import Column, RecordTable


@dataclass(frozen=True)
class PointRow:
    """One pair as the table shows it: places and residuals in pixels; nan is shown as a dash.

    ``left_out_px`` is the residual when the fit was made without this pair, ``note`` says where the pair comes from,
    ``hint`` what to do about it.
    """

    key: int
    enabled: bool
    left: tuple[float, float] = (nan, nan)
    right: tuple[float, float] = (nan, nan)
    depth_m: float = nan
    dx: float = nan
    dy: float = nan
    residual_px: float = nan
    residual_mm: float = nan
    left_out_px: float = nan
    note: str = ""
    worst: bool = False
    hint: str = ""


class PointTable(RecordTable):
    """Shows pairs; sorted by any column, the worst highlighted."""

    #: Key, enabled: a person ticked or cleared a check mark; whoever listens answers with `set_rows`.
    enabledToggled = pyqtSignal(int, bool)

    def __init__(self) -> None:
        self._pending = False

        def number(title: str, tip: str, value: Callable[[PointRow], float], decimals: int = 2) -> Column:
            return Column(title, value, tip, decimals, hint=lambda row: row.hint, sample="-0000.00")

        def fitted(title: str, tip: str, name: str) -> Column:
            def value(row: PointRow) -> float | str:
                residual: float = getattr(row, name)
                return "…" if self._pending and row.enabled and not isfinite(residual) else residual

            return Column(title, value, tip, 2, hint=lambda row: row.hint, sample="-0000.00")

        columns = (
            Column("#", lambda row: float(row.key), "Number of the pair", 0, hint=lambda row: row.hint, sample="000"),
            Column(
                "On",
                lambda row: "",
                "Whether the fit uses the pair (space)",
                ticked=lambda row: row.enabled,
                sample="000",
            ),
            number("Left u", "Column in the left image, pixels", lambda row: row.left[0]),
            number("Left v", "Row in the left image, pixels", lambda row: row.left[1]),
            number("Right u", "Column in the right image, pixels", lambda row: row.right[0]),
            number("Right v", "Row in the right image, pixels", lambda row: row.right[1]),
            number("Depth mm", "Tactile depth at the right point, millimetres", lambda row: 1e3 * row.depth_m, 1),
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
            key=lambda row: row.key,
            marked=lambda row: row.worst,
            sortable=True,
        )
        self.ticked.connect(lambda row, on: self.enabledToggled.emit(row.key, on))

    def show_worst_first(self) -> None:
        """Sort by the residual, the largest on top; pairs without a residual come last."""
        titles = [column.title for column in self._model.columns]
        self.sortByColumn(titles.index("Res. px"), Qt.SortOrder.DescendingOrder)

    def rows(self) -> tuple[PointRow, ...]:
        return self.records()

    def set_rows(self, rows: Sequence[PointRow]) -> None:
        """Show these rows; the selection stays with its pairs."""
        self.set_records(rows)

    def show_pending(self, pending: bool) -> None:
        """Show that a fit is being computed: "…" instead of a dash where a residual is not known yet."""
        self._pending = pending
        self.set_records(self.records())
