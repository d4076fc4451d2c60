"""Point pairs on disk as CSV, and as arrays for the fits."""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from ..errors import CalibrationError, foreign
from ..model.alignment import PointPair
from ..model.arrays import BoolArray, Float64Array
from ..model.files import atomic_path
from ..model.loading import read_file
from ..model.rig_file import validating

_PLACES = ("proximity_u", "proximity_v", "tactile_u", "tactile_v")
_COLUMNS = ("id", "enabled", *_PLACES, "tactile_depth_m")
_OPTIONAL = ("proximity_image", "snapshot", "origin")
#: A column of older files that no fit uses any more.
_IGNORED = "proximity_depth_m"
#: Size limit of a file: 100,000 points.
_MAX_BYTES = 20_000_000
#: Points count as collinear if their spread across the best line is below this share of the spread along it.
_LINE_SHARE = 2e-3


def read_points(path: Path | str) -> list[PointPair]:
    """Read clicked pairs of points from a CSV file.

    Parameters
    ----------
    path : Path or str
        A file as the calibration wizard or any spreadsheet writes it. Its first line names the columns:
        ``proximity_u, proximity_v, tactile_u, tactile_v`` (pixels, column and row, pixel centres at integers).
        Optional: ``id`` (else the row's number), ``enabled``, ``tactile_depth_m`` (raw tactile depth, metres; empty if
        unknown), ``proximity_image`` (``depth`` or ``color``: the image in which the proximity side was clicked),
        ``snapshot`` (number of the inflation level, from 0) and ``origin``.

    Returns
    -------
    list of PointPair
        In the order of the rows.

    Raises
    ------
    CalibrationError
        The file cannot be read, has another header or an invalid row; the message names line, column and value.
    """
    header, rows = read_table(path, "points", texts=("id", "origin", "proximity_image"))
    missing = [name for name in _PLACES if name not in header]
    unknown = [name for name in header if name not in (*_COLUMNS, *_OPTIONAL, _IGNORED)]
    twice = [name for name in header if header.count(name) > 1]
    if twice:
        raise CalibrationError(f"{path}: the header has the column {foreign(twice[0], 40)!r} twice; remove one")
    if missing or unknown:
        what = f"lacks the column {missing[0]}" if missing else f"has the column {foreign(unknown[0], 40)!r}"
        raise CalibrationError(f"{path}: the header {what}; it should be {','.join(_COLUMNS)}")
    pairs: dict[str, PointPair] = {}
    for number, (line, row) in enumerate(rows, 1):
        where = f"{path}, line {line}"
        if len(row) != len(header):
            raise CalibrationError(f"{where}: there are not {len(header)} values as in the header; correct the row")
        fields = dict(zip(header, row, strict=True))
        pair = _pair({"id": str(number), "enabled": "1"} | fields, where)
        if pair.id in pairs:
            raise CalibrationError(f"{where}: id {foreign(pair.id, 40)!r} is taken by an earlier row; give another")
        pairs[pair.id] = pair
    return list(pairs.values())


def _pair(fields: dict[str, str], where: str) -> PointPair:
    fields = {name: value for name, value in fields.items() if value.lower() not in ("", "nan", "none")}
    for name in _COLUMNS[:-1]:  # a tactile depth may be missing
        if name not in fields:
            raise CalibrationError(f"{where}: {name} has no value; give one")
    with validating(where, "a pair", CalibrationError):
        return PointPair.model_validate(fields)


def write_points(path: Path | str, pairs: Sequence[PointPair]) -> None:
    """Write complete pairs as CSV, atomically; floats are exact. Optional columns appear if any row has a value."""
    extra = [name for name in _OPTIONAL if any(getattr(pair, name) not in (None, "", "depth") for pair in pairs)]
    file = io.StringIO()
    writer = csv.DictWriter(file, [*_COLUMNS, *extra], extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows(pair.model_dump() | {"enabled": int(pair.enabled)} for pair in pairs)
    with atomic_path(Path(path)) as temporary:
        temporary.write_text(file.getvalue(), "utf-8")


@dataclass(frozen=True, eq=False)
class PointArrays:
    """Complete pairs as arrays: pixels (N, 2), depths (N,) in metres, nan if unknown."""

    tactile: Float64Array
    tactile_depth_m: Float64Array
    proximity: Float64Array
    in_color: BoolArray

    @staticmethod
    def of(pairs: Sequence[PointPair]) -> PointArrays:

        def column(*names: str) -> Float64Array:
            rows = [[getattr(pair, name) for name in names] for pair in pairs]
            return np.array(rows, np.float64).reshape(len(pairs), len(names))

        return PointArrays(
            column("tactile_u", "tactile_v"),
            column("tactile_depth_m").ravel(),
            column("proximity_u", "proximity_v"),
            np.array([pair.proximity_image == "color" for pair in pairs], bool),
        )

    def __len__(self) -> int:
        return len(self.tactile)

    @property
    def places(self) -> Float64Array:
        """Tactile pixel and raw depth, shape (N, 3)."""
        return np.column_stack([self.tactile, self.tactile_depth_m])

    def keep(self, which: BoolArray) -> PointArrays:
        """Return the points selected by a boolean mask."""
        return PointArrays(**{name: values[which] for name, values in vars(self).items()})


def listed(names: Sequence[str]) -> str:
    """Return pairs by name, such as ``"pairs 3, 5 and 6"``; the first ones if they are more than eight."""
    if len(names) > 8:
        return f"{len(names)} pairs ({', '.join(names[:8])}, ...)"
    return f"pair {names[0]}" if len(names) == 1 else f"pairs {', '.join(names[:-1])} and {names[-1]}"


def check_points(points: PointArrays, least: int, name: str, **sides: Float64Array) -> None:
    """Raise `CalibrationError` if there are too few pairs, or if the points (N, 2 or 3) of a side are collinear."""
    if len(points) < least:
        raise CalibrationError(f"a {name} needs at least {least} pairs, there are {len(points)}; add points elsewhere")
    for side, places in sides.items():
        along, across = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)[:2]
        if across <= _LINE_SHARE * along:
            raise CalibrationError(f"the {side} points lie on one line and determine no {name}; add points beside it")


_SEPARATORS: Final = (";", "\t", ",")
_DECIMAL_COMMA: Final = re.compile(r"[-+]?\d*,\d+(?:[eE][-+]?\d+)?")


def read_table(
    path: Path | str, what: str, texts: Collection[str] = ()
) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Read a CSV file as `parse_table`; `CalibrationError` names the file, what it should hold, and the line."""
    try:
        return parse_table(read_file(Path(path), _MAX_BYTES), texts)
    except UnicodeDecodeError as error:
        raise CalibrationError(f"cannot read the {what} {path}: it is no text; choose a CSV file") from error
    except OSError as error:
        raise CalibrationError(f"cannot read the {what} {path}: {error.strerror or error}; choose another") from error
    except ValueError as error:
        raise CalibrationError(f"{path}, {error}; correct the row") from error


def parse_table(data: bytes, texts: Collection[str] = ()) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Return the columns' lower-case names, and each row with its line; decimal commas if no number has a point."""
    text = _decoded(data)
    first = next((line for line in text.splitlines() if line.strip()), "")
    if stated := re.fullmatch(r"\"?sep=(.)\"?\s*", first):  # Excel's own first line
        text, separator = text.replace(first, "", 1), stated[1]
    else:
        separator = max(_SEPARATORS, key=first.count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True, skipinitialspace=True)
    rows: list[tuple[int, list[str]]] = []
    try:
        rows.extend((reader.line_num, [cell.strip() for cell in row]) for row in reader if any(map(str.strip, row)))
    except csv.Error as error:
        raise ValueError(f"line {reader.line_num}: not CSV ({error})") from error
    header = [name.lower() for name in rows[0][1]] if rows else []
    while header and not header[-1]:
        header.pop()
    body = rows[1:]
    for _, row in body:
        while len(row) > len(header) and not row[-1]:
            row.pop()
    numbers = [index for index, name in enumerate(header) if name not in texts]
    if any("." in row[index] for _, row in body for index in numbers if index < len(row)):
        return header, body
    for _, row in body:
        for index in numbers:
            if index < len(row) and _DECIMAL_COMMA.fullmatch(row[index]):
                row[index] = row[index].replace(",", ".")
    return header, body


def _decoded(data: bytes) -> str:
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252")  # what Excel calls CSV
