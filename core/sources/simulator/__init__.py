"""The live simulator: a membrane pressed by an object, seen by two noisy cameras, with ground truth."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..base import FrameSource, Progress, SourceKind

if TYPE_CHECKING:
    from ...preset import CamerasSection


def _open(rest: str, progress: Progress | None, cameras: CamerasSection | None) -> FrameSource:
    from .scenes import read_name  # not above: it compiles kernels' modules
    from .source import SimulatorSource

    return SimulatorSource(progress=progress, **read_name(rest))


KIND = SourceKind(
    scheme="sim",
    title="Simulator",
    form="sim:SCENE[?press=medium&membrane=NAME&sensor=NAME&seed=N&noise=X]",
    open=_open,
)
