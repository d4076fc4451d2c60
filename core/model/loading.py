"""Loading of files that may be damaged or hostile: bytes, JSON, NumPy arrays and images.

Everything that comes from a disk is read here. Each function checks what a file *claims* before it allocates memory for
it, and raises `OSError` or `ValueError` with a short reason; the caller adds the file, its error class and the remedy.
"""

from __future__ import annotations

import io
import json
import math
import os
import stat
import struct
import threading
import tokenize
import zipfile
import zlib
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from .arrays import AnyArray

#: Size limit of a JSON file. Decoded, JSON takes up to 25 times its size in memory.
MAX_JSON_BYTES: Final = 12_000_000
#: An image has at most this many pixels, plus 8 for each of its bytes: 17 megapixels take 100 MB as colour of 16 bits.
_MAX_PIXELS: Final = 2**24
#: Limit of what an archive of arrays unpacks to, beyond 8 times its own size.
_MAX_UNPACKED_BYTES: Final = 200_000_000
_PNG_START: Final = b"\x89PNG\r\n\x1a\n"
#: Markers of a JPEG's segments that contain its size (SOF0 to SOF15 without DHT, JPG and DAC).
_JPEG_SIZES: Final = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
#: What NumPy raises for a header that is no dictionary of Python literals, besides `ValueError`.
_BAD_HEADER: Final = (
    *(TypeError, KeyError, EOFError, SyntaxError, OverflowError, MemoryError, RecursionError),
    *(AttributeError, tokenize.TokenError),
)

#: CPython 3.11 fails if two threads parse literals at the same time, as NumPy does for the header of each array.
_parsing = threading.Lock()


def open_regular(path: Path | str) -> BinaryIO:
    """Open a file for reading; `OSError` for a pipe, a device or a socket, reading which might never end."""
    file = open(path, "rb", opener=_without_waiting)  # noqa: SIM115  # the caller closes it
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise OSError("it is no ordinary file")
    return file


def _without_waiting(path: str, flags: int) -> int:
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))  # else opening a pipe waits for its writer


def read_file(path: Path | str, limit: int | None = None) -> bytes:
    """Return the bytes of a regular file; `OSError` where there is none, or where it has more than ``limit`` bytes."""
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        if limit is not None and size > limit:
            raise OSError(f"it has {size / 1e6:.1f} MB, more than the {limit / 1e6:.1f} MB that are read")
        return file.read()


def parse_json(text: str | bytes) -> Any:
    """Return what a JSON text says.

    Raises
    ------
    ValueError
        No JSON, too large or too deeply nested, a key that stands twice in one object, or a number of too many digits.
    """
    if len(text) > MAX_JSON_BYTES:
        raise ValueError(f"it has {len(text) / 1e6:.1f} MB, more than the {MAX_JSON_BYTES / 1e6:.1f} MB that are read")
    try:
        return json.loads(text, object_pairs_hook=_unique)
    except json.JSONDecodeError as error:
        raise ValueError(f"not valid JSON (line {error.lineno}, column {error.colno}: {error.msg})") from error
    except UnicodeDecodeError as error:
        raise ValueError(f"not valid JSON (no UTF-8 text at byte {error.start})") from error
    except RecursionError as error:
        raise ValueError("not valid JSON (too deep)") from error
    except ValueError as error:
        if "digits" in str(error):  # Python refuses whole numbers of thousands of digits
            raise ValueError("it contains a number of too many digits") from error
        raise


def read_json(path: Path | str) -> Any:
    """Return what a JSON file says; `OSError` or `ValueError` as `read_file` and `parse_json`."""
    return parse_json(read_file(path, MAX_JSON_BYTES))


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"the key {twice[:80]!r} stands twice in one object; remove one")
    return found


def parse_npy(data: bytes) -> AnyArray:
    """Return the array in the bytes of an ``.npy``; `ValueError` if they are damaged or hold Python objects."""
    return _read_array(io.BytesIO(data), len(data))


def parse_npz(data: bytes) -> dict[str, AnyArray]:
    """Return the arrays in the bytes of an ``.npz``, by name.

    Raises
    ------
    ValueError
        No such archive, damaged, encrypted, larger than its own size allows, or with Python objects.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = archive.infolist()
            unpacked = sum(entry.file_size for entry in entries)
            if unpacked > _MAX_UNPACKED_BYTES + 8 * len(data):
                raise ValueError(f"it unpacks to {unpacked / 1e6:.0f} MB, far too much for its size")
            if any(entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for entry in entries):
                raise ValueError("it is packed in a way that NumPy does not use")
            arrays = {}
            for entry in (entry for entry in entries if entry.filename.endswith(".npy")):
                with archive.open(entry) as file:
                    arrays[entry.filename.removesuffix(".npy")] = _read_array(file, entry.file_size)
            return arrays
    except (
        zipfile.BadZipFile,
        zlib.error,
        EOFError,
        OSError,
        RuntimeError,
        NotImplementedError,
    ) as error:
        raise ValueError(" ".join(str(error).split()) or "it is no archive of NumPy arrays") from error


def _read_array(file: Any, size: int) -> AnyArray:
    """Return the array in a file of ``size`` bytes, whose header must claim exactly the bytes that follow it."""
    fmt = np.lib.format
    try:
        with _parsing:
            version = fmt.read_magic(file)
            header = fmt.read_array_header_1_0 if version == (1, 0) else fmt.read_array_header_2_0
            shape, _, dtype = header(file)
        if dtype.hasobject:
            raise ValueError("it holds Python objects, which are not loaded")
        claimed = math.prod(shape) * dtype.itemsize
        if min(shape, default=0) < 0 or max(shape, default=0) > 2**62 or dtype.itemsize == 0:
            raise ValueError(f"it claims an array {dtype} of the shape {shape}")
        if claimed != size - file.tell():
            raise ValueError(f"it claims an array of {claimed} bytes, but has {size - file.tell()}")
        file.seek(0)
        with _parsing:
            return np.asarray(fmt.read_array(file, allow_pickle=False))
    except _BAD_HEADER as error:
        raise ValueError("the header of an array is damaged") from error


def decode_image(data: bytes, *, gray: bool = False) -> AnyArray:
    """Return a PNG, JPEG or BMP image as OpenCV does: shape (rows, columns) or (rows, columns, channels), BGR.

    Raises
    ------
    ValueError
        It is none of these, is damaged, or claims far more pixels than its bytes can hold.
    """
    import cv2  # on demand: presets and patches need no images

    image_size(data)
    image = None
    with suppress(cv2.error):
        if data.startswith(_PNG_START) and not _checksums_are_right(data):
            raise ValueError("its checksums are wrong")  # OpenCV would complain on the terminal, and return something
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE if gray else cv2.IMREAD_UNCHANGED)
    if image is None:
        raise ValueError("it is damaged")
    return np.asarray(image)


def image_size(data: bytes) -> tuple[int, int]:
    """Return width and height that the header of an image claims; `ValueError` as `decode_image`."""
    width, height = _claimed_size(data)
    if not 0 < width * height <= _MAX_PIXELS + 8 * len(data):
        raise ValueError(f"it claims {width} x {height} pixels in {len(data)} bytes")
    return width, height


def _claimed_size(data: bytes) -> tuple[int, int]:
    if data.startswith(_PNG_START) and len(data) >= 24:
        width, height = struct.unpack_from(">II", data, 16)
        return width, height
    if data.startswith(b"BM") and len(data) >= 26:
        width, height = struct.unpack_from("<ii", data, 18)
        return width, abs(height)
    at = 2
    while data.startswith(b"\xff\xd8") and at + 9 <= len(data) and data[at] == 0xFF:
        if data[at + 1] in _JPEG_SIZES:
            height, width = struct.unpack_from(">HH", data, at + 5)
            return width, height
        at += 1 if data[at + 1] == 0xFF else 2 + struct.unpack_from(">H", data, at + 2)[0]
    raise ValueError("it is no PNG, JPEG or BMP image")


def _checksums_are_right(png: bytes) -> bool:
    at = len(_PNG_START)
    while at + 12 <= len(png):
        (size,) = struct.unpack_from(">I", png, at)
        end = at + 8 + size
        if end + 4 > len(png) or zlib.crc32(memoryview(png)[at + 4 : end]) != struct.unpack_from(">I", png, end)[0]:
            return False
        if png[at + 4 : at + 8] == b"IEND":
            return True
        at = end + 4
    return False
