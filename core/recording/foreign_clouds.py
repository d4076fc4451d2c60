"""Clouds of any program: what `core.export` reads, and PLY and PCD written as text."""

from __future__ import annotations

import io
import math
import re
import warnings
from pathlib import Path
from typing import Final

import numpy as np

from ..errors import SourceError
from ..model.arrays import Float64Array
from ..model.files import refuse_devices
from .cloud_files import pcd_header, read_cloud, whole_number

#: A header is shorter; more is not searched for its end.
_HEADER_BYTES: Final = 100_000
_ENDS: Final = {".ply": rb"^end_header\s*?\n", ".pcd": rb"^DATA ascii\s*?\n"}


def read_points(path: Path | str) -> tuple[Float64Array, int]:
    """Read the points of a cloud file.

    Parameters
    ----------
    path : path
        ``.ply`` and ``.pcd``, binary or text, ``.npz``, ``.csv``.

    Returns
    -------
    points : float64, shape (N, 3)
        In the file's unit; those with a nan are left out, since they are how PCD says *no point*.
    dropped : int
        How many were.

    Raises
    ------
    SourceError
        No such file, or none that can be read, or a coordinate is infinite.
    """
    path = Path(path)
    refuse_devices(path, SourceError)
    header, rows = _text_of(path)
    if header is None:
        points = read_cloud(path).points.astype(np.float64)
    else:
        try:
            points = _ply_points(header, rows) if path.suffix.lower() == ".ply" else _pcd_points(header, rows)
        except (ValueError, KeyError, IndexError, UnicodeDecodeError) as error:
            detail = " ".join(str(error).split())
            raise SourceError(f"{path} is no readable {path.suffix} cloud ({detail}); export it again") from error
    if np.isinf(points).any():
        raise SourceError(f"{path} holds an infinite coordinate; export it again")
    known = ~np.isnan(points).any(axis=1)
    return points[known], int(np.count_nonzero(~known))


def _text_of(path: Path) -> tuple[list[str] | None, bytes]:
    """Return the header's lines and the rest of a PLY or PCD written as text, else None."""
    end = _ENDS.get(path.suffix.lower())
    if end is None:
        return None, b""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise SourceError(f"cannot read {path}: {error.strerror or error}; check the path") from error
    match = re.search(end, data[:_HEADER_BYTES], re.MULTILINE)
    if match is None:
        return None, b""
    header = data[: match.start()].decode("ascii", "replace").splitlines()
    if path.suffix.lower() == ".ply" and "format ascii 1.0" not in [line.strip() for line in header]:
        return None, b""
    return header, data[match.end() :]


def _ply_points(header: list[str], rows: bytes) -> Float64Array:
    words = [line.split() for line in header]
    elements = [index for index, line in enumerate(words) if line[:1] == ["element"]]
    if words[:1] != [["ply"]] or not elements or words[elements[0]][1:2] != ["vertex"]:
        raise ValueError("its first element is not vertex")
    last = elements[1] if len(elements) > 1 else None
    names = [line[-1] for line in words[elements[0] : last] if line[:1] == ["property"]]
    return _columns(rows, names, whole_number(words[elements[0]][2:], "points"), len(header) + 2)


def _pcd_points(header: list[str], rows: bytes) -> Float64Array:
    facts = pcd_header(header, ("FIELDS", "POINTS"))
    counts = [whole_number([count], "values a field") for count in facts.get("COUNT", ["1"] * len(facts["FIELDS"]))]
    if len(counts) != len(facts["FIELDS"]):
        raise ValueError(f"it has {len(facts['FIELDS'])} fields and {len(counts)} counts")
    names = [name for name, count in zip(facts["FIELDS"], counts, strict=True) for _ in range(count)]
    return _columns(rows, names, whole_number(facts["POINTS"], "points"), len(header) + 2)


def _columns(rows: bytes, names: list[str], count: int, first_line: int) -> Float64Array:
    """Read ``count`` rows of text, which begin at a line of the file, and take x, y and z of them."""
    if missing := [name for name in ("x", "y", "z") if name not in names]:
        raise ValueError(f"it has no {missing[0]}")
    if not 0 <= count <= len(rows):
        raise ValueError(f"it claims {count} points in {len(rows)} bytes")
    if count == 0:
        return np.empty((0, 3))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # an empty body is told below
        places = [names.index(name) for name in ("x", "y", "z")]
        try:
            table = np.loadtxt(io.StringIO(rows.decode("ascii")), max_rows=count, usecols=places, ndmin=2)
        except ValueError as error:
            raise ValueError(_bad_line(rows, places, first_line)) from error
    if len(table) != count:
        raise ValueError(f"it ends after {len(table)} of {count} points")
    return np.asarray(table, np.float64)


def _bad_line(rows: bytes, places: list[int], first_line: int) -> str:
    """Say which line of text holds no point."""
    for number, line in enumerate(rows.decode("ascii", "replace").splitlines(), first_line):
        words = line.split()
        try:
            [float(words[place]) for place in places if words]
        except (ValueError, IndexError):
            return f"line {number} is {line[:80]!r}, not numbers with x, y and z"
    return "its points cannot be read"


def unit_doubt(points: Float64Array, path: Path) -> str:
    """Return a sentence if a cloud of at least one point can hardly be in metres, else nothing."""
    size = math.dist(points.min(axis=0), points.max(axis=0))
    if size > 5.0:
        return f"{path} is {size:.0f} m across if its unit is metres; if it is millimetres, divide by 1000 first"
    return ""
