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
import zlib
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from ..errors import FrameError, SourceError, foreign
from .arrays import AnyArray
from .frames import GroundTruth, SensorFrame

#: Size limit of a JSON file. Decoded, JSON takes up to 25 times its size in memory.
MAX_JSON_BYTES: Final = 12_000_000
#: An image has at most this many pixels, plus 8 for each of its bytes: 17 megapixels take 100 MB as colour of 16 bits.
_MAX_PIXELS: Final = 2**24
#: Limit of what an archive of arrays unpacks to, beyond 8 times its own size.
_MAX_UNPACKED_BYTES: Final = 200_000_000
_PNG_START: Final = b"\x89PNG\r\n\x1a\n"
#: The parts of a PNG that hold its pixels, and the bits that each of its types of colour may have.
_PNG_PARTS: Final = (b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND")
_PNG_BITS: Final = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
#: The mark at the end of a JPEG, behind which cameras may pad this many bytes.
_JPEG_START: Final = b"\xff\xd8\xff"
_JPEG_END: Final = b"\xff\xd9"
_JPEG_PADDING: Final = 4096

#: CPython 3.11 fails if two threads parse literals at the same time, as NumPy does for the header of each array.
_parsing = threading.Lock()


def open_regular(path: Path | str) -> BinaryIO:
    """Open a file for reading; `OSError` for a pipe, a device or a socket, reading which might never end."""
    without_waiting = getattr(os, "O_NONBLOCK", 0)  # else opening a pipe waits for its writer
    file = open(  # noqa: SIM115  # whoever calls closes it
        path, "rb", opener=lambda name, flags: os.open(name, flags | without_waiting)
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
    except json.JSONDecodeError as error:
        raise ValueError(f"not valid JSON (line {error.lineno}, column {error.colno}: {error.msg})") from error
    except UnicodeDecodeError as error:
        raise ValueError(f"not valid JSON (byte {error.start} is no UTF-8)") from error
    except RecursionError as error:
        raise ValueError("not valid JSON (it is nested too deep)") from error


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
    """Return a PNG, JPEG or BMP image as OpenCV does: shape (rows, columns) or (rows, columns, channels), BGR.

    `ValueError` if it is none of these, is damaged, or claims far more pixels than its bytes can hold.
    """
    import cv2  # on demand: presets and patches need no images

    # OpenCV's libraries would complain on the terminal, and return something
    if data.startswith(_PNG_START):
        image_size(data)
        data = _pixels_of_png(data)
    elif data.startswith(_JPEG_START) and _JPEG_END not in data[-_JPEG_PADDING:]:
        raise ValueError("it is cut off")
    image = None
    with suppress(cv2.error):
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE if gray else cv2.IMREAD_UNCHANGED)
    if image is None:
        raise ValueError("it is no image, or damaged")
    return np.asarray(image)


def image_size(data: bytes) -> tuple[int, int]:
    """Return width and height of an image, of a PNG as its header claims them; `ValueError` as `decode_image`."""
    if not data.startswith(_PNG_START):
        height, width = decode_image(data, gray=True).shape
        return width, height
    width, height = (int.from_bytes(data[at : at + 4]) for at in (16, 20))
    if not 0 < width * height <= _MAX_PIXELS + 8 * len(data):
        raise ValueError(f"it claims {width} x {height} pixels in {len(data)} bytes")
    return width, height


def _pixels_of_png(png: bytes) -> bytes:
    """Return a PNG without profiles, times and notes; `ValueError` if it is cut off or its header cannot be."""
    parts, at, view = [_PNG_START], len(_PNG_START), memoryview(png)
    names: list[bytes] = []
    while not names or names[-1] != b"IEND":
        end = at + 8 + int.from_bytes(view[at : at + 4])
        name = png[at + 4 : at + 8]
        if end + 4 > len(png) or zlib.crc32(view[at + 4 : end]) != int.from_bytes(view[end : end + 4]):
            raise ValueError("its checksums are wrong")
        if name in _PNG_PARTS:
            names.append(name)
            parts.append(png[at : end + 4])
        elif name[:1].isupper():
            raise ValueError(f"its part {foreign(name.decode('latin1'))} is unknown")
        at = end + 4
    bits, color = png[24:26]
    before = names[: names.index(b"IDAT")] if b"IDAT" in names else []
    if before[:1] != [b"IHDR"] or names.count(b"IHDR") > 1 or bits not in _PNG_BITS.get(color, ()):
        raise ValueError("its header is damaged")
    if color == 3 and b"PLTE" not in before:
        raise ValueError("its palette is missing")
    return b"".join(parts)


_ARRAYS = ("proximity_depth", "tactile_depth", "proximity_color", "tactile_color")
_NUMBERS = ("sequence", "proximity_time_s", "tactile_time_s")


def frame_arrays(frame: SensorFrame) -> dict[str, Any]:
    """Return what an ``.npz`` of a frame holds, by name; `frame_from_bytes` reads it and ignores other names."""
    arrays = {name: getattr(frame, name) for name in (*_ARRAYS, *_NUMBERS)}
    if frame.truth is not None:
        arrays |= {"truth_contact": frame.truth.contact, "truth_depth_m": frame.truth.depth_m}
    return {name: it for name, it in arrays.items() if it is not None}


def untouched_bytes(frame: SensorFrame) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **frame_arrays(frame))
    return buffer.getvalue()


def frame_from_bytes(data: bytes) -> SensorFrame:
    """Return the frame in the bytes of an ``.npz``; raise `FrameError` if they are damaged."""
    try:
        arrays = parse_npz(data)
        truth = None
        if "truth_contact" in arrays:
            truth = GroundTruth(arrays["truth_contact"], arrays.get("truth_depth_m"))
        return SensorFrame(
            sequence=int(arrays["sequence"]),
            proximity_depth=arrays["proximity_depth"],
            tactile_depth=arrays["tactile_depth"],
            proximity_color=arrays["proximity_color"],
            tactile_color=arrays.get("tactile_color"),
            proximity_time_s=float(arrays["proximity_time_s"]),
            tactile_time_s=float(arrays["tactile_time_s"]),
            truth=truth,
        )
    except KeyError as error:
        raise FrameError(f"it has no array {error.args[0]}") from error
    except (ValueError, TypeError, OverflowError) as error:
        raise FrameError(str(error)) from error


def parse_untouched(data: bytes, origin: str) -> SensorFrame:
    """Return the frame; `SourceError` where the bytes are none."""
    try:
        return frame_from_bytes(data)
    except FrameError as error:
        raise SourceError(f"{origin}: its untouched frame is damaged ({error}); copy or record it again") from error
