"""Recordings as folders of images that any program can read and write.

A recording is a folder with ``rig.json`` (see `tactune.core.model.rig_file`) and one frame or numbered subfolders with
one frame each; a subfolder ``untouched`` may hold a frame of the untouched membrane. A frame is::

    proximity_depth.png   16 bit, counts
    proximity_color.png   8 bit, colour                                            (optional)
    tactile_depth.png     16 bit, counts                                           (optional)
    tactile_color.png     8 bit, colour, aligned to the tactile depth image        (optional)
    truth_contact.png     8 bit, 0 or 255, proximity pixels                        (optional)
    truth_depth.npy       float32 metres, proximity pixels, nan where unknown      (optional)
    frame.json            sequence, proximity_time_s, tactile_time_s               (optional)

Depth may also be ``.tif``, ``.npy`` or ``.pgm``, colour ``.jpg``; `folder_layout` names the layouts of others. A camera
in ``rig.json`` may have two fields that other recordings do not need: ``rectify`` (``model`` and ``coefficients`` of a
lens model that `Intrinsics` lacks), and ``value_m``, metres that a floating-point value stands for.
"""

from __future__ import annotations

import io
import os
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Final

import cv2
import numpy as np
from pydantic import Field

from ..errors import ExportError, SourceError, writing
from ..model.arrays import AnyArray, Float64Array, Uint8Array, Uint16Array
from ..model.files import atomic_path, remove_leftovers, user_path
from ..model.frames import MAX_TIME_S, DepthCamera, GroundTruth, Rig, SensorFrame, Shot, note_number
from ..model.intrinsics import Frozen
from ..model.loading import decode_image, parse_npy, read_file
from ..model.rig_file import json_text, parse_rig, read_json_object, rig_to_json, validating
from .base import FrameSource, Health, Progress, SeekableSource, frames_to_write, from_first_s
from .folder_layout import FrameFiles, find_frames, own_images
from .lens_files import Lens, make_lens
from .ros_image import damage_told

CAMERAS: Final = ("proximity", "tactile", "proximity_color")


class Rectify(Frozen, strict=True):
    """A lens model beyond Brown-Conrady, as `make_lens` takes it."""

    model: str
    coefficients: Annotated[list[float], Field(max_length=14)]


class Form(Frozen, strict=True):
    """What `Rig` does not say about the images of one camera of a folder."""

    rectify: Rectify | None = None
    value_m: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0


def load_folder_rig(path: Path) -> tuple[Rig, dict[str, tuple[float, Lens]]]:
    """Return the rig of a folder, and the metres of a value and the lens of each camera; errors as of `load_rig`."""
    data = read_json_object(path)
    stated: dict[str, Form] = {}
    for name in CAMERAS:
        if isinstance(camera := data.get(name), dict):
            fields = {key: camera[key] for key in Form.model_fields if key in camera}
            with validating(f"{path}: {name}", "a camera"):
                stated[name] = Form.model_validate(fields)
    rig = parse_rig(data, str(path))
    alone = stated.get("tactile", Form())
    stated.setdefault("proximity", alone)  # of a rig with a tactile camera only
    stated.setdefault("proximity_color", stated["proximity"])  # aligned colour has the lens of the depth
    forms = {}
    for name, camera in zip(CAMERAS, (rig.proximity, rig.tactile, rig.proximity_color or rig.proximity), strict=True):
        lens, special = camera.intrinsics, stated[name].rectify
        given = Lens(lens)
        if special is not None:
            matrix = lens.camera_matrix().ravel().tolist()
            given = make_lens(special.model, special.coefficients, matrix, lens.shape[::-1])
        forms[name] = stated[name].value_m, given
    return rig, forms


def write_rig(path: Path, rig: Rig, forms: dict[str, dict[str, Any]] | None = None) -> None:
    """Write ``rig.json`` with the cameras' ``forms`` into a folder, whole or not at all; one that is there stays."""
    data = rig_to_json(rig)
    for name, fields in (forms or {}).items():
        data[name] |= fields
    with atomic_path(path / "rig.json", exclusive=True) as temporary:
        temporary.write_text(json_text(data), encoding="utf-8")


def read_depth(path: Path, camera: DepthCamera, value_m: float, lens: Lens) -> Uint16Array:
    """Return the counts of a depth image, uint16 (H, W), in the camera's unit; 0 is no depth."""
    image = check_size(path, read_values(path), camera.intrinsics.shape)
    if image.dtype.kind == "f":
        with np.errstate(invalid="ignore", over="ignore"):
            counts = image * (value_m / camera.depth_unit_m)
            known = (counts > 0) & (counts < np.iinfo(np.uint16).max)
            if not known.any() and (far := image[np.isfinite(counts) & (counts > 0)]).size:
                raise SourceError(
                    f"{path} has depths of {far.min() * value_m:g} m and more, beyond the camera's range; if they are "
                    "millimetres, remove rig.json and run tactune preset create-rig with --unit mm"
                )
        image = np.rint(np.where(known, counts, 0)).astype(np.uint16)
    return np.asarray(lens.rectify(image), np.uint16)


def read_values(path: Path) -> AnyArray:
    """Return a depth image as its file has it: uint16 counts or floating-point values, shape (H, W)."""
    image = read_image(path)
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[:, :, 0]
    if image.dtype.kind in "iu" and image.dtype.itemsize > 1 and image.ndim == 2:
        if image.dtype != np.uint16 and image.size and (image.min() < 0 or image.max() > np.iinfo(np.uint16).max):
            raise SourceError(f"{path} has counts from {image.min()} to {image.max()}; save them as uint16")
        return image.astype(np.uint16)
    if image.dtype.kind == "f" and image.ndim == 2:
        return image.astype(np.float64)
    raise SourceError(
        f"{path} has {image.dtype}, {image.shape}; save depth itself: one channel of 16 bits or floating-point values"
    )


def read_color(path: Path, shape: tuple[int, int], lens: Lens) -> Uint8Array:
    """Return a colour image, RGB uint8 (H, W, 3); grey becomes colour, transparency and the lower 8 of 16 bits go."""
    image = check_size(path, read_image(path), shape)
    if image.dtype == np.uint16:
        image = (image >> 8).astype(np.uint8)
    channels = image.shape[2] if image.ndim == 3 else 1
    if image.dtype != np.uint8 or channels not in _TO_RGB or path.suffix.lower() == ".npy":
        raise SourceError(
            f"{path} has {channels} channels of {image.dtype.itemsize * 8} bits, but colour is a PNG or JPEG of 8 bits "
            "with 1, 3 or 4 channels; save it in that form"
        )
    rgb = np.asarray(cv2.cvtColor(image, _TO_RGB[channels]), np.uint8)
    return np.ascontiguousarray(lens.rectify(rgb))


_TO_RGB: Final = {1: cv2.COLOR_GRAY2RGB, 3: cv2.COLOR_BGR2RGB, 4: cv2.COLOR_BGRA2RGB}


def read_image(path: Path) -> AnyArray:
    """Return an image or a ``.npy`` as it is; `SourceError` if it cannot be read."""
    is_array = path.suffix.lower() == ".npy"
    with damage_told(path, f"it is no readable {'NumPy array' if is_array else f'{path.suffix[1:].upper()} image'}"):
        return parse_npy(read_file(path)) if is_array else decode_image(read_file(path))


def check_size(path: Path, image: AnyArray, shape: tuple[int, int]) -> AnyArray:
    """Return an image of this height and width; `SourceError` for another size."""
    if image.shape[:2] != shape:
        found = " x ".join(map(str, image.shape[1::-1])) if image.ndim in (2, 3) else str(image.shape)
        raise SourceError(f"{path} is {found} pixels, its rig.json says {shape[1]} x {shape[0]}; use its camera's rig")
    return image


_Seconds = Annotated[float, Field(ge=-MAX_TIME_S, le=MAX_TIME_S)]


class _Stamp(Frozen, strict=True):
    """The contents of ``frame.json``."""

    sequence: Annotated[int, Field(ge=0, lt=2**63)]
    proximity_time_s: _Seconds
    tactile_time_s: _Seconds


class FolderSource(SeekableSource):
    """A recording in a folder; the module's docstring describes the format."""

    def __init__(self, path: Path | str) -> None:
        self._path = user_path(path)
        name = f"folder:{path}"
        rig, self._forms = load_folder_rig(self._path / "rig.json")
        self._layout = find_frames(self._path)
        frames = enumerate(self._layout.frames)
        self._stamps = [_read_stamp(files, index) for index, files in frames]
        if len({stamp.sequence for stamp in self._stamps}) < len(self._stamps):  # frames are told apart by it
            raise SourceError(f"{self._path} has two frames of the same sequence in frame.json; correct it")
        self._times_s = np.array([stamp.proximity_time_s for stamp in self._stamps])
        super().__init__(name, rig, len(self._stamps))
        median_s = float(np.median(np.diff(self._times_s))) if len(self._times_s) > 1 else 0.0
        if median_s > 0:
            self.frame_rate_hz = 1.0 / median_s
        first = self._layout.frames[0].images
        color, shape = first.get("proximity_color"), rig.proximity_color_shape
        if not rig.has_proximity:
            color = first.get("tactile_color") or color
        #: Colour of another size than the rig says is left out.
        self._shows_color = color is not None and read_image(color).shape[:2] == shape
        self.read(0)

    def times_s(self) -> Float64Array | None:
        return from_first_s(self._times_s)

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
            camera = "proximity " if self.rig.has_proximity else ""
            lacks.append(f"this folder has no {camera}colour, or of another size than rig.json says: it is not shown")
        if self._layout.unmatched:
            lacks.append(f"{self._layout.unmatched} images without a partner from the other camera are left out")
        return Health(ok=not lacks, message="; ".join(lacks), unmatched=self._layout.unmatched)

    def _frame(self, files: FrameFiles, stamp: _Stamp) -> SensorFrame:
        rig, images, where = self.rig, files.images, files.folder or self._path
        if not rig.has_proximity:  # the only camera, whatever its files are called
            images = {slot.replace("proximity", "tactile"): path for slot, path in images.items()}
        if not self._shows_color:
            hidden = "proximity_color" if rig.has_proximity else "tactile_color"
            images = {slot: path for slot, path in images.items() if slot != hidden}
        for slot in ("proximity_depth", "tactile_depth") if rig.has_proximity else ("tactile_depth",):
            if slot not in images:
                raise SourceError(f"{where} has no {slot}.png, and no .tif, .npy or .pgm of that name; add it")
        truth = None if files.folder is None else _read_truth(files.folder, rig)
        value_m, lens = self._forms["tactile"]
        depth, color = read_depth(images["tactile_depth"], rig.tactile, value_m, lens), None
        if "tactile_color" in images:
            color = read_color(images["tactile_color"], rig.tactile.intrinsics.shape, lens)
        tactile, proximity = Shot(depth, color, stamp.tactile_time_s), None
        if rig.has_proximity:
            depth, color = read_depth(images["proximity_depth"], rig.proximity, *self._forms["proximity"]), None
            if "proximity_color" in images:
                lens = self._forms["proximity_color"][1]
                color = read_color(images["proximity_color"], rig.proximity_color_shape, lens)
            proximity = Shot(depth, color, stamp.proximity_time_s)
        return SensorFrame.of_shots(rig, stamp.sequence, proximity, tactile, truth)


def export_folder(
    source: FrameSource, path: Path | str, frames: int | None = None, progress: Progress | None = None
) -> int:
    """Write at most ``frames`` of a source, from its present position, as a new folder, whole or not at all."""
    target = Path.cwd() / user_path(path)
    temporary = target.parent / f".{target.name}-{secrets.token_hex(4)}.partial"
    try:
        with writing(target):
            if target.exists() and (not target.is_dir() or any(target.iterdir())):
                raise ExportError(f"{target} is already there, not an empty folder; choose another name or remove it")
            remove_leftovers(target.parent, f"{target.name}.partial")
            temporary.mkdir(parents=True)
            count = _write_recording(source, temporary, frames_to_write(source, frames, progress))
            temporary.rename(target)  # takes the place of an empty folder in one step
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return count


def _read_stamp(files: FrameFiles, index: int) -> _Stamp:
    """Read ``frame.json``; without one, times are those of the layout."""
    path = None if files.folder is None else files.folder / "frame.json"
    if path is None or not path.exists():
        return _Stamp(sequence=index, proximity_time_s=files.proximity_time_s, tactile_time_s=files.tactile_time_s)
    with validating(str(path), "a frame"):
        return _Stamp.model_validate(read_json_object(path))


def _read_truth(folder: Path, rig: Rig) -> GroundTruth | None:
    shape = rig.proximity.intrinsics.shape
    contact, metres = folder / "truth_contact.png", folder / "truth_depth.npy"
    if not contact.exists():
        return None
    mask = check_size(contact, read_image(contact), shape)
    if mask.dtype != np.uint8 or mask.ndim != 2 or not np.isin(mask, (0, 255)).all():
        raise SourceError(f"{contact} is no image of one channel with 0 and 255; write it again in that form")
    depth = None
    if metres.exists():
        depth = read_image(metres)
        if depth.dtype != np.float32 or depth.shape != shape:
            raise SourceError(f"{metres} holds {depth.dtype}, {depth.shape}, not float32, {shape}; write it again")
    return GroundTruth(mask == 255, depth)


def _write_recording(source: FrameSource, folder: Path, frames: Iterator[SensorFrame]) -> int:
    _write_file(folder / "rig.json", json_text(rig_to_json(source.rig)))
    untouched = source.untouched()
    if untouched is not None:
        _write_frame(folder / "untouched", untouched, source.rig)
    count = 0
    seen: set[int] = set()
    for count, frame in enumerate(frames, start=1):
        note_number(seen, frame.sequence)
        _write_frame(folder / f"{count - 1:06d}", frame, source.rig)
    return count


def _write_frame(folder: Path, frame: SensorFrame, rig: Rig) -> None:
    frame.check_against(rig)
    folder.mkdir()
    _write_file(folder / "frame.json", json_text(frame.numbers()))
    for name, image in frame.images(rig).items():
        if name == "truth_depth_m":
            array = io.BytesIO()
            np.save(array, image)  # np.save does not report a full disk
            _write_file(folder / "truth_depth.npy", array.getvalue())
            continue
        pixels = image[:, :, ::-1] if image.ndim == 3 else image
        pixels = pixels * np.uint8(255) if pixels.dtype == np.bool_ else np.ascontiguousarray(pixels)
        _write_file(folder / f"{name}.png", cv2.imencode(".png", pixels)[1].tobytes())


def _write_file(path: Path, data: bytes | str) -> None:
    """Write a file and wait until it is on the disk, before the folder gets its final name."""
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    with path.open("rb+") as file:
        os.fsync(file.fileno())
