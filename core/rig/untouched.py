"""The untouched frame: averaged from frames of the untouched membrane and kept in a file beside the preset."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Final

import numpy as np

from ..calibration.snapshots import Snapshot, content_hash, take_snapshot
from ..errors import CalibrationError, FrameError, PresetError, SourceError
from ..model.arrays import Float64Array, Uint16Array, spread
from ..model.clouds import valid_depth
from ..model.files import atomic_path
from ..model.frames import SensorFrame
from ..model.loading import frame_bytes, frame_from_bytes, read_file
from ..preset import Preset, UntouchedRecord
from ..sources.base import FrameSource, Progress

#: Number of averaged frames; more reduce the noise little further.
UNTOUCHED_FRAMES: Final = 15
_ENOUGH: Final = 8  # before a touch, as in a recording
#: Movement: the median depth of image tiles of this side length, pixels, changes by more than a share of the depth
#: (2 mm at 300 mm) and by more than a number of robust standard deviations of all tiles, in more than a share of them.
TILE_PX: Final = 16
_MOVED_SHARE, _MOVED_SIGMAS, _MOVED_TILES = 0.0067, 5.0, 0.005
#: Most places of a recording that are looked at, fewest that follow each other at rest, share of the tiles that may
#: differ between two of them, and share of the largest mean depth that counts as equally far.
_PLACES, _STILL_PLACES, _MOVING_TILES, _AS_FAR = 60, 3, 0.03, 0.998
_MIN_SEEN: Final = 0.1  # smallest share of the tactile image with depth
#: Size limit of the file. Images of 1280 x 720 with colour take 15 MB.
_MAX_BYTES: Final = 100_000_000
_REMEDY: Final = "capture the untouched frame again"


@dataclass(frozen=True, eq=False)
class FoundUntouched:
    """The untouched frame that methods compare with, None if there is none, and warnings for the user."""

    frame: SensorFrame | None
    warnings: tuple[str, ...] = ()


def average_untouched(frames: Iterable[SensorFrame]) -> Snapshot:
    """Average a few frames of the untouched membrane, or those before a touch: the median of each pixel."""
    held: list[SensorFrame] = []
    for frame in frames:
        try:
            _refuse_movement((held or [frame])[0], frame, len(held) + 1)
        except CalibrationError:
            if len(held) < _ENOUGH:
                raise
            break
        held.append(frame)
    return take_snapshot(held)


def save_untouched(frame: SensorFrame, frames: int, preset_path: Path) -> UntouchedRecord:
    """Write an average beside a preset file, named by its content, and return its record for the preset."""
    sha256 = content_hash(frame)
    record = UntouchedRecord(file=f"untouched-{sha256[:12]}.npz", sha256=sha256, frames=frames)
    with atomic_path(preset_path.parent / record.file) as temporary:
        temporary.write_bytes(frame_bytes(frame))
    return record


def load_untouched(record: UntouchedRecord, preset_path: Path) -> SensorFrame:
    """Read the untouched frame that a preset names; its path may also be that of a recording that holds both."""
    if preset_path.suffix == ".mcap":
        from ..sources.tactune_files import McapSource  # on demand: presets in files need not wait for it

        try:
            with McapSource(preset_path) as recording:
                return _checked(recording.untouched(), record, f"the untouched frame in {preset_path}")
        except SourceError as error:
            raise PresetError(f"the untouched frame of the preset cannot be read: {error}") from error
    path = preset_path.parent / record.file
    if not path.is_file():
        raise PresetError(f"the untouched frame {path} of the preset is missing; put it there, or {_REMEDY}")
    try:
        frame = frame_from_bytes(read_file(path, _MAX_BYTES))
    except OSError as error:
        raise PresetError(f"cannot read the untouched frame {path}: {error.strerror or error}; {_REMEDY}") from error
    except FrameError as error:
        raise PresetError(f"the untouched frame {path} is damaged ({error}); {_REMEDY}") from error
    return _checked(frame, record, f"the untouched frame {path}")


def copy_untouched(record: UntouchedRecord, preset_path: Path, to: Path) -> None:
    """Copy a preset's untouched frame beside another preset file, unless it is already there."""
    target = to.parent / record.file
    if target.is_file():
        return
    frame = load_untouched(record, preset_path)
    with atomic_path(target) as temporary:
        temporary.write_bytes(frame_bytes(frame))  # not the file's own bytes, which may hold more than images


def find_untouched(
    preset: Preset, preset_path: Path | str | None, source: FrameSource, progress: Progress | None = None
) -> FoundUntouched:
    """Return the untouched frame that methods compare with: the preset's own, otherwise the source's.

    ``preset_path`` is the preset's origin as for `load_preset`; None if it came with the source. The simulator renders
    its frames without the object. The warnings say why the preset's own untouched frame is not used. Raises a
    `SourceError` if the source's cannot be read.
    """
    found = kept_untouched(preset, preset_path, source)
    if found.frame is not None:
        return found
    return FoundUntouched(untouched_frame(source, progress), found.warnings)


def kept_untouched(preset: Preset | None, preset_path: Path | str | None, source: FrameSource) -> FoundUntouched:
    """Return what `find_untouched` returns, but capture and simulate nothing."""
    warnings: tuple[str, ...] = ()
    if preset is not None and preset.untouched is not None:
        try:
            if preset_path is not None:
                frame = load_untouched(preset.untouched, Path(preset_path))
            else:
                frame = _checked(source.untouched(), preset.untouched, f"the untouched frame in {source.name}")
            return FoundUntouched(_usable(frame, source))
        except (PresetError, SourceError, FrameError) as error:
            warnings = (f"the preset's own untouched frame is not used: {error}",)
    try:
        own = source.untouched()
        return FoundUntouched(None if own is None else _usable(own, source), warnings)
    except (SourceError, FrameError) as error:
        return FoundUntouched(None, (*warnings, f"the untouched frame of {source.name} is not used: {error}"))


def untouched_frame(source: FrameSource, progress: Progress | None = None) -> SensorFrame | None:
    """Return the source's untouched frame, or None; the simulator's is measured, with noise, without its object."""
    from ..sources.simulator.simulator_source import SimulatorSource  # on demand: other sources need not wait for it

    untouched = source.untouched()
    if untouched is not None or not isinstance(source, SimulatorSource):
        return untouched
    with frames_to_average(source, UNTOUCHED_FRAMES, progress) as frames:
        return take_snapshot(frames).frame


@contextmanager
def frames_to_average(
    source: FrameSource, count: int, progress: Progress | None = None
) -> Iterator[Iterable[SensorFrame]]:
    """Yield ``count`` frames of a source at rest, without the simulator's object, which repeats them as needed.

    A recording is searched for where nothing touches the membrane; of other sources these are the next frames.
    """
    from ..sources.simulator.simulator_source import SimulatorSource  # on demand: other sources need not wait for it

    if not isinstance(source, SimulatorSource):
        if source.length is not None:
            source.seek(place_at_rest(source, progress or (lambda share, words: None)))
        yield islice(source, count)
        return
    with source.with_object_away(progress) as away:
        yield (away.read(number % away.length) for number in range(count))


def place_at_rest(source: FrameSource, progress: Progress) -> int:
    """Return the place in a recording from which on the membrane stays still and farthest from the cameras.

    What touches it pushes it nearer in the mean, although the membrane around it bulges out.
    """
    length = source.length or 0
    places = np.unique(np.linspace(0, max(length - 1, 0), min(length, _PLACES)).astype(int))
    seen = []
    for number, place in enumerate(places):
        progress(number / len(places), "Looking for the untouched membrane")
        source.seek(int(place))
        frame = source.next_frame()
        seen.append(np.zeros(1) if frame is None else np.nan_to_num(tile_medians(frame.tactile_depth)))
    tiles = np.stack(np.broadcast_arrays(*seen))
    mean = tiles.mean(axis=1)
    runs = [(0, 0)]  # first place, and number of places that follow without movement, also not a slow one
    for number in range(1, len(places)):
        start, count = runs[-1]
        moved = np.abs(tiles[number] - tiles[start]) > _MOVED_SHARE * np.maximum(tiles[start], 1.0)
        runs = [*runs, (number, 0)] if moved.mean() > _MOVING_TILES else [*runs[:-1], (start, count + 1)]
    early = mean[places <= max(length - UNTOUCHED_FRAMES, length // 2)]  # enough frames follow
    still = [run for run in runs if run[1] >= _STILL_PLACES] or [(int(np.argmax(early)), 0)]
    farthest = max(mean[start] for start, _ in still)
    start, count = max((run for run in still if mean[run[0]] >= _AS_FAR * farthest), key=lambda run: run[1])
    return int(places[start + min(1, count, start)])  # the first may still move, unless the recording begins with it


def tile_medians(counts: Uint16Array) -> Float64Array:
    """Return the median of the valid counts of each image tile, shape (M,); nan where most pixels have no depth.

    Interpolated within a count, which is a large step of coarse depth: 0.7 % of the distance in mm at 140 mm.
    """
    height, width = (size // TILE_PX * TILE_PX for size in counts.shape)
    tiles = counts[:height, :width].reshape(height // TILE_PX, TILE_PX, width // TILE_PX, TILE_PX)
    pixels = tiles.swapaxes(1, 2).reshape(-1, TILE_PX**2)
    valid = valid_depth(pixels)
    ordered = np.sort(np.where(valid, pixels, np.uint16(65535)), axis=1)
    known = valid.sum(axis=1)
    medians = ordered[np.arange(len(ordered)), np.maximum(known - 1, 0) // 2].astype(np.float64)
    below, up_to = (compare(ordered, medians[:, None]).sum(axis=1) for compare in (np.less, np.less_equal))
    medians += (known / 2 - below) / (up_to - below) - 0.5
    return np.where(known >= TILE_PX**2 // 2, medians, np.nan)


def _checked(frame: SensorFrame | None, record: UntouchedRecord, what: str) -> SensorFrame:
    if frame is None or content_hash(frame) != record.sha256:
        raise PresetError(f"{what} is not the one that the preset was saved with; {_REMEDY}")
    return frame


def _usable(frame: SensorFrame, source: FrameSource) -> SensorFrame:
    """Return the frame; `FrameError` if it is of another rig, or hardly has tactile depth to compare with."""
    frame.check_against(source.rig)
    seen = float(valid_depth(frame.tactile_depth).mean())
    if seen < _MIN_SEEN:
        raise FrameError(f"it has tactile depth in {100 * seen:.0f} % of its image; {_REMEDY}")
    return frame


def _refuse_movement(first: SensorFrame, frame: SensorFrame, number: int) -> None:
    """Raise if the tactile depth differs from the first frame's. The proximity depth may change."""
    if frame is first or frame.tactile_depth.shape != first.tactile_depth.shape:
        return  # take_snapshot refuses other sizes
    before, after = tile_medians(first.tactile_depth), tile_medians(frame.tactile_depth)
    change = after - before
    noise = spread(change, float(np.nanmedian(change))) if np.isfinite(change).any() else 0.0
    moved = np.abs(change) > np.maximum(_MOVED_SHARE * before, _MOVED_SIGMAS * noise)
    if moved.mean() > _MOVED_TILES:
        farthest = float(np.abs(change)[moved].max() / np.median(before[moved]))
        raise CalibrationError(
            f"the membrane moved while it should have been untouched: frame {number} differs from the first by up to "
            f"{100 * farthest:.1f} % of the depth; let nothing touch it, wait for constant pressure, and start again"
        )
