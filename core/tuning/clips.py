"""Clips: ranges of frames of a source, with a hash of their content."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from ..calibration.snapshots import content_hash
from ..model.files import recording_files, user_path
from ..model.frames import Rig, SensorFrame
from ..preset import Preset
from ..preset.checks import check_rig
from ..sources.base import FrameSource
from ..sources.registry import open_source
from .space import TuneError

#: Opens a source by its name.
OpenSource = Callable[[str], FrameSource]

_FRAMES: Final = re.compile(r"([0-9]{0,9}):([0-9]{0,9})(?::([0-9]{1,9}))?|([0-9]{1,9})")


@dataclass(frozen=True)
class FrameRange:
    """Frames ``first``, ``first + step`` and so on, before ``last`` or to the end."""

    first: int = 0
    last: int | None = None
    step: int = 1

    def indices(self, length: int) -> range:
        """Return the indices of these frames in a source."""
        return range(self.first, length if self.last is None else min(self.last, length), self.step)

    def __str__(self) -> str:
        return f"{self.first}:{'' if self.last is None else self.last}" + (f":{self.step}" if self.step > 1 else "")


ALL_FRAMES: Final = FrameRange()


@dataclass(frozen=True)
class Clip:
    """Frames of one source.

    Attributes
    ----------
    source : str
        As the user wrote it.
    name : str
        Name that every process can open, with absolute paths.
    frames : range
        Indices.
    identity : str
        Hash of the rig and of the frames' images and truth.
    has_truth : bool
        Whether at least one frame has ground truth.
    """

    source: str
    name: str
    frames: range
    identity: str
    has_truth: bool


def parse_frames(text: str) -> FrameRange:
    """Read ``N``, ``A:B`` or ``A:B:STEP``.

    Raises
    ------
    TuneError
        The text has another form, or the range is empty.
    """
    found = _FRAMES.fullmatch(text)
    if found is None:
        raise TuneError(f"--frames is {text!r}; write a number of frames, or FIRST:END or FIRST:END:STEP")
    first, last, step, count = found.groups()
    frames = FrameRange(0, int(count)) if count else FrameRange(int(first or 0), int(last) if last else None,
                                                                int(step or 1))  # fmt: skip
    if frames.step == 0 or (frames.last is not None and frames.last <= frames.first):
        raise TuneError(f"--frames {text} holds no frame; the end must lie behind the first frame")
    return frames


def inspect_clips(
    sources: Sequence[str],
    frames: FrameRange,
    preset: Preset,
    opener: OpenSource = open_source,
    progress: Callable[[str], None] = lambda source: None,
) -> list[Clip]:
    """Open each source once and return its clip, with the hash of its frames.

    Raises
    ------
    TactuneError
        A source cannot be read, is live, lacks the requested frames, or does not fit the preset.
    """
    clips = []
    for source in dict.fromkeys(sources):
        if source.partition(":")[0] in ("live", "realsense", "cameras"):
            raise TuneError(f"{source} is live, so its frames are never the same; record it first with tactune record")
        progress(source)
        name = _absolute(source)
        with opener(name) as opened:
            check_rig(preset, opened.rig)
            identity, has_truth, chosen = _inspect(source, opened, frames)
        clips.append(Clip(source, name, chosen, identity, has_truth))
    return clips


def frames_identity(rig: Rig) -> hashlib.blake2b:
    """Return a hash that contains the rig; `add_frame` adds frames to it."""
    return hashlib.blake2b(rig.model_dump_json().encode(), digest_size=16)


def add_frame(digest: hashlib.blake2b, frame: SensorFrame) -> None:
    """Add a frame's images and truth to a hash."""
    digest.update(content_hash(frame).encode())
    for image in (frame.truth.contact, frame.truth.depth_m) if frame.truth else ():
        digest.update(b"none" if image is None else np.ascontiguousarray(image).tobytes())


def read_frames(source: str, opened: FrameSource, indices: range) -> Iterator[SensorFrame]:
    """Yield the frames of an open source.

    Raises
    ------
    TuneError
        The source ends before.
    """
    for index in indices:
        opened.seek(index)
        frame = opened.next_frame()
        if frame is None:
            raise TuneError(f"{source} ends before its frame {index}; check the recording or choose fewer frames")
        yield frame


def _inspect(source: str, opened: FrameSource, frames: FrameRange) -> tuple[str, bool, range]:
    """Return the hash of the frames, whether one of them has ground truth, and their indices."""
    if opened.length is None:
        raise TuneError(f"{source} has no end; record it first with tactune record")
    chosen = frames.indices(opened.length)
    if not chosen:
        raise TuneError(f"{source} has {opened.length} frames, none of them in {frames}; choose others with --frames")
    digest, has_truth = frames_identity(opened.rig), False
    for frame in read_frames(source, opened, chosen):
        add_frame(digest, frame)
        has_truth = has_truth or frame.truth is not None
    return digest.hexdigest(), has_truth, chosen


def _absolute(source: str) -> str:
    """Return a source's name with absolute paths, because workers may run in another folder."""
    scheme, colon, rest = source.partition(":")
    if not colon or scheme not in ("folder", "bag", "mcap"):
        scheme, rest = "", source
        if not (recording_files(source) or user_path(source).exists()):
            return source
    files = recording_files(rest) or (user_path(rest),)
    return (f"{scheme}:" if scheme else "") + ",".join(str(file.absolute()) for file in files)
