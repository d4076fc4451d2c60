"""Recordings as folders of PNG images that any program can read and write.

A recording is a folder with ``rig.json`` (see `tactune.core.model.rig_file`) and either one frame or
numbered subfolders with one frame each; a subfolder ``untouched`` may hold a frame of the untouched
membrane. A frame is::

    proximity_depth.png   16 bit, counts
    proximity_color.png   8 bit, colour
    tactile_depth.png     16 bit, counts
    tactile_color.png     8 bit, colour, aligned to the tactile depth image        (optional)
    truth_contact.png     8 bit, 0 or 255, proximity pixels                        (optional)
    truth_depth.npy       float32 metres, proximity pixels, nan where unknown      (optional)
    truth_depth.png       the same in 16 bit and counts, 0 where unknown           (only read)
    frame.json            sequence, proximity_time_s, tactile_time_s               (optional)
"""

from __future__ import annotations

import io
import os
import re
import secrets
import shutil
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ..errors import ExportError, SourceError
from ..model.arrays import AnyArray, Float32Array, Uint8Array
from ..model.clouds import valid_depth
from ..model.files import atomic_path, remove_leftovers, user_path
from ..model.frames import MAX_TIME_S, GroundTruth, Rig, SensorFrame, note_number
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
        if len({stamp.sequence for stamp in self._stamps}) < len(self._stamps):  # result files are named by it
            raise SourceError(f"{self._path} has two frames of the same sequence in frame.json; correct it")
        super().__init__(name, rig, len(self._folders))
        self.read(0)

    @property
    def frame_rate_hz(self) -> float:
        """Rate from the median interval of the time stamps; 30 Hz where they have none."""
        gaps = np.diff([stamp.proximity_time_s for stamp in self._stamps])
        median = float(np.median(gaps)) if len(gaps) else 0.0
        return 1.0 / median if median > 0 else _NOMINAL_RATE_HZ

    def read(self, index: int) -> SensorFrame:
        return _read_frame(self._folders[index], self._stamps[index], self._rig)

    def untouched(self) -> SensorFrame | None:
        """Return the frame in the subfolder ``untouched``, or None if there is none."""
        folder = self._path / "untouched"
        if not folder.is_dir():
            return None
        return _read_frame(folder, _read_stamp(folder, 0), self._rig)


def export_folder(
    source: FrameSource, path: Path | str, frames: int | None = None, progress: Progress | None = None
) -> int:
    """Write at most ``frames`` of a source, from its present position, as a folder of images; return how many.

    Everything goes to a temporary folder beside ``path``, which gets its name only when it is complete; ``path`` must
    not exist yet, or be empty.
    """
    target = Path.cwd() / user_path(path)
    if frames is None and source.length is None:
        raise ExportError(f"{source.name} is live and has no end; say how many frames to export")
    temporary = target.parent / f".{target.name}-{secrets.token_hex(4)}.partial"
    try:
        if target.exists() and (not target.is_dir() or any(target.iterdir())):
            raise ExportError(f"{target} is already there and not an empty folder; choose another name or remove it")
        remove_leftovers(target.parent, f"{target.name}.partial")
        temporary.mkdir(parents=True)
        count = _write_recording(source, temporary, frames, progress)
        if target.exists():
            target.rmdir()
        temporary.rename(target)
    except OSError as error:
        raise ExportError(f"cannot write {target}: {error.strerror or error}; choose another place") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return count


def first_image_sizes(path: Path) -> dict[str, tuple[int, int]]:
    """Return height and width of the images of a folder's first frame, by file name; it needs no ``rig.json``."""
    first = _frame_folders(path)[0]
    return {
        name: _read_image(first / name, bits, channels, None).shape[:2]
        for name, (needed, bits, channels) in IMAGES.items()
        if needed or (first / name).exists()
    }


def write_rig(path: Path, rig: Rig) -> None:
    """Write ``rig.json`` into a folder, whole or not at all; one that is there is never replaced."""
    with atomic_path(path / "rig.json", exclusive=True) as temporary:
        temporary.write_text(json_text(rig_to_json(rig)), encoding="utf-8")


def _frame_folders(path: Path) -> list[Path]:
    """Return the frames of a recording by their numbers, or the folder itself if it is one frame."""
    numbered = [entry for entry in path.iterdir() if re.fullmatch("[0-9]+", entry.name) and entry.is_dir()]
    numbered.sort(key=lambda folder: int(folder.name))
    single = any((path / name).exists() for name in _REQUIRED)
    if single and numbered:
        raise SourceError(f"{path} has images and numbered subfolders ({numbered[0].name}); keep one of the two")
    if not numbered and not single:
        raise SourceError(
            f"{path} has no frames: neither {_REQUIRED[0]} nor numbered subfolders such as 000000; "
            "export or copy the recording again"
        )
    return numbered or [path]


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
        proximity_depth=_read_image(folder / "proximity_depth.png", 16, 1, proximity),
        tactile_depth=_read_image(folder / "tactile_depth.png", 16, 1, tactile),
        proximity_color=_read_color(folder / "proximity_color.png", rig.proximity_color_shape),
        tactile_color=_read_color(tactile_color, tactile) if tactile_color.exists() else None,
        proximity_time_s=stamp.proximity_time_s,
        tactile_time_s=stamp.tactile_time_s,
        truth=_read_truth(folder, rig),
    )


def _read_truth(folder: Path, rig: Rig) -> GroundTruth | None:
    shape = rig.proximity.intrinsics.shape
    contact, metres, counts = (folder / f"truth_{name}" for name in ("contact.png", "depth.npy", "depth.png"))
    if not contact.exists():
        return None
    mask = _read_image(contact, 8, 1, shape)
    depth = _read_metres(metres, shape) if metres.exists() else None
    if depth is None and counts.exists():
        found = _read_image(counts, 16, 1, shape)
        known = found.astype(np.float32) * np.float32(rig.proximity.depth_unit_m)
        depth = np.where(valid_depth(found), known, np.float32(np.nan))
    if not np.isin(mask, (0, 255)).all():
        raise SourceError(f"{contact} contains other values than 0 and 255; write it again")
    return GroundTruth(mask == 255, depth)


def _read_color(path: Path, shape: tuple[int, int]) -> Uint8Array:
    return np.ascontiguousarray(_read_image(path, 8, 3, shape)[:, :, ::-1])


def _read_image(path: Path, bits: int, channels: int, shape: tuple[int, int] | None) -> AnyArray:
    """Read one image of unsigned integers and check its bit depth, its channels and its size, if one is given."""
    try:
        image = decode_image(read_file(path))
    except OSError as error:
        raise SourceError(f"cannot read {path}: {error.strerror or error}; export or copy it again") from error
    except ValueError as error:
        raise SourceError(f"{path} is no readable PNG image ({error}); export or copy it again") from error
    found = image.shape[2] if image.ndim == 3 else 1
    if image.dtype != f"uint{bits}" or found != channels:
        raise SourceError(
            f"{path} has {found} channels of {image.dtype.itemsize * 8} bits, "
            f"but {channels} of {bits} bits are needed; write it again in that form"
        )
    if shape is not None and image.shape[:2] != shape:
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


def _write_recording(source: FrameSource, folder: Path, frames: int | None, progress: Progress | None) -> int:
    left = None if source.length is None else source.length - source.position
    total = min(count for count in (left, frames) if count is not None)
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
        _write_image(folder / "tactile_color.png", frame.tactile_color[:, :, ::-1])
    if frame.truth is not None:
        _write_image(folder / "truth_contact.png", frame.truth.contact.astype(np.uint8) * np.uint8(255))
        if frame.truth.depth_m is not None:
            array = io.BytesIO()
            np.save(array, frame.truth.depth_m)  # np.save does not report a full disk
            _write_file(folder / "truth_depth.npy", array.getvalue())


def _write_image(path: Path, image: AnyArray) -> None:
    _write_file(path, cv2.imencode(".png", np.ascontiguousarray(image))[1].tobytes())


def _write_file(path: Path, data: bytes | str) -> None:
    """Write a file and wait until it is on the disk, before the folder gets its final name."""
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    with path.open("rb+") as file:
        os.fsync(file.fileno())


KIND = SourceKind(
    scheme="folder",
    title="Folder of images",
    form="folder:PATH",
    needs="folder",
    pattern="rig.json",
    open=lambda rest, progress, cameras: FolderSource(rest),
)
