"""Point clouds as files: writing PLY, PCD, NPZ and CSV, and reading the points of these, also of other programs.

PLY and PCD are written here, binary and little-endian, rather than by a library: a frame without
contact is an empty cloud, which Open3D refuses to write, and a robot needs neither Open3D nor PCL.
"""

from __future__ import annotations

import io
import math
import re
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from ..contact.masking import colors_at
from ..contact.pipeline import ContactPatch
from ..errors import ExportError, SourceError
from ..model.arrays import AnyArray, Float64Array
from ..model.clouds import PointCloud
from ..model.files import atomic_path
from ..model.frames import Rig, SensorFrame
from ..model.loading import parse_npz, read_file

#: Every column of a cloud by name, in the order of the file.
Columns = dict[str, AnyArray]

_XYZ = ("x", "y", "z")
_RGB = ("red", "green", "blue")
_CSV_XYZ = ("x_m", "y_m", "z_m")
_RESERVED = {*_XYZ, *_RGB, *_CSV_XYZ, "rgb", "points", "colors", "file", "allow_pickle"}
_NAME = re.compile(r"[A-Za-z]\w*", re.ASCII)

#: Both names that PLY has for each type. The first is written: Open3D skips "ushort" but knows "uint16".
_PLY_TYPES = {
    "char": "<i1", "uchar": "<u1", "short": "<i2", "uint16": "<u2", "int": "<i4", "uint": "<u4", "float": "<f4",
    "double": "<f8", "int8": "<i1", "uint8": "<u1", "int16": "<i2", "ushort": "<u2", "int32": "<i4", "uint32": "<u4",
    "float32": "<f4", "float64": "<f8",
}  # fmt: skip
_PCD_TYPES = ("F4", "F8", "I1", "I2", "I4", "I8", "U1", "U2", "U4", "U8")
_PLY_NAMES = {np.dtype(code): name for name, code in reversed(_PLY_TYPES.items())}
_CSV_FORMATS = {"f4": "%.9g", "f8": "%.17g"}
#: A header is shorter; more is not searched for its end.
_HEADER_BYTES: Final = 100_000


def patch_cloud(patch: ContactPatch, frame: SensorFrame, rig: Rig) -> PointCloud:
    """Return a patch's points with their colours and attributes.

    Parameters
    ----------
    patch : ContactPatch
    frame : SensorFrame
        The frame that the patch was found in.
    rig : Rig

    Returns
    -------
    PointCloud
        Colours of the proximity colour image, black where its camera does not see the point, and the
        attributes ``relative_difference`` (float32) and ``u``, ``v`` (uint16, proximity pixels). The difference is
        that of the pixel's own two depths: nan where one is missing, and large on a flying pixel, where the
        membrane test takes contact and the point from the pixels around it.
    """
    pixels = np.flatnonzero(patch.mask)
    colors, _ = colors_at(patch.points, pixels, frame.proximity_color, rig)
    v, u = np.divmod(pixels, patch.mask.shape[1])
    attributes: dict[str, npt.NDArray[np.generic]] = {
        "relative_difference": patch.relative_difference.ravel()[pixels],
        "u": u.astype(np.uint16),
        "v": v.astype(np.uint16),
    }
    return PointCloud(patch.points, colors, attributes)


def write_cloud(path: Path | str, cloud: PointCloud) -> None:
    """Write a cloud in the format of the path's suffix; the file appears whole or not at all.

    ``.npz``, ``.ply`` and ``.pcd`` keep every bit of points, colours and attributes (8 to 32 bit
    integers and floats; bool becomes uint8). ``.csv`` has a header ``x_m,y_m,z_m,red,green,blue,…``
    and digits enough to give the same numbers back.

    Raises
    ------
    ExportError
        Unknown suffix, an attribute that the format cannot hold, or a place that cannot be written.
    """
    path = Path(path)
    write, _ = _format(path, ExportError)
    columns = _columns(path, cloud)
    with atomic_path(path) as temporary:
        write(temporary, columns)


def read_points(path: Path | str) -> tuple[Float64Array, int]:
    """Read the points of a cloud file.

    Parameters
    ----------
    path : path
        ``.ply`` and ``.pcd``, binary or text, ``.npz``, ``.csv``.

    Returns
    -------
    points : float64, shape (N, 3)
        In the file's unit, without points that have a nan: PCD marks missing points so.
    dropped : int
        Number of points with a nan.

    Raises
    ------
    SourceError
        No such file, or none that can be read, or a coordinate is infinite.
    """
    path = Path(path)
    _, read = _format(path, SourceError)
    try:
        points = read(read_file(path))
    except OSError as error:
        raise SourceError(f"cannot read {path}: {error.strerror or error}; check the path") from error
    except (ValueError, KeyError, IndexError, TypeError, struct.error) as error:
        detail = " ".join(str(error).split())
        raise SourceError(f"{path} is no readable {path.suffix} cloud ({detail}); export it again") from error
    if np.isinf(points).any():
        raise SourceError(f"{path} holds an infinite coordinate; export it again")
    known = ~np.isnan(points).any(axis=1)
    return points[known], int(np.count_nonzero(~known))


def _format(path: Path, error: type[Exception]) -> _Format:
    suffix = path.suffix.lower()
    if suffix not in _FORMATS:
        raise error(f"{path} has the suffix {suffix!r}; clouds are {', '.join(_FORMATS)}")
    return _FORMATS[suffix]


def _columns(path: Path, cloud: PointCloud) -> Columns:
    """Return the columns of a cloud, checked."""
    columns: Columns = dict(zip(_XYZ, np.asarray(cloud.points, np.float32).T, strict=True))
    if cloud.colors is not None:
        columns |= zip(_RGB, np.asarray(cloud.colors, np.uint8).T, strict=True)
    for name, values in cloud.attributes.items():
        if name in _RESERVED or not _NAME.fullmatch(name):
            raise ExportError(f"cannot write {path}: an attribute cannot be called {name!r}; use another name")
        columns[name] = values.astype(np.uint8) if values.dtype == np.bool_ else values
    for name, values in columns.items():
        if values.shape != (len(cloud),):
            raise ExportError(
                f"cannot write {path}: {name} has the shape {values.shape}, but there are {len(cloud)} points"
            )
    return columns


def _records(path: Path, columns: Columns) -> npt.NDArray[np.void]:
    """Return one packed little-endian record for each point."""
    for name, values in columns.items():
        if values.dtype.newbyteorder("<") not in _PLY_NAMES:
            raise ExportError(
                f"cannot write {path}: {path.suffix} holds no {values.dtype} such as {name}; "
                "convert it to 32 bits or choose .npz"
            )
    records = np.empty(len(columns["x"]), [(name, values.dtype.newbyteorder("<")) for name, values in columns.items()])
    for name, values in columns.items():
        records[name] = values
    return records


def _write_ply(path: Path, columns: Columns) -> None:
    records = _records(path, columns)
    properties = [f"property {_PLY_NAMES[records.dtype[name]]} {name}" for name in columns]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(records)}", *properties, "end_header"]
    path.write_bytes("\n".join(header).encode("ascii") + b"\n" + records.tobytes())


def _read_ply(data: bytes) -> Float64Array:
    header, body = _split(data, b"end_header")
    if header[:1] != [["ply"]]:
        raise ValueError("it does not begin with the line ply")
    elements = [index for index, words in enumerate(header) if words[:1] == ["element"]]
    if not elements or header[elements[0]][1:2] != ["vertex"]:
        raise ValueError("its first element is not vertex")
    lines = header[elements[0] + 1 : elements[1] if len(elements) > 1 else None]
    properties = [words[1:] for words in lines if words[:1] == ["property"]]
    count = _whole_number(header[elements[0]][2:], "points")
    if strange := [words for words in properties if len(words) != 2 or words[0] not in _PLY_TYPES]:
        raise ValueError(f"its vertices have the property {' '.join(strange[0])!r}, which is of no known type")
    if ["format", "ascii", "1.0"] in header:
        return _text_points(body, [name for _, name in properties], count, len(header) + 1)
    if ["format", "binary_little_endian", "1.0"] not in header:
        raise ValueError("it is neither ascii nor binary_little_endian")
    return _unpack(body, np.dtype([(name, _PLY_TYPES[kind]) for kind, name in properties]), count)


def _write_pcd(path: Path, columns: Columns) -> None:
    if set(_RGB) <= columns.keys():
        red, green, blue = (columns[name].astype(np.uint32) for name in _RGB)
        rest = {name: values for name, values in columns.items() if name not in _XYZ + _RGB}
        columns = {name: columns[name] for name in _XYZ} | {"rgb": red << 16 | green << 8 | blue} | rest
    records = _records(path, columns)
    kinds = [records.dtype[name] for name in columns]
    types = ["F" if name == "rgb" else kind.kind.upper() for name, kind in zip(columns, kinds, strict=True)]
    header = [
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        f"FIELDS {' '.join(columns)}",
        f"SIZE {' '.join(str(kind.itemsize) for kind in kinds)}",
        f"TYPE {' '.join(types)}",
        f"COUNT {' '.join('1' for _ in kinds)}",
        f"WIDTH {len(records)}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {len(records)}",
        "DATA binary",
    ]
    path.write_bytes("\n".join(header).encode("ascii") + b"\n" + records.tobytes())


def _read_pcd(data: bytes) -> Float64Array:
    lines, body = _split(data, b"DATA ascii", b"DATA binary")
    header = {words[0]: words[1:] for words in lines if words}
    is_text = header["DATA"] == ["ascii"]
    needed = ("FIELDS", "POINTS") if is_text else ("FIELDS", "POINTS", "SIZE", "TYPE")
    if missing := [name for name in needed if name not in header]:
        raise ValueError(f"its header has no line {missing[0]}")
    fields, points = header["FIELDS"], _whole_number(header["POINTS"], "points")
    counts = [_whole_number([count], "values a field") for count in header.get("COUNT", ["1"] * len(fields))]
    if len(counts) != len(fields):
        raise ValueError(f"it has {len(fields)} fields and {len(counts)} counts")
    if sum(counts) > len(data):
        raise ValueError(f"it claims {sum(counts)} values a point in {len(data)} bytes")
    if is_text:
        names = [name for name, count in zip(fields, counts, strict=True) for _ in range(count)]
        return _text_points(body, names, points, len(lines) + 1)
    if not len(fields) == len(header["TYPE"]) == len(header["SIZE"]):
        raise ValueError("its lines FIELDS, TYPE and SIZE are of different lengths")
    kinds = [f"{kind}{size}" for kind, size in zip(header["TYPE"], header["SIZE"], strict=True)]
    if strange := [kind for kind in kinds if kind not in _PCD_TYPES]:
        raise ValueError(f"it has a field of the type {strange[0]}, which is not known")
    if set(counts) != {1}:
        raise ValueError(f"its fields have the counts {' '.join(header['COUNT'])}, only 1 is known in binary")
    return _unpack(
        body, np.dtype([(name, f"<{kind.lower()}") for name, kind in zip(fields, kinds, strict=True)]), points
    )


def _whole_number(words: Sequence[str], what: str) -> int:
    """Return the first word of a header as a whole number.

    Raises
    ------
    ValueError
        It is none.
    """
    if not words or not re.fullmatch(r"[0-9]{1,18}", words[0]):
        raise ValueError(f"its number of {what} is {' '.join(words)!r}")
    return int(words[0])


def _split(data: bytes, *last_lines: bytes) -> tuple[list[list[str]], bytes]:
    """Return the words of each line of a header, which ends with one of these lines, and what follows it."""
    match = re.search(rb"^(?:" + b"|".join(last_lines) + rb")[ \t]*\r?\n", data[:_HEADER_BYTES], re.MULTILINE)
    if match is None:
        raise ValueError(f"it has no line {b' or '.join(last_lines).decode()}")
    header = data[: match.end()].decode("ascii", "replace")
    return [line.split() for line in header.splitlines()], data[match.end() :]


def _unpack(body: bytes, layout: np.dtype[Any], count: int) -> Float64Array:
    """Return x, y and z of ``count`` binary records."""
    _places(layout.names or ())
    if len(body) < count * layout.itemsize:
        raise ValueError(f"it ends after {len(body) // layout.itemsize} of {count} points")
    records = np.frombuffer(body, layout, count)
    return np.column_stack([records[name] for name in _XYZ]).astype(np.float64)


def _text_points(
    rows: bytes, names: Sequence[str], count: int | None, first_line: int, separator: str | None = None
) -> Float64Array:
    """Return x, y and z of ``count`` rows of text, or all; ``first_line`` is their line number in the file."""
    columns = _places(names)
    if count is not None and not 0 <= count <= len(rows):
        raise ValueError(f"it claims {count} points in {len(rows)} bytes")
    text = rows.decode("ascii", "replace")
    if count == 0 or not text.strip():
        table = np.empty((0, 3))
    else:
        try:
            used = columns if separator is None else None  # a row of CSV has all its columns, and no more
            table = np.loadtxt(
                io.StringIO(text), delimiter=separator, comments=None, max_rows=count, usecols=used, ndmin=2
            )
            if separator is not None and table.shape[1] != len(names):
                raise ValueError
        except ValueError as error:
            raise ValueError(_bad_line(text, names, first_line, separator)) from error
    if count is not None and len(table) != count:
        raise ValueError(f"it ends after {len(table)} of {count} points")
    return np.asarray(table[:, :3], np.float64)


def _places(names: Sequence[str]) -> list[int]:
    """Return where x, y and z stand among the names of a file's columns."""
    if missing := [name for name in _XYZ if name not in names]:
        raise ValueError(f"it has no {missing[0]}")
    return [list(names).index(name) for name in _XYZ]


def _bad_line(text: str, names: Sequence[str], first_line: int, separator: str | None) -> str:
    """Return a clause that names the line without a point."""
    columns, what = _places(names), "numbers with x, y and z"
    if separator is not None:
        columns, what = list(range(len(names))), f"numbers of the {len(names)} columns in its header"
    for number, line in enumerate(text.splitlines(), first_line):
        words = line.split(separator) if line.strip() else []
        try:
            good = len([float(words[column]) for column in columns if words]) == len(words) or separator is None
        except (ValueError, IndexError):
            good = False
        if not good:
            return f"line {number} is {line[:80]!r}, not {what}"
    return "its points cannot be read"


def _write_npz(path: Path, columns: Columns) -> None:
    arrays = {name: values for name, values in columns.items() if name not in _XYZ + _RGB}
    arrays["points"] = np.stack([columns[name] for name in _XYZ], axis=1)
    if set(_RGB) <= columns.keys():
        arrays["colors"] = np.stack([columns[name] for name in _RGB], axis=1)
    with path.open("wb") as file:  # given a name, NumPy would add .npz to .NPZ
        np.savez(file, allow_pickle=False, **arrays)


def _read_npz(data: bytes) -> Float64Array:
    points = parse_npz(data).get("points")
    if points is None:
        raise ValueError("it has no array points")
    if points.ndim != 2 or points.shape[1] != len(_XYZ) or points.dtype.kind not in "fiu":
        raise ValueError(f"its points are {points.dtype} of the shape {points.shape}, not numbers of the shape (N, 3)")
    return points.astype(np.float64)


def _write_csv(path: Path, columns: Columns) -> None:
    formats = [_CSV_FORMATS.get(values.dtype.str[1:], "%d") for values in columns.values()]
    table = np.empty(len(columns["x"]), [(name, values.dtype) for name, values in columns.items()])
    for name, values in columns.items():
        table[name] = values
    titles = [f"{name}_m" if name in _XYZ else name for name in columns]
    np.savetxt(path, table, fmt=formats, delimiter=",", header=",".join(titles), comments="")


def _read_csv(data: bytes) -> Float64Array:
    titles, _, rows = data.removeprefix(b"\xef\xbb\xbf").partition(b"\n")
    names = titles.decode("ascii", "replace").strip().split(",")
    if tuple(names[:3]) != _CSV_XYZ:
        raise ValueError(f"its header does not begin with {','.join(_CSV_XYZ)}")
    return _text_points(rows, [*_XYZ, *names[3:]], None, 2, ",")


_Format = tuple[Callable[[Path, Columns], None], Callable[[bytes], Float64Array]]
_FORMATS: dict[str, _Format] = {
    ".ply": (_write_ply, _read_ply),
    ".pcd": (_write_pcd, _read_pcd),
    ".npz": (_write_npz, _read_npz),
    ".csv": (_write_csv, _read_csv),
}


def unit_doubt(points: Float64Array, path: Path) -> str:
    """Return a sentence if a non-empty cloud is unlikely to be in metres, else an empty string."""
    size = math.dist(points.min(axis=0), points.max(axis=0))
    if size > 5.0:
        return f"{path} is {size:.0f} m across if its unit is metres; if it is millimetres, divide by 1000 first"
    return ""
