"""Recordings that librealsense writes: ROS 1 ``.bag`` files and, from 2.58 on, ``.db3`` files."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...model.files import recording_files
from ..base import FrameSource, Progress
from ..registry import SourceKind

if TYPE_CHECKING:
    from ...preset import CamerasSection


class _BagKind(SourceKind):
    def claim(self, name: str) -> str | None:
        """Return the name if it is a recording, or two recordings separated by a comma."""
        return name if len(recording_files(name)) == 2 else super().claim(name)


def _open(rest: str, progress: Progress | None, _: CamerasSection | None) -> FrameSource:
    from .source import BagSource

    return BagSource(rest, progress)


KIND = _BagKind(
    scheme="bag",
    title="RealSense recording",
    form="bag:PATH[,PATH]",
    description="A RealSense .bag or .db3 of two depth cameras, two files of one camera each, or one to view only.",
    needs="file",
    pattern="*.bag *.db3",
    open=_open,
    rank=2,
)
