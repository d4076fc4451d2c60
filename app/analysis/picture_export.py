"""Writes what a tab shows: a picture, and its numbers as CSV beside it."""

from __future__ import annotations

from pathlib import Path

from PyQt6.QtGui import QImage

from ...core.errors import ExportError
from ...core.model.files import atomic_path


def write_picture(picture: QImage | None, numbers: str, path: Path, what: str) -> str:
    """Write ``path`` as PNG and the numbers as CSV of the same name; without a picture, the numbers as ``path``.

    Parameters
    ----------
    picture : QImage or None
    numbers : str
        The text of the CSV.
    path : Path
    what : str
        Begins the sentence that is returned, such as ``"Frame 4 was"``.

    Raises
    ------
    ExportError
        The place cannot be written, or the CSV would replace a file that belongs to no such picture.
    """
    beside = path if picture is None else path.with_suffix(".csv")
    if picture is not None and beside.exists() and not path.exists():
        raise ExportError(f"{beside} exists already and would be replaced; choose another name")
    with atomic_path(beside) as temporary:
        temporary.write_text(numbers, encoding="utf-8")
    if picture is None:
        return f"{what} written to {path}."
    with atomic_path(path) as temporary:
        if not picture.save(str(temporary), "PNG"):
            raise ExportError(f"cannot write the picture {path}; choose another place")
    return f"{what} written to {path} and {beside.name}."
