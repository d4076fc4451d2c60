"""Point clouds as files: writing PLY, NPZ and CSV, and reading the points of these, also of other programs."""

from __future__ import annotations

import io
import math
import re
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

SUFFIXES: Final = (".ply", ".npz", ".csv")
_XYZ, _RGB = ("x", "y", "z"), ("red", "green", "blue")
_NAME = re.compile(r"(?!(?:[xyz](?:_m)?|red|green|blue|points|colors|file|allow_pickle)$)[A-Za-z]\w*", re.ASCII)
#: Open3D skips "ushort" but knows "uint16".
_PLY_NAMES: Final = {
    "i1": "char", "u1": "uchar", "i2": "short", "u2": "uint16", "i4": "int", "u4": "uint", "f4": "float", "f8": "double"
}  # fmt: skip
_CSV_FORMATS: Final = {"f4": "%.9g", "f8": "%.17g"}


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

    ``.npz`` and ``.ply`` keep every bit of points, colours and attributes (8 to 32 bit integers and floats; bool
    becomes uint8). ``.csv`` has a header ``x_m,y_m,z_m,red,green,blue,…`` and digits enough to give the same numbers
    back.

    Raises
    ------
    ExportError
        Unknown suffix, an attribute that the format cannot hold, or a place that cannot be written.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ExportError(f"{path} has the suffix {path.suffix!r}; clouds are {', '.join(SUFFIXES)}")
    columns: dict[str, AnyArray] = dict(zip(_XYZ, np.asarray(cloud.points, np.float32).T, strict=True))
    if cloud.colors is not None:
        columns |= zip(_RGB, np.asarray(cloud.colors, np.uint8).T, strict=True)
    for name, values in cloud.attributes.items():
        if not _NAME.fullmatch(name):
            raise ExportError(f"cannot write {path}: an attribute cannot be called {name!r}; use another name")
        if values.shape != (len(cloud),):
            raise ExportError(f"cannot write {path}: {name} has {values.shape} values, there are {len(cloud)} points")
        if suffix == ".ply" and values.dtype != np.bool_ and values.dtype.str[1:] not in _PLY_NAMES:
            raise ExportError(f"cannot write {path}: .ply holds no {values.dtype} such as {name}; choose .npz")
        columns[name] = values.astype(np.uint8) if values.dtype == np.bool_ else values
    records = np.empty(len(cloud), [(name, values.dtype.newbyteorder("<")) for name, values in columns.items()])
    for name, values in columns.items():
        records[name] = values
    with atomic_path(path) as temporary:
        if suffix == ".npz":
            arrays: dict[str, Any] = {"points": cloud.points, **{name: columns[name] for name in cloud.attributes}}
            if cloud.colors is not None:
                arrays["colors"] = cloud.colors
            with temporary.open("wb") as file:  # given a name, NumPy would add .npz to .NPZ
                np.savez(file, allow_pickle=False, **arrays)
        elif suffix == ".ply":
            properties = [f"property {_PLY_NAMES[values.dtype.str[1:]]} {name}" for name, values in columns.items()]
            head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(cloud)}", *properties, "end_header"]
            temporary.write_bytes("\n".join(head).encode() + b"\n" + records.tobytes())
        else:
            titles = [f"{name}_m" if name in _XYZ else name for name in columns]
            formats = [_CSV_FORMATS.get(values.dtype.str[1:], "%d") for values in columns.values()]
            np.savetxt(temporary, records, fmt=formats, delimiter=",", header=",".join(titles), comments="")


def read_points(path: Path | str) -> tuple[Float64Array, int]:
    """Read the points of a cloud file: ``.ply`` of any program, ``.npz`` and ``.csv`` as `write_cloud` writes them.

    Returns
    -------
    points : float64, shape (N, 3)
        In the file's unit, without points that have a nan.
    dropped : int
        Number of points with a nan.

    Raises
    ------
    SourceError
        No such file, or none that can be read, or a coordinate is infinite.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise SourceError(f"{path} has the suffix {path.suffix!r}; clouds are {', '.join(SUFFIXES)}")
    try:
        data = read_file(path)
        if suffix == ".npz":
            points = np.asarray(parse_npz(data)["points"], np.float64)
        elif suffix == ".csv":
            titles = data.partition(b"\n")[0].decode().removeprefix("\ufeff").strip().split(",")
            if titles[:3] != ["x_m", "y_m", "z_m"]:
                raise ValueError("its header does not begin with x_m,y_m,z_m")
            rows = io.BytesIO(data.partition(b"\n")[2].strip())
            table = np.empty((0, len(titles)))
            if rows.getbuffer().nbytes:
                table = np.loadtxt(rows, delimiter=",", ndmin=2, comments=None)
            if table.shape[1] != len(titles):
                raise ValueError(f"it has {table.shape[1]} columns, its header {len(titles)}")
            points = table[:, :3]
        else:
            points = _ply_points(data)
        if points.ndim != 2 or points.shape[1] != 3:
            raise ValueError(f"its points have the shape {points.shape}")
    except OSError as error:
        raise SourceError(f"cannot read {path}: {error.strerror or error}; check the path") from error
    except Exception as error:  # the libraries check with whatever Python raises
        detail = " ".join(str(error).split())[:200] or type(error).__name__
        raise SourceError(f"{path} is no readable {suffix} cloud ({detail}); export it again") from error
    if np.isinf(points).any():
        raise SourceError(f"{path} holds an infinite coordinate; export it again")
    known = ~np.isnan(points).any(axis=1)
    return points[known], int(np.count_nonzero(~known))


def _ply_points(data: bytes) -> Float64Array:
    """Return the vertices of a PLY file."""
    from trimesh.exchange.ply import load_ply

    stated = re.search(rb"element vertex (\d{1,12})\s", data[:10_000])
    if stated is not None and int(stated[1]) == 0:  # the library wants some
        return np.empty((0, 3))
    points = np.asarray(load_ply(io.BytesIO(data))["vertices"], np.float64)
    if stated is None or len(points) != int(stated[1]):  # the library takes what a text file has
        raise ValueError(f"it has {len(points)} of its points")
    return points


def unit_doubt(points: Float64Array, path: Path) -> str:
    """Return a sentence if a non-empty cloud is unlikely to be in metres, else an empty string."""
    size = math.dist(points.min(axis=0), points.max(axis=0))
    if size > 5.0:
        return f"{path} is {size:.0f} m across if its unit is metres; if it is millimetres, divide by 1000 first"
    return ""
