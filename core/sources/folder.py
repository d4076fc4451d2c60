"""Recordings as folders of PNG images that any program can read and write.

A recording is a folder with ``rig.json`` (see `tactune.core.model.rig_file`) and either one frame or
numbered subfolders with one frame each; a subfolder ``untouched`` may hold a frame of the untouched
membrane. A frame is::

    proximity_depth.png   16 bit, counts
    proximity_color.png   8 bit, colour
    tactile_depth.png     16 bit, counts
    tactile_color.png     8 bit, colour, aligned to the tactile depth image        (optional)
    truth_contact.png     8 bit, 0 or 255, proximity pixels                        (optional)
    truth_depth.png       16 bit, proximity pixels and unit, 0 where unknown       (optional)
    truth_depth.npy       the same in float32 metres, nan where unknown; used in
                          place of the PNG where counts are too coarse             (optional)
    frame.json            sequence, proximity_time_s, tactile_time_s               (optional)
"""

from __future__ import annotations

import errno
import io
import itertools
import math
import os
import re
import secrets
import shutil
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ..errors import ExportError, FrameError, SourceError
from ..model.arrays import AnyArray, Float32Array, Uint8Array, Uint16Array
from ..model.clouds import valid_depth
from ..model.files import remove_leftovers, user_path
from ..model.frames import MAX_TIME_S, NO_DEPTH_COUNTS, GroundTruth, Rig, SensorFrame, note_number
from ..model.loading import decode_image, parse_npy, read_file
from ..model.rig_file import json_text, load_rig, read_json_object, rig_to_json, validation_sentence
from .base import FrameSource, Progress, SeekableSource, SourceKind

_NOMINAL_RATE_HZ = 30.0
#: The images of a frame: whether it needs each, its bits and its channels.
IMAGES = {
    "proximity_depth.png": (True, 16, 1),
    "proximity_color.png": (True, 8, 3),
    "tactile_depth.png": (True, 16, 1),
    "tactile_color.png": (False, 8, 3),
}
_REQUIRED = tuple(name for name, (needed, _, _) in IMAGES.items() if needed)


_Seconds = Annotated[float, Field(ge=-MAX_TIME_S, le=MAX_TIME_S, allow_inf_nan=False)]


class _Stamp(BaseModel):
    """The contents of ``frame.json``."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid")

    sequence: Annotated[int, Field(ge=0, lt=2**63)]
    proximity_time_s: _Seconds
    tactile_time_s: _Seconds


class FolderSource(SeekableSource):
    """A recording in a folder; the module's docstring describes the format."""

    def __init__(self, path: Path | str) -> None:
        self._path = user_path(path)
        name = f"folder:{path}"
        if not self._path.is_dir():
            raise SourceError(f"{name}: there is no folder {self._path}; check the path")
        rig = load_rig(self._path / "rig.json")
        self._folders = _frame_folders(self._path)
        self._stamps = [_read_stamp(folder, index) for index, folder in enumerate(self._folders)]
        self._refuse_same_sequence()
        super().__init__(name, rig, len(self._folders))
        self.read(0)

    @property
    def frame_rate_hz(self) -> float:
        """Rate from the median interval of the time stamps; 30 Hz where they have none."""
        gaps = np.diff([stamp.proximity_time_s for stamp in self._stamps])
        median = float(np.median(gaps)) if len(gaps) else 0.0
        return 1.0 / median if median > 0 else _NOMINAL_RATE_HZ

    def read(self, index: int) -> SensorFrame:
        """Read frame ``index`` from its images."""
        return _read_frame(self._folders[index], self._stamps[index], self._rig)

    def _refuse_same_sequence(self) -> None:
        """Raise if two frames have the same sequence number, because result files are named by it."""
        seen: dict[int, Path] = {}
        for folder, stamp in zip(self._folders, self._stamps, strict=True):
            first = seen.setdefault(stamp.sequence, folder)
            if first is not folder:
                raise SourceError(
                    f"{folder / 'frame.json'} has the sequence {stamp.sequence}, and so has {first.name}; correct it"
                )

    def untouched(self) -> SensorFrame | None:
        """Return the frame in the subfolder ``untouched``, or None if there is none."""
        folder = self._path / "untouched"
        if not folder.is_dir():
            return None
        _require_images(folder)
        return _read_frame(folder, _read_stamp(folder, 0), self._rig)


def export_folder(
    source: FrameSource, path: Path | str, frames: int | None = None, progress: Progress | None = None
) -> int:
    """Write a source's frames, from its present position, as a folder that `FolderSource` reads back bit for bit.

    At most ``frames`` are written; a live source needs it. Everything goes to a temporary folder beside ``path``, which
    gets its name only when it is complete; ``path`` must not exist yet, or be empty. Returns the number of frames;
    raises `ExportError` where it cannot be written or there is nothing to write.
    """
    target = Path.cwd() / user_path(path)
    if frames is not None and frames < 1:
        raise ExportError(f"cannot export {frames} frames of {source.name}; ask for 1 or more")
    if frames is None and source.length is None:
        raise ExportError(f"{source.name} is live and has no end; say how many frames to export")
    temporary = target.parent / f".{target.name}-{secrets.token_hex(4)}.partial"
    try:
        if target == Path.cwd():
            raise ExportError(f"cannot replace {target}, the working folder; name a new folder")
        if target.exists() and (not target.is_dir() or any(target.iterdir())):
            raise ExportError(f"{target} is already there and not an empty folder; choose another name or remove it")
        remove_leftovers(target.parent, f"{target.name}.partial")
        temporary.mkdir(parents=True)
        count = _write_recording(source, temporary, frames, progress)
        if target.exists():
            target.rmdir()
        temporary.rename(target)
    except OSError as error:
        if error.errno in (errno.ENOTEMPTY, errno.EEXIST):  # it was not there, or empty, before
            raise ExportError(f"{target} was written by another program meanwhile; choose another name") from error
        raise ExportError(f"cannot write {target}: {error.strerror or error}; choose another place") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return count


def numbered_folders(path: Path) -> list[Path]:
    """Return the subfolders whose names are numbers, in the order of these."""
    numbered = [entry for entry in path.iterdir() if re.fullmatch("[0-9]+", entry.name) and entry.is_dir()]
    return sorted(numbered, key=lambda folder: int(folder.name))


def _frame_folders(path: Path) -> list[Path]:
    """Return the frames of a recording by their numbers."""
    try:
        numbered = numbered_folders(path)
    except OSError as error:
        raise SourceError(f"cannot list {path}: {error.strerror or error}; check its permissions") from error
    single = any((path / name).exists() for name in _REQUIRED)
    if single and numbered:
        raise SourceError(f"{path} has images and numbered subfolders ({numbered[0].name}); keep one of the two")
    if not single and not numbered:
        raise SourceError(
            f"{path} has no frames: neither {_REQUIRED[0]} nor numbered subfolders such as 000000; "
            "export or copy the recording again"
        )
    folders = [path] if single else numbered
    for first, second in itertools.pairwise(folders):
        if int(first.name) == int(second.name):
            raise SourceError(f"{path}: {first.name} and {second.name} are the same number; rename one of them")
    for folder in folders:
        _require_images(folder)
    return folders


def _require_images(folder: Path) -> None:
    for name in _REQUIRED:
        if not (folder / name).is_file():
            raise SourceError(f"there is no file {folder / name}; every frame needs {', '.join(_REQUIRED)}")


def _read_stamp(folder: Path, index: int) -> _Stamp:
    """Read ``frame.json``; without one, frames follow each other at 30 Hz."""
    path = folder / "frame.json"
    if not path.exists():
        time_s = index / _NOMINAL_RATE_HZ
        return _Stamp(sequence=index, proximity_time_s=time_s, tactile_time_s=time_s)
    try:
        return _Stamp.model_validate(read_json_object(path))
    except ValidationError as error:
        raise SourceError(validation_sentence(error, str(path), "a frame")) from error


def _read_frame(folder: Path, stamp: _Stamp, rig: Rig) -> SensorFrame:
    proximity, tactile = rig.proximity.intrinsics.shape, rig.tactile.intrinsics.shape
    tactile_color = folder / "tactile_color.png"
    return SensorFrame(
        sequence=stamp.sequence,
        proximity_depth=_read_counts(folder / "proximity_depth.png", proximity),
        tactile_depth=_read_counts(folder / "tactile_depth.png", tactile),
        proximity_color=_read_color(folder / "proximity_color.png", rig.proximity_color_shape),
        tactile_color=_read_color(tactile_color, tactile) if tactile_color.exists() else None,
        proximity_time_s=stamp.proximity_time_s,
        tactile_time_s=stamp.tactile_time_s,
        truth=_read_truth(folder, rig),
    )


def _read_truth(folder: Path, rig: Rig) -> GroundTruth | None:
    shape = rig.proximity.intrinsics.shape
    contact, counts, metres = (folder / name for name in ("truth_contact.png", "truth_depth.png", "truth_depth.npy"))
    if not contact.exists():
        orphan = next((path for path in (counts, metres) if path.exists()), None)
        if orphan is not None:
            raise SourceError(f"{orphan} has no {contact.name} beside it; add that or remove this")
        return None
    mask = _read_image(contact, np.dtype(np.uint8), 1, shape)
    strange = mask[(mask != 0) & (mask != 255)]
    if strange.size:
        raise SourceError(f"{contact} contains the value {strange[0]}; only 0 and 255 have a meaning, write it again")
    if metres.exists():
        return GroundTruth(mask == 255, _read_metres(metres, shape))
    depth = _metres(_read_counts(counts, shape), rig.proximity.depth_unit_m) if counts.exists() else None
    return GroundTruth(mask == 255, depth)


def _read_counts(path: Path, shape: tuple[int, int]) -> Uint16Array:
    return _read_image(path, np.dtype(np.uint16), 1, shape)


def _read_color(path: Path, shape: tuple[int, int]) -> Uint8Array:
    return np.ascontiguousarray(_read_image(path, np.dtype(np.uint8), 3, shape)[:, :, ::-1])


def _read_image(path: Path, dtype: np.dtype[Any], channels: int, shape: tuple[int, int]) -> AnyArray:
    """Read one image and check its bit depth, its channels and its size."""
    try:
        image = decode_image(read_file(path))
    except OSError as error:
        raise SourceError(
            f"cannot read {path}: {error.strerror or error}; export or copy the recording again"
        ) from error
    except ValueError as error:
        raise SourceError(f"{path} is no readable PNG image ({error}); export or copy it again") from error
    found = image.shape[2] if image.ndim == 3 else 1
    if image.dtype != dtype or found != channels:
        raise SourceError(
            f"{path} has {found} channels of {image.dtype.itemsize * 8} bits, "
            f"but {channels} of {dtype.itemsize * 8} bits are needed; write it again in that form"
        )
    if image.shape[:2] != shape:
        height, width = image.shape[:2]
        raise SourceError(
            f"{path} is {width} x {height} pixels, but rig.json says {shape[1]} x {shape[0]}; "
            "use the rig of the camera that took it"
        )
    return image


def _read_metres(path: Path, shape: tuple[int, int]) -> Float32Array:
    try:
        depth = parse_npy(read_file(path))
    except (OSError, ValueError) as error:
        raise SourceError(f"{path} is no readable NumPy array ({error}); export or copy it again") from error
    if depth.dtype != np.float32 or depth.shape != shape:
        raise SourceError(
            f"{path} holds {depth.dtype}, {depth.shape}, but float32, {shape} is needed; write it again in that form"
        )
    return depth


def _metres(counts: Uint16Array, unit_m: float) -> Float32Array:
    metres = counts.astype(np.float32) * np.float32(unit_m)
    return np.where(valid_depth(counts), metres, np.float32(np.nan))


def _counts(depth_m: Float32Array, unit_m: float) -> Uint16Array:
    """Round metres to counts; 0 where there is no depth or too much for 16 bits."""
    with np.errstate(invalid="ignore"):
        counts = np.rint(depth_m.astype(np.float64) / unit_m)
        return np.where((counts >= 1) & (counts < NO_DEPTH_COUNTS[1]), counts, 0).astype(np.uint16)


def _write_recording(source: FrameSource, folder: Path, frames: int | None, progress: Progress | None) -> int:
    available = math.inf if source.length is None else source.length - source.position
    total = int(min(math.inf if frames is None else frames, available))
    _write_file(folder / "rig.json", json_text(rig_to_json(source.rig)))
    untouched = source.untouched()
    if untouched is not None:
        _write_frame(folder / "untouched", untouched, source.rig)
    count = 0
    seen: set[int] = set()
    while count < total and (frame := source.next_frame()) is not None:
        note_number(seen, frame)
        _write_frame(folder / f"{count:06d}", frame, source.rig)
        count += 1
        if progress is not None:
            progress(count / total, f"frame {count} of {total}")
    if count == 0:
        raise ExportError(f"{source.name} has no frames left to export; seek to the first one")
    return count


def _write_frame(folder: Path, frame: SensorFrame, rig: Rig) -> None:
    frame.check_against(rig)
    folder.mkdir()
    stamp = {
        "sequence": int(frame.sequence),
        "proximity_time_s": float(frame.proximity_time_s),
        "tactile_time_s": float(frame.tactile_time_s),
    }
    _write_file(folder / "frame.json", json_text(stamp))
    _write_image(folder / "proximity_depth.png", frame.proximity_depth)
    _write_image(folder / "tactile_depth.png", frame.tactile_depth)
    _write_image(folder / "proximity_color.png", frame.proximity_color[:, :, ::-1])
    if frame.tactile_color is not None:
        if frame.tactile_color.shape[:2] != frame.tactile_depth.shape:
            raise FrameError(f"frame {frame.sequence}: tactile_color is not aligned to the tactile depth; leave it out")
        _write_image(folder / "tactile_color.png", frame.tactile_color[:, :, ::-1])
    if frame.truth is not None:
        if frame.truth.contact.shape != frame.proximity_depth.shape:
            raise FrameError(f"frame {frame.sequence}: its truth is not in proximity depth pixels; leave it out")
        _write_truth(folder, frame.truth, rig.proximity.depth_unit_m)


def _write_truth(folder: Path, truth: GroundTruth, unit_m: float) -> None:
    _write_image(folder / "truth_contact.png", truth.contact.astype(np.uint8) * np.uint8(255))
    if truth.depth_m is None:
        return
    counts = _counts(truth.depth_m, unit_m)
    _write_image(folder / "truth_depth.png", counts)
    if not np.array_equal(_metres(counts, unit_m), truth.depth_m, equal_nan=True):
        array = io.BytesIO()
        np.save(array, truth.depth_m)  # np.save does not report a full disk
        _write_file(folder / "truth_depth.npy", array.getvalue())


def _write_image(path: Path, image: AnyArray) -> None:
    encoded, data = cv2.imencode(".png", np.ascontiguousarray(image))
    if not encoded:
        raise ExportError(f"cannot write {path}: an image of {image.shape} pixels cannot be a PNG")
    _write_file(path, data.tobytes())


def _write_file(path: Path, data: bytes | str) -> None:
    """Write a file and wait until it is on the disk, before the folder gets its final name."""
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    with path.open("rb+") as file:
        os.fsync(file.fileno())


KIND = SourceKind(
    scheme="folder",
    title="Folder of images",
    form="folder:PATH",
    description="PNG images with rig.json beside them: one frame, or numbered subfolders.",
    needs="folder",
    pattern="rig.json",
    open=lambda rest, progress, cameras: FolderSource(rest),
)
