"""From the name of a recording to its open files."""

from __future__ import annotations

from pathlib import Path

from ...errors import SourceError
from ...model.files import user_path
from ..base import Progress
from . import db3_recording, ros1_bag
from .bag_recording import BagRecording
from .db3_recording import Db3Recording
from .names import recording_files
from .recording import Recording


def open_recordings(text: str, progress: Progress | None) -> list[Recording]:
    """Open one recording, or two whose paths stand on both sides of a comma.

    Raises
    ------
    SourceError
        No such file, damaged, or no such recording; none stays open.
    """
    paths = recording_files(text)
    if not paths:
        raise SourceError(f"bag:{text}: there is no file {_missing(text)}; check the path")
    opened: list[Recording] = []
    try:
        for number, path in enumerate(paths):
            opened.append(_open(path, _part(progress, number, len(paths))))
    except BaseException:
        for recording in opened:
            recording.close()
        raise
    return opened


def _part(progress: Progress | None, number: int, count: int) -> Progress | None:
    """Return what tells the progress of one of several files as a share of all of them."""
    if progress is None:
        return None
    return lambda share, words: progress((number + share) / count, words)


def _open(path: Path, progress: Progress | None) -> Recording:
    # By what is in it: a .bag that was renamed is still one.
    with path.open("rb") as file:
        start = file.read(32)
    if not start:
        raise SourceError(f"{path}: this is no readable RealSense recording (it is empty); copy or record it again")
    if start.startswith(db3_recording.MAGIC):
        return Db3Recording(path, progress)
    if start.startswith(ros1_bag.MAGIC):
        return BagRecording(path, progress)
    raise SourceError(
        f"{path}: this is no readable RealSense recording (it begins neither as a .bag nor as a .db3 does); "
        "copy or record it again"
    )


def _missing(text: str) -> str:
    """Return the part of a name that is no file."""
    parts = [user_path(part) for part in text.split(",")]
    if len(parts) != 2:
        return str(user_path(text))
    return str(next((part for part in parts if not part.is_file()), user_path(text)))
