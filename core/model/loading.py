"""Loading of files that may be damaged or hostile: bytes, JSON, NumPy arrays, images and frames.

Everything that comes from a disk is read here. Each function raises `OSError` or `ValueError` with a short reason,
before a small file can take much memory; the caller adds the file, its error class and the remedy.
"""

from __future__ import annotations

import io
import json
import os
import stat
import threading
import zipfile
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from ..errors import FrameError, foreign
from .arrays import AnyArray
from .frames import IMAGES, GroundTruth, SensorFrame

#: Size limit of a JSON file. Decoded, JSON takes up to 25 times its size in memory.
MAX_JSON_BYTES: Final = 12_000_000
#: An image has at most this many pixels, plus 8 for each of its bytes: 17 megapixels take 100 MB as colour of 16 bits.
_MAX_PIXELS: Final = 2**24
#: Limit of what an archive of arrays unpacks to, beyond 8 times its own size.
_MAX_UNPACKED_BYTES: Final = 200_000_000
#: The modes of Pillow that need no conversion.
_PLAIN_MODES: Final = ("L", "I;16", "I;16B", "I", "F", "RGB", "RGBA")

#: CPython 3.11 fails if two threads parse literals at the same time, as NumPy does for the header of each array.
_parsing = threading.Lock()


def open_regular(path: Path | str) -> BinaryIO:
    """Open a file for reading; `OSError` for a pipe, a device or a socket, reading which might never end."""
    file = open(  # noqa: SIM115  # whoever calls closes it; without O_NONBLOCK opening a pipe waits for its writer
        path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK)
    )
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise OSError("it is no ordinary file")
    return file


def read_file(path: Path | str, limit: int | None = None) -> bytes:
    """Return the bytes of a regular file; `OSError` where there is none, or where it has more than ``limit`` bytes."""
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        if limit is not None and size > limit:
            raise OSError(f"it has {size / 1e6:.1f} MB, more than the {limit / 1e6:.1f} MB that are read")
        return file.read()


def parse_json(text: str | bytes) -> Any:
    """Return what a JSON text says; `ValueError` if it is none, too large or too deep, or a key stands twice."""
    if len(text) > MAX_JSON_BYTES:
        raise ValueError(f"it has {len(text) / 1e6:.1f} MB, more than the {MAX_JSON_BYTES / 1e6:.1f} MB that are read")
    try:
        return json.loads(text, object_pairs_hook=_unique)
    except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ValueError(f"not valid JSON ({error})") from error


def read_json(path: Path | str) -> Any:
    """Return what a JSON file says; `OSError` or `ValueError` as `read_file` and `parse_json`."""
    return parse_json(read_file(path, MAX_JSON_BYTES))


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise ValueError(f"the key {foreign(key, 80)!r} stands twice in one object; remove one")
        found[key] = value
    return found


def parse_npy(data: bytes) -> AnyArray:
    """Return the array in the bytes of an ``.npy``; `ValueError` if they are damaged or hold Python objects."""
    loaded = _load(data)
    if not isinstance(loaded, np.ndarray):
        raise ValueError("it is an archive of arrays, not a single one")
    return loaded


def parse_npz(data: bytes) -> dict[str, AnyArray]:
    """Return the arrays in the bytes of an ``.npz`` by name; `ValueError` if they are damaged or far too large."""
    if not zipfile.is_zipfile(io.BytesIO(data)):  # NumPy would take it for a pickle
        raise ValueError("it is no archive of arrays (.npz)")
    return dict(_load(data))


def _load(data: bytes) -> Any:
    try:
        if zipfile.is_zipfile(io.BytesIO(data)):
            entries = zipfile.ZipFile(io.BytesIO(data)).infolist()
            unpacked = sum(entry.file_size for entry in entries)
            if unpacked > _MAX_UNPACKED_BYTES + 8 * len(data):
                raise ValueError(f"it unpacks to {unpacked / 1e6:.0f} MB, far too much for its size")
        with _parsing:
            loaded = np.load(io.BytesIO(data), allow_pickle=False)
            return loaded if isinstance(loaded, np.ndarray) else dict(loaded)
    except Exception as error:  # NumPy and zipfile raise a dozen kinds, NumPy with advice to load pickles
        words = " ".join(str(error).split())
        raise ValueError("it is damaged" if "pickle" in words else words or "it is damaged") from error


def decode_image(data: bytes, *, gray: bool = False) -> AnyArray:
    """Return a PNG, JPEG, TIFF, BMP or PGM image: shape (rows, columns) or (rows, columns, channels), BGR.

    `ValueError` if it is none of these, is damaged, or claims far more pixels than its bytes can hold.
    """
    import cv2  # on demand: presets and patches need no images

    pixels = _pillow_pixels(data)
    if pixels.ndim == 2:
        return (pixels >> 8).astype(np.uint8) if gray and pixels.dtype == np.uint16 else pixels
    if gray:
        return np.asarray(cv2.cvtColor(pixels[..., :3], cv2.COLOR_RGB2GRAY))
    return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR if pixels.shape[2] == 3 else cv2.COLOR_RGBA2BGRA))


def _pillow_pixels(data: bytes) -> AnyArray:
    """Return an image, RGB or RGBA if it has colour. For damage, OpenCV's libraries would write to the terminal."""
    from PIL import Image

    Image.MAX_IMAGE_PIXELS = None  # the limit here is stricter, and Pillow's warns on the terminal
    try:
        with Image.open(io.BytesIO(data)) as image:
            width, height = image.size
            if width * height > _MAX_PIXELS + 8 * len(data):
                raise ValueError(f"it claims {width} x {height} pixels in {len(data)} bytes")
            if image.mode == "1":
                return np.asarray(image.convert("L"))
            if image.mode not in _PLAIN_MODES:
                has_alpha = image.mode.lower().endswith("a") or "transparency" in image.info
                return np.asarray(image.convert("RGBA" if has_alpha else "RGB"))
            pixels = np.asarray(image)
            return np.asarray(pixels, pixels.dtype.newbyteorder("="))
    except Exception as error:  # Pillow raises a dozen kinds
        sized = isinstance(error, ValueError) and str(error).startswith("it claims")
        raise ValueError(str(error) if sized else "it is no image, or damaged") from error


def frame_bytes(frame: SensorFrame) -> bytes:
    """Return a frame as an ``.npz``; `frame_from_bytes` reads it and ignores other names."""
    arrays = {name: getattr(frame, name) for name in IMAGES} | frame.numbers()
    if frame.truth is not None:
        arrays |= {"truth_contact": frame.truth.contact, "truth_depth_m": frame.truth.depth_m}
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **{name: it for name, it in arrays.items() if it is not None})
    return buffer.getvalue()


def frame_from_bytes(data: bytes) -> SensorFrame:
    """Return the frame in the bytes of an ``.npz``; raise `FrameError` if they are damaged."""
    try:
        arrays = parse_npz(data)
        truth = None
        if "truth_contact" in arrays:
            truth = GroundTruth(arrays["truth_contact"], arrays.get("truth_depth_m"))
        values: dict[str, Any] = {name: arrays[name] for name in IMAGES if name in arrays or name != "tactile_color"}
        values |= {name: float(arrays[name]) for name in ("proximity_time_s", "tactile_time_s")}
        return SensorFrame(int(arrays["sequence"]), **values, truth=truth)
    except KeyError as error:
        raise FrameError(f"it has no array {error.args[0]}") from error
    except (ValueError, TypeError, OverflowError) as error:
        raise FrameError(str(error)) from error
