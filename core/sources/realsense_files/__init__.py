"""Recordings that librealsense writes: ROS 1 ``.bag`` files and, from 2.58 on, ``.db3`` files."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..base import FrameSource, Progress, SourceKind

if TYPE_CHECKING:
    from ...preset import CamerasSection


def _open(rest: str, progress: Progress | None, _: CamerasSection | None) -> FrameSource:
    from .source import BagSource

    return BagSource(rest, progress)


KIND = SourceKind(
    scheme="bag",
    title="RealSense recording",
    form="bag:PATH[,PATH]",
    description="A RealSense .bag or .db3 of two depth cameras, two files of one camera each, or one to view only.",
    needs="file",
    pattern="*.bag *.db3",
    files=2,
    open=_open,
)
