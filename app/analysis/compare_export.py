"""Writes a comparison: a picture, and its numbers beside it."""

from __future__ import annotations

from pathlib import Path

from PyQt6.QtGui import QImage

from ...core.atomic import atomic_path
from ...core.errors import ExportError
from .compare_text import comparison_csv
from .comparer import Comparison


def write_comparison(picture: QImage, comparison: Comparison, path: Path) -> str:
    """Write ``path`` as PNG and the same name as CSV; return a sentence that says so.

    Raises
    ------
    ExportError
        The place cannot be written, or the CSV would replace a file that belongs to no such picture.
    """
    numbers = path.with_suffix(".csv")
    if numbers.exists() and not path.exists():
        raise ExportError(f"{numbers} exists already and would be replaced; choose another name")
    with atomic_path(numbers) as temporary:
        temporary.write_text(comparison_csv(comparison), encoding="utf-8")
    with atomic_path(path) as temporary:
        if not picture.save(str(temporary), "PNG"):
            raise ExportError(f"cannot write the picture {path}; choose another place")
    return f"Frame {comparison.task.result.frame_number} written to {path} and {numbers.name}."
