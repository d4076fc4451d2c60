"""Correspondences between both images, their files (CSV and QGIS ``.points``), and checks before a fit."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from ..errors import CalibrationError
from ..model.arrays import Float64Array
from ..model.files import atomic_path
from ..model.loading import read_file

ProximityImage = Literal["depth", "color"]

REQUIRED_COLUMNS = (
    "id",
    "enabled",
    "proximity_u",
    "proximity_v",
    "tactile_u",
    "tactile_v",
    "tactile_depth_m",
)
OPTIONAL_COLUMNS = ("proximity_image", "snapshot", "proximity_depth_m")

_QGIS_HEADER = ("mapX", "mapY", "sourceX", "sourceY", "enable", "dX", "dY", "residual")
_MAX_PIXEL = 1e7
#: Size limit of a file: 100,000 points.
_MAX_BYTES = 20_000_000
_WORDS = {"1": True, "true": True, "yes": True, "0": False, "false": False, "no": False}
#: Points count as collinear if their spread across the best line is below this share of the spread along it.
_LINE_SHARE = 2e-3


@dataclass(frozen=True)
class Correspondence:
    """One point on the membrane or on a pressed object, clicked in both cameras' images.

    Attributes
    ----------
    id : str
        Name of the pair, unique within a calibration.
    proximity_u, proximity_v : float
        Pixel in the proximity camera's depth or colour image, as ``proximity_image`` says.
    tactile_u, tactile_v : float
        Pixel in the tactile image.
    tactile_depth_m : float or None
        Raw tactile depth at the point, metres. None is usable for a homography only.
    enabled : bool
        Whether the correspondence is used in the fit.
    proximity_image : {"depth", "color"}
        Image that was clicked. Points in colour lie on the membrane, which the proximity depth does not see.
    snapshot : int or None
        Number of the snapshot (inflation level) that was clicked.
    proximity_depth_m : float or None
        Distance measured by the proximity camera at a point of *contact*; only with ``"depth"``. It determines the
        depth scale.
    """

    id: str
    proximity_u: float
    proximity_v: float
    tactile_u: float
    tactile_v: float
    tactile_depth_m: float | None = None
    enabled: bool = True
    proximity_image: ProximityImage = "depth"
    snapshot: int | None = None
    proximity_depth_m: float | None = None

    def __post_init__(self) -> None:
        for name in ("tactile_depth_m", "proximity_depth_m"):
            value = getattr(self, name)
            if value is not None and math.isnan(value):
                object.__setattr__(self, name, None)
        if self.proximity_image not in ("depth", "color"):
            raise CalibrationError(f"pair {self.id}: proximity_image is {self.proximity_image!r}; it is depth or color")
        if self.proximity_depth_m is not None and self.proximity_image == "color":
            raise CalibrationError(
                f"pair {self.id}: proximity_depth_m is {self.proximity_depth_m:g}, but the point was clicked in "
                "colour, where the proximity depth looks through the membrane; leave it empty"
            )

    @property
    def proximity(self) -> tuple[float, float]:
        """The proximity pixel ``(u, v)``."""
        return self.proximity_u, self.proximity_v

    @property
    def tactile(self) -> tuple[float, float]:
        """The tactile pixel ``(u, v)``."""
        return self.tactile_u, self.tactile_v


def enabled_pairs(pairs: Sequence[Correspondence]) -> list[Correspondence]:
    """Return the enabled correspondences."""
    return [pair for pair in pairs if pair.enabled]


def listed(names: Sequence[str], most: int = 5) -> str:
    """Return pairs by name, such as ``"pairs 3, 5 and 6"``; the first ones if they are more than ``most``."""
    if len(names) > most:
        return f"{len(names)} pairs ({', '.join(names[:most])}, ...)"
    return f"pair {names[0]}" if len(names) == 1 else f"pairs {', '.join(names[:-1])} and {names[-1]}"


def pixel_arrays(pairs: Sequence[Correspondence]) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Return proximity pixels (N, 2), tactile pixels (N, 2) and tactile depths (N,), nan if unknown."""
    proximity = np.array([pair.proximity for pair in pairs], dtype=np.float64).reshape(-1, 2)
    tactile = np.array([pair.tactile for pair in pairs], dtype=np.float64).reshape(-1, 2)
    depth = [math.nan if pair.tactile_depth_m is None else pair.tactile_depth_m for pair in pairs]
    return proximity, tactile, np.array(depth, dtype=np.float64)


def read_points(path: Path | str) -> list[Correspondence]:
    """Read correspondences from a CSV file, or from a QGIS file with the suffix ``.points``.

    Raises
    ------
    CalibrationError
        The file cannot be read, has another header or an invalid row; the message names line, field and value.
    """
    path = Path(path)
    try:
        text = read_file(path, _MAX_BYTES).decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = "it is no UTF-8 text" if isinstance(error, UnicodeDecodeError) else error.strerror or error
        raise CalibrationError(f"cannot read the points {path}: {reason}; choose a CSV or .points file") from error
    return parse_qgis(text, str(path)) if path.suffix == ".points" else parse_csv(text, str(path))


def write_points(path: Path | str, pairs: Sequence[Correspondence]) -> None:
    """Write correspondences as CSV, or as QGIS file for the suffix ``.points``; atomically.

    QGIS files hold neither depths nor snapshots nor the clicked image.
    """
    path = Path(path)
    text = qgis_text(pairs) if path.suffix == ".points" else csv_text(pairs)
    with atomic_path(path) as temporary:
        temporary.write_text(text, "utf-8")


def csv_text(pairs: Sequence[Correspondence]) -> str:
    """Return the text of a CSV file; floats are exact. Optional columns are written if any row has a value."""
    extra = [name for name in OPTIONAL_COLUMNS if any(getattr(pair, name) not in (None, "depth") for pair in pairs)]
    columns = [*REQUIRED_COLUMNS, *extra]
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(columns)
    for pair in pairs:
        values = {name: getattr(pair, name) for name in columns} | {"enabled": int(pair.enabled)}
        writer.writerow(["" if value is None else _exact(value) for value in values.values()])
    return file.getvalue()


def parse_csv(text: str, origin: str) -> list[Correspondence]:
    """Read pairs from CSV text; see `read_points`."""
    rows = _rows(text, origin)
    if not rows:
        raise CalibrationError(f"{origin} is empty; its first line should be {','.join(REQUIRED_COLUMNS)}")
    _, header = rows[0]
    header = [name.strip() for name in header]
    missing = [name for name in REQUIRED_COLUMNS if name not in header]
    unknown = [name for name in header if name not in (*REQUIRED_COLUMNS, *OPTIONAL_COLUMNS)]
    if missing or unknown or len(set(header)) < len(header):
        what = f"lacks the column {missing[0]}" if missing else f"has the column {(unknown or header)[0]!r}"
        what = what if missing or unknown else "names a column twice"
        raise CalibrationError(f"{origin}: the header {what}; it should be {','.join(REQUIRED_COLUMNS)}")
    pairs: list[Correspondence] = []
    known: set[str] = set()
    for number, values in rows[1:]:
        where = f"{origin}, line {number}"
        if len(values) != len(header):
            raise CalibrationError(
                f"{where}: there are {len(values)} values for {len(header)} columns; correct the row"
            )
        fields = dict(zip(header, (value.strip() for value in values), strict=True))
        pair = _pair_of(fields, where)
        if pair.id in known:
            raise CalibrationError(f"{where}: id {pair.id!r} is taken by an earlier row; give each pair its own")
        known.add(pair.id)
        pairs.append(pair)
    return pairs


def qgis_text(pairs: Sequence[Correspondence]) -> str:
    """Return the text of a QGIS Georeferencer file: source is tactile, map is proximity, y points up."""
    lines = [",".join(_QGIS_HEADER)]
    for pair in pairs:
        numbers = (pair.proximity_u, -pair.proximity_v, pair.tactile_u, -pair.tactile_v)
        lines.append(",".join([*(_exact(number) for number in numbers), str(int(pair.enabled)), "0", "0", "0"]))
    return "\n".join(lines) + "\n"


def parse_qgis(text: str, origin: str) -> list[Correspondence]:
    """Read pairs from QGIS ``.points`` text; see `read_points`. Ids count from 1, depths are empty."""
    rows = [(number, values) for number, values in _rows(text, origin) if not values[0].startswith("#")]
    if not rows or [name.strip() for name in rows[0][1]][:4] != list(_QGIS_HEADER[:4]):
        raise CalibrationError(f"{origin} is no QGIS points file; its header starts with {','.join(_QGIS_HEADER[:4])}")
    header = [name.strip() for name in rows[0][1]]
    pairs = []
    for count, (number, values) in enumerate(rows[1:], start=1):
        where = f"{origin}, line {number}"
        if len(values) < 4:
            raise CalibrationError(f"{where}: there are {len(values)} values, at least 4 are needed; correct the row")
        fields = dict(zip(header, (value.strip() for value in values), strict=False))
        u, v, tactile_u, tactile_v = (_pixel(fields[name], name, where) for name in _QGIS_HEADER[:4])
        enabled = _flag(fields.get("enable", "1"), "enable", where)
        pairs.append(Correspondence(str(count), u, -v, tactile_u, -tactile_v, enabled=enabled))
    return pairs


def _pair_of(fields: dict[str, str], where: str) -> Correspondence:
    if not fields["id"]:
        raise CalibrationError(f"{where}: id is empty; give each pair a name or a number")
    image = fields.get("proximity_image", "") or "depth"
    if image not in ("depth", "color"):
        raise CalibrationError(f"{where}: proximity_image is {image!r}; write depth or color")
    pixels = {
        name: _pixel(fields[name], name, where) for name in ("proximity_u", "proximity_v", "tactile_u", "tactile_v")
    }
    depth = _depth(fields["tactile_depth_m"], "tactile_depth_m", where)
    enabled = _flag(fields["enabled"], "enabled", where)
    snapshot = _snapshot(fields.get("snapshot", ""), where)
    proximity_depth = _depth(fields.get("proximity_depth_m", ""), "proximity_depth_m", where)
    clicked: ProximityImage = "color" if image == "color" else "depth"
    try:
        return Correspondence(
            fields["id"],
            **pixels,
            tactile_depth_m=depth,
            enabled=enabled,
            proximity_image=clicked,
            snapshot=snapshot,
            proximity_depth_m=proximity_depth,
        )
    except CalibrationError as error:
        raise CalibrationError(f"{where}: {error}") from error


def _rows(text: str, origin: str) -> list[tuple[int, list[str]]]:
    """Return the non-blank rows with their line numbers."""
    reader = csv.reader(io.StringIO(text), strict=True)
    rows = []
    try:
        for values in reader:
            if any(value.strip() for value in values):
                rows.append((reader.line_num, values))  # noqa: PERF401 - line_num moves with the iteration
    except csv.Error as error:
        raise CalibrationError(f"{origin}, line {reader.line_num}: not CSV ({error}); correct the row") from error
    return rows


def _pixel(text: str, name: str, where: str) -> float:
    return _number(text, name, where, (-_MAX_PIXEL, _MAX_PIXEL), "a number of pixels")


def _depth(text: str, name: str, where: str) -> float | None:
    if text.lower() in ("", "nan", "none"):
        return None
    return _number(text, name, where, (0.001, 10.0), "metres, 0.001 to 10, such as 0.295, or leave it empty")


def _number(text: str, name: str, where: str, limits: tuple[float, float], what: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not limits[0] <= value <= limits[1]:
        raise CalibrationError(f"{where}: {name} is {text!r}; write {what}")
    return value


def _flag(text: str, name: str, where: str) -> bool:
    if text.lower() not in _WORDS:
        raise CalibrationError(f"{where}: {name} is {text!r}; write 1 or 0")
    return _WORDS[text.lower()]


def _snapshot(text: str, where: str) -> int | None:
    if not text:
        return None
    if not (text.isascii() and text.isdigit() and len(text) <= 6):
        raise CalibrationError(f"{where}: snapshot is {text!r}; write its number from 0, or leave it empty")
    return int(text)


def _exact(value: object) -> str:
    return repr(float(value)) if isinstance(value, float) else str(value)


def check_pairs(
    tactile: npt.ArrayLike, proximity: npt.ArrayLike, least: int, name: str
) -> tuple[Float64Array, Float64Array]:
    """Return both sides as float64 after checking that they can determine a model.

    Raises
    ------
    CalibrationError
        Shapes differ, values are not finite, there are too few different pairs, or all points are collinear.
    """
    tactile, proximity = (np.array(side, dtype=np.float64, ndmin=2) for side in (tactile, proximity))
    if tactile.shape != proximity.shape or tactile.shape[1] != 2:
        raise CalibrationError(
            f"pairs are two lists of (u, v) of the same length, these have shapes {tactile.shape} and {proximity.shape}"
        )
    _check_count(len(tactile), least, name)
    for side, points in (("tactile", tactile), ("proximity", proximity)):
        if not np.isfinite(points).all():
            row = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
            raise CalibrationError(f"pair {row + 1}: the {side} point is {tuple(points[row])}; give finite numbers")
    _check_different(np.column_stack([tactile, proximity]), least, name)
    for side, points in (("tactile", tactile), ("proximity", proximity)):
        if on_a_line(points):
            raise CalibrationError(
                f"the {side} points lie on one line, which determines no {name}; add points to both sides of the line"
            )
    return tactile, proximity


def check_space(places: Float64Array, proximity: Float64Array, least: int, name: str) -> None:
    """Check that places (tactile u, v, depth; N, 3) and proximity pixels (N, 2) can determine a pose.

    Raises
    ------
    CalibrationError
        There are too few different pairs, a value is not finite, or a depth is not positive.
    """
    _check_count(len(places), least, name, "pairs with a tactile depth")
    for side, values in (("tactile place and depth", places), ("proximity point", proximity)):
        if not np.isfinite(values).all():
            row = int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0])
            raise CalibrationError(f"pair {row + 1}: the {side} is {values[row].tolist()}; give finite numbers")
    if (places[:, 2] <= 0).any():
        row = int(np.flatnonzero(places[:, 2] <= 0)[0])
        raise CalibrationError(f"pair {row + 1}: the tactile depth is {places[row, 2]:g} m; it must be above 0")
    _check_different(np.column_stack([places, proximity]), least, name)


def _check_count(count: int, least: int, name: str, what: str = "pairs of points") -> None:
    if count < least:
        raise CalibrationError(
            f"a {name} needs at least {least} {what}, there are {count}; add {least - count} more, "
            f"or better {least + 2 - count}"
        )


def _check_different(rows: Float64Array, least: int, name: str) -> None:
    different = len(np.unique(rows, axis=0))
    if different < least:
        raise CalibrationError(
            f"only {different} of the {len(rows)} pairs differ from each other, a {name} needs {least}; "
            "delete the repeated ones and add points elsewhere"
        )


def on_a_line(points: Float64Array) -> bool:
    """Tell whether points (N, 2 or 3) are collinear."""
    values = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(values[1] <= _LINE_SHARE * values[0])


def spread(points: Float64Array) -> tuple[float, float]:
    """Return the diagonal and the area of the points' bounding box, widened by a tenth."""
    low, high = np.percentile(points, [0, 100], axis=0)
    sides = 1.1 * np.maximum(high - low, 1e-12)
    diagonal = float(np.hypot(*sides))
    return diagonal, float(max(sides[0] * sides[1], 0.1 * diagonal**2))
