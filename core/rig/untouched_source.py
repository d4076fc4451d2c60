"""What methods compare with: the inflated membrane that nothing touches."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import islice
from typing import Final

from ..calibration.snapshots import take_snapshot
from ..model.frames import SensorFrame
from ..sources.base import FrameSource, Progress
from ..sources.simulator.source import SimulatorSource

#: Frames whose median is the untouched frame, as a person would capture it.
UNTOUCHED_FRAMES: Final = 15


def untouched_frame(source: FrameSource, progress: Progress | None = None) -> SensorFrame | None:
    """Return a frame of the untouched membrane, or None where the source has none.

    It is what the source keeps as its untouched frame. The simulator's is measured, too, never its truth: the
    median of `UNTOUCHED_FRAMES` noisy frames of the same membrane with its object far away.

    Raises
    ------
    SourceError
        The source's untouched frame cannot be read.
    """
    untouched = source.untouched()
    if untouched is not None or not isinstance(source, SimulatorSource):
        return untouched
    with frames_to_average(source, UNTOUCHED_FRAMES, progress) as frames:
        return take_snapshot(frames).frame


@contextmanager
def frames_to_average(
    source: FrameSource, count: int, progress: Progress | None = None
) -> Iterator[Iterable[SensorFrame]]:
    """Yield what an untouched frame is made of: the source's next frames, at most ``count``, while nothing touches.

    The simulator takes its object away for them, and plays its untouched membrane as often as is needed.
    """
    if not isinstance(source, SimulatorSource):
        yield islice(source, count)
        return
    with source.with_object_away(progress) as away:
        yield (away.read(number % away.length) for number in range(count))
