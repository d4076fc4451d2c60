"""Clouds of any program: what `core.export` reads, and PLY and PCD written as text."""

from __future__ import annotations

import io
import math
import re
import warnings
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from ..errors import SourceError
from ..export import read_cloud
from ..paths import refuse_devices

Float64Array = npt.NDArray[np.float64]

#: A header is shorter; more is not searched for its end.
_HEADER_BYTES: Final = 100_000
_ENDS: Final = {".ply": rb"^end_header\s*?\n", ".pcd": rb"^DATA ascii\s*?\n"}


def read_points(path: Path | str) -> Float64Array:
    """Read the points of a cloud file.

    Parameters
    ----------
    path : path
        ``.ply`` and ``.pcd``, binary or text, ``.npz``, ``.csv``.

    Returns
    -------
    float64, shape (N, 3)
        In the file's unit; points with a nan are left out, since they are how PCD says *no point*.

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
    return points[~np.isnan(points).any(axis=1)]


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
    return _columns(rows, names, int(words[elements[0]][2]))


def _pcd_points(header: list[str], rows: bytes) -> Float64Array:
    facts = {line.split()[0]: line.split()[1:] for line in header if line.strip()}
    counts = [int(count) for count in facts.get("COUNT", ["1"] * len(facts["FIELDS"]))]
    names = [name for name, count in zip(facts["FIELDS"], counts, strict=True) for _ in range(count)]
    return _columns(rows, names, int(facts["POINTS"][0]))


def _columns(rows: bytes, names: list[str], count: int) -> Float64Array:
    """Read ``count`` rows of text and take x, y and z of them."""
    if missing := [name for name in ("x", "y", "z") if name not in names]:
        raise ValueError(f"it has no {missing[0]}")
    if not 0 <= count <= len(rows):
        raise ValueError(f"it claims {count} points in {len(rows)} bytes")
    if count == 0:
        return np.empty((0, 3))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # an empty body is told below
        places = [names.index(name) for name in ("x", "y", "z")]
        table = np.loadtxt(io.StringIO(rows.decode("ascii")), max_rows=count, usecols=places, ndmin=2)
    if len(table) != count:
        raise ValueError(f"it ends after {len(table)} of {count} points")
    return np.asarray(table, np.float64)


def unit_doubt(points: Float64Array, path: Path) -> str:
    """Return a sentence if a cloud can hardly be in metres, else nothing."""
    if len(points) == 0:
        return ""
    size = math.dist(points.min(axis=0), points.max(axis=0))
    if size > 5.0:
        return f"{path} is {size:.0f} m across if its unit is metres; if it is millimetres, divide by 1000 first"
    return ""
