"""A comparison in words and numbers: beneath the views, in the table, on the clipboard and as CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable

from .comparer import Comparison, Outcome
from .method_looks import TRUTH

#: Title, unit and meaning of each column of the table.
COLUMNS: tuple[tuple[str, str, str], ...] = (
    ("Method", "", "Tick a method to see it; every method keeps its colour"),
    ("Time", "ms", "Computation of one frame, median of the last 15, while all else goes on beside it"),
    ("Points", "", "Points of the patch"),
    ("Area", "cm²", "Area of the patch, projected along the optical axis"),
    ("RMSE", "mm", "Average symmetric RMSE to the true contact: the mean of both directed RMS nearest distances"),
    ("IoU", "", "Pixels in patch and truth over pixels in either, 0 to 1"),
    ("Remark", "", "Why there is no patch, or no comparison"),
)
MISSING = "–"
_CSV_HEADER = (
    "source,preset,frame,method,averaged_frames,median_ms,points,area_mm2,symmetric_rmse_mm,iou,precision,recall,remark"
)  # fmt: skip


def cells(outcome: Outcome) -> tuple[str, ...]:
    """Return the table's columns after the first, without units."""
    scores = outcome.scores
    return (
        MISSING if outcome.ms is None else f"{outcome.ms:.1f}",
        MISSING if scores.points is None else f"{scores.points:,}",
        MISSING if scores.area_mm2 is None else f"{scores.area_mm2 / 100:.1f}",
        MISSING if scores.rmse_mm is None else f"{scores.rmse_mm:.2f}",
        MISSING if scores.iou is None else f"{scores.iou:.3f}",
        outcome.note,
    )


def method_cell(name: str, averaged: int) -> str:
    """Return the table's first column: the method, and over how many frames it has averaged where these are several."""
    return f"{name} ({averaged} frames)" if averaged > 1 else name


def caption(outcome: Outcome, truth: bool) -> str:
    """Return the lines beneath a view: time and size, and where truth is known, agreement with it."""
    time, points, area, rmse, iou, _ = cells(outcome)
    size = "no patch" if outcome.scores.points is None else f"{points} points · {area} cm²"
    first = size if outcome.ms is None else f"{time} ms · {size}"
    if not truth:
        return first
    return f"{first}\n" + ("what really touches" if outcome.name == TRUTH else f"RMSE {rmse} mm · IoU {iou}")


def table_text(rows: Iterable[tuple[str, ...]]) -> str:
    """Return rows of the table as tab-separated text under their titles with units."""
    titles = [f"{title} ({unit})" if unit else title for title, unit, _ in COLUMNS]
    return "\n".join("\t".join(row) for row in (titles, *rows))


def comparison_csv(comparison: Comparison) -> str:
    """Return a comparison as CSV, one row a method; what does not exist is empty, and the frame counts from 0."""
    result = comparison.task.result
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_CSV_HEADER.split(","))
    for outcome in comparison.outcomes:
        scores = outcome.scores
        averages = outcome.name != TRUTH and scores.points is not None
        numbers = (
            outcome.averaged_frames if averages else None,
            outcome.ms,
            scores.points,
            scores.area_mm2,
            scores.rmse_mm,
            scores.iou,
            scores.precision,
            scores.recall,
        )
        shown = [
            "" if number is None else f"{number:.6g}" if isinstance(number, float) else number for number in numbers
        ]
        writer.writerow(
            [result.source.name, result.preset.name, result.frame.sequence, outcome.name, *shown, outcome.note]
        )
    return text.getvalue()
