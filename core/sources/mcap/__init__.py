"""ROS 2 bags in MCAP: Tactune's own recordings, and bags of other programs with the same topics."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..base import FrameSource, Progress, SourceKind

if TYPE_CHECKING:
    from ...preset import CamerasSection


def _open(rest: str, progress: Progress | None, _: CamerasSection | None) -> FrameSource:
    from .source import McapSource

    return McapSource(rest, progress)


KIND = SourceKind(
    scheme="mcap",
    title="Tactune recording",
    form="mcap:PATH",
    description="A recording in MCAP, as tactune record writes it: a ROS 2 bag with both cameras.",
    needs="file",
    pattern="*.mcap",
    open=_open,
)
