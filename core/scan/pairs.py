"""Picked pairs of points on a scan and on a patch, as a CSV file."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Final

import numpy as np

from ..errors import SourceError
from ..model.arrays import Float64Array
from ..model.files import user_path

HEADER: Final = ("scan_x", "scan_y", "scan_z", "patch_x_m", "patch_y_m", "patch_z_m")
_FILE_BYTES: Final = 10_000_000


def read_pairs(path: Path | str, unit_m: float = 1.0) -> tuple[Float64Array, Float64Array]:
    """Read pairs for `pose_from_pairs`.

    Parameters
    ----------
    path : path
        A header ``scan_x,scan_y,scan_z,patch_x_m,patch_y_m,patch_z_m`` and a line for each pair: a place in the
        scan's frame and unit, as a mesh program shows it, and the same one in the proximity depth frame in metres.
    unit_m : float
        Length of the scan's unit in metres.

    Returns
    -------
    scan_points, patch_points : float64, each shape (N, 3)
        Metres.

    Raises
    ------
    SourceError
        No such file, another header, or something that is no finite number.
    """
    path = user_path(path)
    try:
        with path.open("rb") as file:
            text = file.read(_FILE_BYTES).decode("utf-8-sig")
        lines = csv.reader(text.splitlines())
        rows = [(lines.line_num, row) for row in lines if any(word.strip() for word in row)]
    except OSError as error:
        raise SourceError(f"cannot read {path}: {error.strerror or error}; check the path") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise SourceError(f"{path} is no CSV file; write the pairs as text") from error
    if not rows or tuple(word.strip() for word in rows[0][1]) != HEADER:
        raise SourceError(f"{path} has not the header {','.join(HEADER)}; put it into the first line")
    for number, row in rows[1:]:
        if len(row) != len(HEADER) or not all(map(_finite, row)):
            raise SourceError(f"{path}, line {number}: {','.join(row)[:80]!r} is no pair; give six finite numbers")
    table = np.array([row for _, row in rows[1:]], np.float64).reshape(-1, len(HEADER))
    return table[:, :3] * unit_m, table[:, 3:]


def _finite(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False
