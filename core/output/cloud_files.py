"""Patches as files of points: PLY, NPZ and CSV."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from ..contact.pipeline import ContactPatch
from ..contact.pixels import colors_at
from ..errors import ExportError
from ..model.arrays import AnyArray
from ..model.files import atomic_path
from ..model.frames import Rig, SensorFrame

SUFFIXES: Final = (".ply", ".npz", ".csv")
_XYZ, _RGB = ("x", "y", "z"), ("red", "green", "blue")
#: Open3D skips "ushort" but knows "uint16".
_PLY_NAMES: Final = {"u1": "uchar", "u2": "uint16", "f4": "float"}


def patch_columns(patch: ContactPatch, frame: SensorFrame, rig: Rig) -> dict[str, AnyArray]:
    """Return what is known of each point of a patch: its place, metres, its colour, or black, its pixel, the doubt."""
    pixels = np.flatnonzero(patch.mask)
    colors, _ = colors_at(patch.points, pixels, frame.proximity_color, rig)
    v, u = np.divmod(pixels, patch.mask.shape[1])
    columns: dict[str, AnyArray] = {
        **dict(zip(_XYZ, patch.points.T, strict=True)),
        **dict(zip(_RGB, colors.T, strict=True)),
        "relative_difference": patch.relative_difference.ravel()[pixels],
        "u": u.astype(np.uint16),
        "v": v.astype(np.uint16),
        **patch.doubt_by_point(),
    }
    if patch.pressure is not None:
        columns |= patch.pressure.by_point()
    return columns


def write_cloud(path: Path | str, columns: Mapping[str, AnyArray]) -> None:
    """Write `patch_columns` without loss in the format of the path's suffix; the file appears whole or not at all."""
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ExportError(f"{path} has the suffix {path.suffix!r}; clouds are {', '.join(SUFFIXES)}")
    kinds = {name: values.dtype.newbyteorder("<") for name, values in columns.items()}
    records = np.empty(len(columns["x"]), list(kinds.items()))
    for name, values in columns.items():
        records[name] = values
    with atomic_path(path) as temporary:
        if suffix == ".npz":
            arrays: dict[str, Any] = {name: columns[name] for name in columns if name not in (*_XYZ, *_RGB)}
            for name, parts in (("points", _XYZ), ("colors", _RGB)):
                arrays[name] = np.column_stack([columns[part] for part in parts])
            with temporary.open("wb") as file:  # given a name, NumPy would add .npz to .NPZ
                np.savez(file, allow_pickle=False, **arrays)
        elif suffix == ".ply":
            properties = [f"property {_PLY_NAMES[kind.str[1:]]} {name}" for name, kind in kinds.items()]
            head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(records)}", *properties]
            temporary.write_bytes("\n".join([*head, "end_header"]).encode() + b"\n" + records.tobytes())
        else:
            titles = [f"{name}_m" if name in _XYZ else name for name in columns]
            line = ",".join("%.9g" if kind.kind == "f" else "%d" for kind in kinds.values())
            rows = [line % row for row in records.tolist()]  # np.savetxt takes twice as long
            temporary.write_text("\n".join([",".join(titles), *rows, ""]), encoding="ascii")
