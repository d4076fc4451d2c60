"""The untouched membrane: averaged from frames, kept in a file beside the preset, named in it by its hash."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from ..calibration.snapshots import content_hash, take_snapshot
from ..errors import CalibrationError, ExportError, FrameError, PresetError, SourceError
from ..model.arrays import Float64Array, Uint16Array
from ..model.clouds import valid_depth
from ..model.files import atomic_path
from ..model.frames import SensorFrame
from ..model.untouched_archive import frame_from_bytes, untouched_bytes
from ..preset import Preset, UntouchedRecord
from ..sources.base import FrameSource, Progress

#: More frames take minutes and average nothing that fewer leave.
MOST_FRAMES: Final = 1000

#: Frames that are held at once: from twice as many on, the older half becomes one median.
_BLOCK: Final = 30
#: Movement is looked for in the medians of squares of so many pixels, which noise hardly changes, ...
_TILE_PX: Final = 16
#: ... as a change by this share of the depth (2 mm at 300 mm) ...
_MOVED_SHARE: Final = 0.0067
#: ... in more than this share of them.
_MOVED_TILES: Final = 0.005
#: Two frames of 1280 x 720 with colour take 15 MB; anything far larger is no untouched frame.
_LARGEST_BYTES: Final = 100_000_000
_ANEW: Final = "capture the untouched frame anew"


@dataclass(frozen=True, eq=False)
class UntouchedAverage:
    """The averaged membrane, and how much quieter it is than one frame.

    Attributes
    ----------
    frame : SensorFrame
        The median of each pixel of all images.
    frames : int
        How many frames went into it.
    noise_counts : (float, float)
        Mean noise of the tactile depth (standard deviation over time, raw counts) in one frame, and in
        the median; nan where one frame only, or no depth, tells.
    """

    frame: SensorFrame
    frames: int
    noise_counts: tuple[float, float]


@dataclass(frozen=True, eq=False)
class FoundUntouched:
    """What methods compare with: a frame, or None where there is none, and what is to be said of it."""

    frame: SensorFrame | None
    warnings: tuple[str, ...] = ()


def average_untouched(frames: Iterable[SensorFrame]) -> UntouchedAverage:
    """Average frames of the untouched membrane: the median of each pixel.

    Up to 59 frames the median is exact; of more, it is the median of the medians of 30 each (Rousseeuw &
    Bassett 1990, "The remedian"), so at most 60 frames and 33 medians are held at once.

    Parameters
    ----------
    frames : iterable of SensorFrame
        All of one size, at most `MOST_FRAMES`.

    Raises
    ------
    CalibrationError
        No frame, too many, frames of different size, or something moved meanwhile.
    """
    blocks: list[SensorFrame] = []
    held: list[SensorFrame] = []
    first: SensorFrame | None = None
    count = 0
    for frame in frames:
        first = frame if first is None else first
        _refuse_movement(first, frame)
        count += 1
        if count > MOST_FRAMES:
            raise CalibrationError(f"an untouched frame is averaged from at most {MOST_FRAMES} frames; ask for fewer")
        held.append(frame)
        if len(held) == 2 * _BLOCK:
            blocks.append(take_snapshot(held[:_BLOCK]).frame)
            held = held[_BLOCK:]
    if first is None:
        raise CalibrationError("an untouched frame needs at least one frame; the source gave none")
    parts = [*blocks, take_snapshot(held).frame] if blocks else held
    return UntouchedAverage(take_snapshot(parts).frame, count, _noise(held, parts))


def save_untouched(frame: SensorFrame, frames: int, preset_path: Path) -> UntouchedRecord:
    """Write an untouched frame beside a preset file and return what the preset keeps of it.

    The file is named by its content, ``untouched-HASH.npz``, so it never replaces the one that a preset in
    this folder still names: save the preset afterwards, and whatever happens in between, the pair on the
    disk is whole.

    Parameters
    ----------
    frame : SensorFrame
        From `average_untouched`.
    frames : int
        How many frames went into it.
    preset_path : Path
        The preset's own file.

    Raises
    ------
    ExportError
        The file cannot be written.
    """
    sha256 = content_hash(frame)
    record = UntouchedRecord(file=f"untouched-{sha256[:12]}.npz", sha256=sha256, frames=frames)
    with atomic_path(preset_path.parent / record.file) as temporary:
        temporary.write_bytes(untouched_bytes(frame))
    return record


def load_untouched(record: UntouchedRecord, preset_path: Path) -> SensorFrame:
    """Read the untouched frame that a preset names.

    Parameters
    ----------
    record : UntouchedRecord
    preset_path : Path
        The preset's file, or the recording (``.mcap``) that holds both.

    Raises
    ------
    PresetError
        It is missing, damaged, or another than the preset was saved with.
    """
    if preset_path.suffix == ".mcap":
        return _checked(_recorded(preset_path), record, f"the untouched frame in {preset_path}")
    path = preset_path.parent / record.file
    if not path.is_file():
        raise PresetError(f"the untouched frame {path} of the preset is missing; put it there, or {_ANEW}")
    try:
        if path.stat().st_size > _LARGEST_BYTES:
            raise PresetError(f"{path} is far too large for an untouched frame; {_ANEW}")
        frame = frame_from_bytes(path.read_bytes())
    except OSError as error:
        raise PresetError(f"cannot read the untouched frame {path}: {error.strerror or error}; {_ANEW}") from error
    except FrameError as error:
        raise PresetError(f"the untouched frame {path} is damaged ({error}); {_ANEW}") from error
    return _checked(frame, record, f"the untouched frame {path}")


def copy_untouched(record: UntouchedRecord, preset_path: Path, to: Path) -> None:
    """Put a preset's untouched frame beside another preset file, unless it is there already.

    Parameters
    ----------
    record : UntouchedRecord
    preset_path : Path
        Where it is now, as `load_untouched` takes it.
    to : Path
        The other preset's file.

    Raises
    ------
    PresetError
        The untouched frame is missing, damaged or another.
    ExportError
        It cannot be written there, or another file of its name is in the way.
    """
    target = to.parent / record.file
    if target.is_file():
        try:
            load_untouched(record, to)
        except PresetError as error:
            raise ExportError(
                f"the untouched frame cannot go beside {to}, {target} is in the way; remove it"
            ) from error
        return
    frame = load_untouched(record, preset_path)
    packed = preset_path.suffix != ".mcap"
    data = (preset_path.parent / record.file).read_bytes() if packed else untouched_bytes(frame)
    with atomic_path(target) as temporary:
        temporary.write_bytes(data)


def find_untouched(
    preset: Preset, preset_path: Path | str | None, source: FrameSource, progress: Progress | None = None
) -> FoundUntouched:
    """Return what methods compare with: the preset's own untouched frame, else the source's.

    Parameters
    ----------
    preset : Preset
    preset_path : path, str or None
        Where the preset came from, as `load_preset` takes it; None: from the source.
    source : FrameSource
        What the frames come from. The simulator is asked for frames with its object away.
    progress : callable, optional
        Told the share done, 0 to 1, and what is being done.

    Returns
    -------
    FoundUntouched
        Its warnings say why the preset's own untouched frame was not taken.

    Raises
    ------
    SourceError
        The source's untouched frame cannot be read.
    """
    found = kept_untouched(preset, preset_path, source)
    if found.frame is not None:
        return found
    # the simulator, which other sources need not wait for
    from .untouched_source import untouched_frame

    return FoundUntouched(untouched_frame(source, progress), found.warnings)


def kept_untouched(preset: Preset | None, preset_path: Path | str | None, source: FrameSource) -> FoundUntouched:
    """Return what is kept already, for a recording: the preset's own untouched frame, else the source's.

    Parameters and errors are those of `find_untouched`; nothing is captured or simulated.
    """
    warnings: tuple[str, ...] = ()
    if preset is not None and preset.untouched is not None:
        try:
            frame = _own_untouched(preset.untouched, preset_path, source)
            frame.check_against(source.rig)
            return FoundUntouched(frame)
        except (PresetError, FrameError) as error:
            warnings = (f"the preset's own untouched frame is not used: {error}",)
    return FoundUntouched(source.untouched(), warnings)


def _own_untouched(record: UntouchedRecord, preset_path: Path | str | None, source: FrameSource) -> SensorFrame:
    if preset_path is not None:
        return load_untouched(record, Path(preset_path))
    return _checked(source.untouched(), record, f"the untouched frame in {source.name}")


def _recorded(path: Path) -> SensorFrame | None:
    from ..sources.mcap.source import McapSource

    try:
        with McapSource(path) as recording:
            return recording.untouched()
    except SourceError as error:
        raise PresetError(f"the untouched frame of the preset cannot be read: {error}") from error


def _checked(frame: SensorFrame | None, record: UntouchedRecord, what: str) -> SensorFrame:
    if frame is None or content_hash(frame) != record.sha256:
        raise PresetError(f"{what} is not the one that the preset was saved with; {_ANEW}")
    return frame


def _refuse_movement(first: SensorFrame, frame: SensorFrame) -> None:
    """Compare the tactile depth with the first frame's; what is behind the membrane may move."""
    if frame is first or frame.tactile_depth.shape != first.tactile_depth.shape:
        return  # other sizes are refused when they are averaged
    before, after = _tile_medians(first.tactile_depth), _tile_medians(frame.tactile_depth)
    moved = np.abs(after - before) > _MOVED_SHARE * before
    if moved.mean() > _MOVED_TILES:
        farthest = float(np.abs(after - before)[moved].max() / np.median(before[moved]))
        raise CalibrationError(
            f"the membrane moved while the untouched frame was captured: frame {frame.sequence} differs from frame "
            f"{first.sequence} by up to {100 * farthest:.1f} % of the depth; see that nothing touches it and "
            "that it is inflated for good, then capture again"
        )


def _tile_medians(counts: Uint16Array) -> Float64Array:
    """Return the median of the valid counts of each square, shape (M,); nan where most have none."""
    height, width = (size // _TILE_PX * _TILE_PX for size in counts.shape)
    tiles = counts[:height, :width].reshape(height // _TILE_PX, _TILE_PX, width // _TILE_PX, _TILE_PX)
    pixels = tiles.swapaxes(1, 2).reshape(-1, _TILE_PX**2)
    valid = valid_depth(pixels)
    ordered = np.sort(np.where(valid, pixels, np.uint16(65535)), axis=1)
    known = valid.sum(axis=1)
    medians = ordered[np.arange(len(ordered)), np.maximum(known - 1, 0) // 2].astype(np.float64)
    return np.where(known >= _TILE_PX**2 // 2, medians, np.nan)


def _noise(single: list[SensorFrame], parts: list[SensorFrame]) -> tuple[float, float]:
    """Return the noise of one frame and of the median of all parts, counts; nan from one frame.

    Two frames with the noise s differ by sqrt(2) s, and two halves, each with sqrt(2) times the whole's
    noise, by twice the whole's.
    """
    if len(parts) < 2:
        return float("nan"), float("nan")
    halves = [take_snapshot(parts[start::2]).frame for start in (0, 1)]
    return _difference(single[0], single[1]) / math.sqrt(2.0), _difference(*halves) / 2.0


def _difference(a: SensorFrame, b: SensorFrame) -> float:
    """Return the standard deviation of the difference in tactile depth, counts, but for its largest hundredth."""
    valid = valid_depth(a.tactile_depth) & valid_depth(b.tactile_depth)
    if not valid.any():
        return float("nan")
    change = np.abs(a.tactile_depth[valid].astype(np.float64) - b.tactile_depth[valid])
    return float(np.sqrt(np.mean(change[change <= np.quantile(change, 0.99)] ** 2)))
