"""Any source as a recording."""

from __future__ import annotations

import itertools
from pathlib import Path

from ..errors import ExportError
from ..model.files import atomic_path
from ..model.frames import SensorFrame
from ..preset import Preset
from ..sources.base import FrameSource, Progress
from .writer import SessionWriter


def export_mcap(
    source: FrameSource,
    path: Path | str,
    frames: int | None = None,
    *,
    preset: Preset | None = None,
    untouched: SensorFrame | None = None,
    progress: Progress | None = None,
) -> int:
    """Write a source's frames as a recording that `McapSource` reads back bit for bit.

    The file gets its name when it is complete; one that was there is replaced.

    Parameters
    ----------
    source : FrameSource
        Read from its present position.
    path : path of the file
    frames : int, optional
        At most this many frames; a live source needs it. None: all up to the end.
    preset : Preset, optional
        Kept in the file.
    untouched : SensorFrame, optional
        The untouched membrane, kept in the file; by default the source's.
    progress : callable, optional
        Told the share done, 0 to 1, and what is being done.

    Returns
    -------
    int
        The number of frames written.

    Raises
    ------
    ExportError
        The file cannot be written, or there is nothing to write.
    SourceError
        The source cannot be read.
    """
    if frames is None and source.length is None:
        raise ExportError(f"{source.name} is live and has no end; record it, or say how many frames to convert")
    left = None if source.length is None else source.length - source.position
    total = min(count for count in (left, frames) if count is not None)
    with atomic_path(path) as temporary:
        try:
            with SessionWriter(
                temporary,
                source.rig,
                preset=preset,
                frame_rate_hz=source.frame_rate_hz,
                untouched=source.untouched() if untouched is None else untouched,
            ) as writer:
                return _write(source, writer, total, progress)
        except ExportError as error:  # which knows the temporary name only
            raise ExportError(str(error).replace(str(temporary), str(path))) from error


def _write(source: FrameSource, writer: SessionWriter, total: int, progress: Progress | None) -> int:
    for count, frame in enumerate(itertools.islice(source, total), start=1):
        if not writer.put(frame, wait=True):
            break
        if progress is not None:
            progress(count / total, f"frame {count} of {total}")
    status = writer.close()
    if status.error:
        raise ExportError(status.error)
    return status.frames
