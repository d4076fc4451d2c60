"""Writes strain: a picture of map and curve, and the curve's points beside it."""

from __future__ import annotations

from pathlib import Path

from PyQt6.QtGui import QImage

from ...core.atomic import atomic_path
from ...core.errors import ExportError


def write_strain(picture: QImage, points: str, path: Path) -> str:
    """Write ``path``; a picture gets the points as CSV of the same name beside it. Return a sentence that says so.

    Raises
    ------
    ExportError
        The place cannot be written, or the CSV would replace a file that belongs to no such picture.
    """
    numbers = path if picture.isNull() else path.with_suffix(".csv")
    if numbers != path and numbers.exists() and not path.exists():
        raise ExportError(f"{numbers} exists already and would be replaced; choose another name")
    with atomic_path(numbers) as temporary:
        temporary.write_text(points, encoding="utf-8")
    if picture.isNull():
        return f"The curve was written to {path}."
    with atomic_path(path) as temporary:
        if not picture.save(str(temporary), "PNG"):
            raise ExportError(f"cannot write the picture {path}; choose another place")
    return f"Map and curve were written to {path} and {numbers.name}."
