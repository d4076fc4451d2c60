"""Recordings that librealsense writes: ROS 1 ``.bag`` files and, from 2.58 on, ``.db3`` files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ...model.files import user_path
from ..base import FrameSource, Progress
from ..registry import SourceKind

if TYPE_CHECKING:
    from ...preset import CamerasSection


def recording_files(text: str) -> tuple[Path, ...]:
    """Return the one or two files that a name means; empty where there are none.

    A name is a path, or two paths with a comma between them. Paths may contain commas: a name that is a file as
    it stands is that file, else it is split at the first comma with a file on either side.
    """
    if user_path(text).is_file():
        return (user_path(text),)
    for at, letter in enumerate(text):
        if letter == ",":
            first, second = user_path(text[:at]), user_path(text[at + 1 :])
            if first.is_file() and second.is_file():
                return first, second
    return ()


class _BagKind(SourceKind):
    def claim(self, name: str) -> str | None:
        """Return the name where it is a recording, or two with a comma between them."""
        return name if len(recording_files(name)) == 2 else super().claim(name)


def _open(rest: str, progress: Progress | None, _: CamerasSection | None) -> FrameSource:
    from .source import BagSource

    return BagSource(rest, progress)


KIND = _BagKind(
    scheme="bag",
    title="RealSense recording",
    form="bag:PATH[,PATH]",
    description="A RealSense .bag or .db3 of two depth cameras, two files of one each, or one to view only.",
    needs="file",
    pattern="*.bag *.db3",
    open=_open,
    rank=2,
)
