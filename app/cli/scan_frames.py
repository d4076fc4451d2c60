"""Which frames ``tactune evaluate recording`` reads: those that it judges, and those that methods are shown before."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from typing import TYPE_CHECKING

from ...core.errors import SourceError, TactuneError

if TYPE_CHECKING:
    from ...core.model.frames import SensorFrame
    from ...core.preset import Preset
    from ...core.sources import FrameSource


def frame_range(frame: int | None, frames: str | None) -> tuple[int, int | None]:
    """Return the first and the last frame asked for; None is the source's last.

    Raises
    ------
    TactuneError
        ``--frames`` cannot be read, or ``--frame`` is given beside it.
    """
    if frames is None:
        return (0, None) if frame is None else (frame, frame)
    match = re.fullmatch(r"([0-9]{1,9}):([0-9]{1,9})", frames)
    if match is None or int(match[1]) > int(match[2]) or frame is not None:
        raise TactuneError(f"--frames is {frames!r}; give first:last, such as 0:9, and no --frame beside it")
    return int(match[1]), int(match[2])


def remembered_frames(method: str, preset: Preset) -> int:
    """Return how many frames a method should be shown before, and with, one that is judged."""
    from ...core.contact.pipeline import averaged_frames
    from ...core.methods.registry import FUSION_FIELDS
    from .method import FUSION

    fields = {FUSION: {}, **FUSION_FIELDS}.get(method)
    return 1 if fields is None else averaged_frames(preset.with_values(fields))


def frames_between(source: FrameSource, first: int, last: int | None, before: int) -> Iterator[tuple[int, SensorFrame]]:
    """Yield the frames from first to last, at least one, and as many before them as there are; each with its index.

    Raises
    ------
    SourceError
        The source ends before the last, or before the first.
    """
    if source.length is not None and max(first, last or 0) >= source.length:
        raise SourceError(f"{source.name} has no frame {max(first, last or 0)}; it has {source.length} of them")
    index = max(0, first - before)
    if source.length is not None:
        source.seek(index)
    else:
        for _ in itertools.islice(source, index):
            pass
    for frame in itertools.islice(source, None if last is None else last + 1 - index):
        yield index, frame
        index += 1
    if index <= first or (last is not None and index <= last):
        raise SourceError(f"{source.name} has no frame {max(first, index)}; it ended after {index} of them")
