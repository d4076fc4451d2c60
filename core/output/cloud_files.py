"""Point clouds as files: PLY, NPZ and CSV."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from ..contact.pipeline import ContactPatch
from ..contact.pixels import colors_at
from ..errors import ExportError
from ..model.arrays import AnyArray
from ..model.clouds import PointCloud
from ..model.files import atomic_path
from ..model.frames import Rig, SensorFrame

SUFFIXES: Final = (".ply", ".npz", ".csv")
_XYZ, _RGB = ("x", "y", "z"), ("red", "green", "blue")
_NAME = re.compile(r"(?!(?:[xyz](?:_m)?|red|green|blue|points|colors|file|allow_pickle)$)[A-Za-z]\w*", re.ASCII)
#: Open3D skips "ushort" but knows "uint16".
_PLY_NAMES: Final = {
    "i1": "char", "u1": "uchar", "i2": "short", "u2": "uint16", "i4": "int", "u4": "uint", "f4": "float", "f8": "double"
}  # fmt: skip
_CSV_FORMATS: Final = {"f4": "%.9g", "f8": "%.17g"}


def patch_cloud(patch: ContactPatch, frame: SensorFrame, rig: Rig) -> PointCloud:
    """Return a patch's points, their colours (or black), pixels ``u``, ``v``, and what is known of each."""
    pixels = np.flatnonzero(patch.mask)
    colors, _ = colors_at(patch.points, pixels, frame.proximity_color, rig)
    v, u = np.divmod(pixels, patch.mask.shape[1])
    attributes: dict[str, npt.NDArray[np.generic]] = {
        "relative_difference": patch.relative_difference.ravel()[pixels],
        "u": u.astype(np.uint16),
        "v": v.astype(np.uint16),
        **patch.doubt_by_point(),
    }
    if patch.pressure is not None:
        attributes |= patch.pressure.by_point()
    return PointCloud(patch.points, colors, attributes)


def write_cloud(path: Path | str, cloud: PointCloud) -> None:
    """Write a cloud without loss in the format of the path's suffix; the file appears whole or not at all."""
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
