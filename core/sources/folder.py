"""Recordings as folders of images that any program can read and write.

A recording is a folder with ``rig.json`` (see `tactune.core.model.rig_file`) and either one frame or
numbered subfolders with one frame each; a subfolder ``untouched`` may hold a frame of the untouched
membrane. A frame is::

    proximity_depth.png   16 bit, counts
    proximity_color.png   8 bit, colour                                            (optional)
    tactile_depth.png     16 bit, counts                                           (optional)
    tactile_color.png     8 bit, colour, aligned to the tactile depth image        (optional)
    truth_contact.png     8 bit, 0 or 255, proximity pixels                        (optional)
    truth_depth.npy       float32 metres, proximity pixels, nan where unknown      (optional)
    truth_depth.png       the same in 16 bit and counts, 0 where unknown           (only read)
    frame.json            sequence, proximity_time_s, tactile_time_s               (optional)

Depth may also be ``.tif``, ``.npy`` or ``.pgm``, colour ``.jpg``; `folder_layout` names the layouts of others.
"""

from __future__ import annotations

import io
import os
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ..errors import ExportError, SourceError
from ..model.arrays import AnyArray, Float32Array
from ..model.clouds import valid_depth
from ..model.files import remove_leftovers, user_path
from ..model.frames import MAX_TIME_S, GroundTruth, Rig, SensorFrame, Shot, note_number
from ..model.loading import parse_npy, read_file
from ..model.rig_file import json_text, read_json_object, rig_to_json, validation_sentence
from .base import FrameSource, Health, Progress, SeekableSource, SourceKind, frames_to_write
from .folder_images import check_size, load_folder_rig, read_color, read_depth, read_image
from .folder_layout import FrameFiles, find_frames, own_images

_NOMINAL_RATE_HZ = 30.0
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
        rig, self._forms = load_folder_rig(self._path / "rig.json")
        self._layout = find_frames(self._path)
        frames = enumerate(self._layout.frames)
        self._stamps = [_read_stamp(files, index) for index, files in frames]
        if len({stamp.sequence for stamp in self._stamps}) < len(self._stamps):  # result files are named by it
            raise SourceError(f"{self._path} has two frames of the same sequence in frame.json; correct it")
        super().__init__(name, rig, len(self._stamps))
        first = self._layout.frames[0].images
        color, shape = first.get("proximity_color"), rig.proximity_color_shape
        if not rig.has_proximity:
            color = first.get("tactile_color") or color
        #: Colour of another size than the rig says is left out.
        self._shows_color = color is not None and read_image(color).shape[:2] == shape
        self.read(0)

    @property
    def frame_rate_hz(self) -> float:
        """Rate from the median interval of the time stamps; 30 Hz where they have none."""
        gaps = np.diff([stamp.proximity_time_s for stamp in self._stamps])
        median = float(np.median(gaps)) if len(gaps) else 0.0
        return 1.0 / median if median > 0 else _NOMINAL_RATE_HZ

    def read(self, index: int) -> SensorFrame:
        return self._frame(self._layout.frames[index], self._stamps[index])

    def untouched(self) -> SensorFrame | None:
        folder = self._path / "untouched"
        if not folder.is_dir():
            return None
        files = FrameFiles(own_images(folder), folder)
        return self._frame(files, _read_stamp(files, 0))

    def health(self) -> Health:
        lacks = []
        if not self._shows_color:
            camera = "proximity " if self._rig.has_proximity else ""
            lacks.append(f"this folder has no {camera}colour of the size that rig.json says: its image stays black")
        if self._layout.unmatched:
            lacks.append(f"{self._layout.unmatched} images without one of the other camera are left out")
        return Health(ok=not lacks, message="; ".join(lacks), unmatched=self._layout.unmatched)

    def _frame(self, files: FrameFiles, stamp: _Stamp) -> SensorFrame:
        rig, images, where = self._rig, files.images, files.folder or self._path
        if not rig.has_proximity:  # the only camera, whatever its files are called
            images = {slot.replace("proximity", "tactile"): path for slot, path in images.items()}
        if not self._shows_color:
            hidden = "proximity_color" if rig.has_proximity else "tactile_color"
            images = {slot: path for slot, path in images.items() if slot != hidden}
        for slot in ("proximity_depth", "tactile_depth") if rig.has_proximity else ("tactile_depth",):
            if slot not in images:
                raise SourceError(f"{where} has no {slot}.png, and no .tif, .npy or .pgm of that name; add it")
        truth = None if files.folder is None else _read_truth(files.folder, rig)
        depth = read_depth(images["tactile_depth"], rig.tactile, self._forms["tactile"])
        color = None
        if "tactile_color" in images:
            color = read_color(images["tactile_color"], rig.tactile.intrinsics.shape, self._forms["tactile"])
        tactile, proximity = Shot(depth, color, stamp.tactile_time_s), None
        if rig.has_proximity:
            depth, color = read_depth(images["proximity_depth"], rig.proximity, self._forms["proximity"]), None
            if "proximity_color" in images:
                form = self._forms["proximity_color"]
                color = read_color(images["proximity_color"], rig.proximity_color_shape, form)
            proximity = Shot(depth, color, stamp.proximity_time_s)
        return SensorFrame.of_shots(rig, stamp.sequence, proximity, tactile, truth)


def export_folder(
    source: FrameSource, path: Path | str, frames: int | None = None, progress: Progress | None = None
) -> int:
    """Write at most ``frames`` of a source, from its present position, as a new folder, whole or not at all."""
    target = Path.cwd() / user_path(path)
    temporary = target.parent / f".{target.name}-{secrets.token_hex(4)}.partial"
    try:
        _check_free(target)
        remove_leftovers(target.parent, f"{target.name}.partial")
        temporary.mkdir(parents=True)
        count = _write_recording(source, temporary, frames_to_write(source, frames, progress))
        _give_name(temporary, target)
    except OSError as error:
        raise ExportError(f"cannot write {target}: {error.strerror or error}; choose another place") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return count


def _give_name(temporary: Path, target: Path) -> None:
    try:
        if os.name == "nt" and target.exists():  # elsewhere a folder takes the place of an empty one in one step
            target.rmdir()
        temporary.rename(target)
    except OSError:
        _check_free(target)
        raise


def _check_free(target: Path) -> None:
    """Raise if there is anything but an empty folder, also one that another program has filled meanwhile."""
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise ExportError(f"{target} is already there and not an empty folder; choose another name or remove it")


def _read_stamp(files: FrameFiles, index: int) -> _Stamp:
    """Read ``frame.json``; without one, times are those of the layout."""
    path = None if files.folder is None else files.folder / "frame.json"
    if path is None or not path.exists():
        return _Stamp(sequence=index, proximity_time_s=files.proximity_time_s, tactile_time_s=files.tactile_time_s)
    try:
        return _Stamp.model_validate(read_json_object(path))
    except ValidationError as error:
        raise SourceError(validation_sentence(error, str(path), "a frame")) from error


def _read_truth(folder: Path, rig: Rig) -> GroundTruth | None:
    shape = rig.proximity.intrinsics.shape
    contact, metres, counts = (folder / f"truth_{name}" for name in ("contact.png", "depth.npy", "depth.png"))
    if not contact.exists():
        return None
    mask = check_size(contact, read_image(contact), shape)
    if mask.dtype != np.uint8 or mask.ndim != 2:
        raise SourceError(f"{contact} is no image of 8 bits and one channel; write it again in that form")
    depth = _read_metres(metres, shape) if metres.exists() else None
    if depth is None and counts.exists():
        found = read_depth(counts, rig.proximity)
        known = found.astype(np.float32) * np.float32(rig.proximity.depth_unit_m)
        depth = np.where(valid_depth(found), known, np.float32(np.nan))
    if not np.isin(mask, (0, 255)).all():
        raise SourceError(f"{contact} contains other values than 0 and 255; write it again")
    return GroundTruth(mask == 255, depth)


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


def _write_recording(source: FrameSource, folder: Path, frames: Iterator[SensorFrame]) -> int:
    _write_file(folder / "rig.json", json_text(rig_to_json(source.rig)))
    untouched = source.untouched()
    if untouched is not None:
        _write_frame(folder / "untouched", untouched, source.rig)
    count = 0
    seen: set[int] = set()
    for count, frame in enumerate(frames, start=1):
        note_number(seen, frame)
        _write_frame(folder / f"{count - 1:06d}", frame, source.rig)
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
    _write_image(folder / "tactile_depth.png", frame.tactile_depth)
    if rig.has_proximity:
        _write_image(folder / "proximity_depth.png", frame.proximity_depth)
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
