"""Recordings as HDF5, for learning and analysis: one chunk an image, lossless. One camera alone is ``/tactile``.

::

    /                     attributes rig (JSON as in rig.json), rate_hz, T_proximity_tactile (4 x 4, if known)
    /sequence             int64 (N)
    /proximity/depth      uint16 (N, H, W), counts; attributes unit_m, K (3 x 3), distortion, coefficients
    /proximity/color      uint8 (N, H, W, 3), RGB; attributes K, distortion, coefficients, T_color_depth, where the
                          colour camera is one of its own
    /proximity/time_s     float64 (N)
    /tactile/depth, /tactile/color (aligned to the depth; only if frames have it), /tactile/time_s
    /truth/contact        bool (N, H, W), only if frames have it; /truth/depth_m float32, nan where unknown
    /untouched/...        the untouched frame, under the same names, N = 1
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import extra
from ..model.files import atomic_path, remove_leftovers
from ..model.frames import Rig, SensorFrame
from ..model.intrinsics import Intrinsics
from ..model.rig_file import rig_to_json
from ..sources.base import FrameSource, Progress, frames_to_write


def export_hdf5(
    source: FrameSource,
    path: Path | str,
    frames: int | None = None,
    *,
    untouched: SensorFrame | None = None,
    progress: Progress | None = None,
    exclusive: bool = False,
) -> int:
    """Write at most ``frames`` of a source, from its present position, whole or not at all; return how many."""
    h5py = extra("h5py", "HDF5", "export")
    untouched = source.untouched() if untouched is None else untouched
    remove_leftovers(Path(path).parent, Path(path).name)
    with atomic_path(path, exclusive=exclusive) as temporary:
        with closing(_Disk(temporary)) as disk, h5py.File(disk, "w") as file:
            count = 0
            for count, frame in enumerate(frames_to_write(source, frames, progress), start=1):
                frame.check_against(source.rig)
                _append(file, source.rig, frame, count - 1)
                disk.check()
            if untouched is not None:
                _append(file.create_group("untouched"), source.rig, untouched, 0)
            _describe(file, source.rig, source.frame_rate_hz)
        disk.check()
    return count


class _Disk:
    """A file that keeps the error of a full disk: HDF5 ends the process if a write fails while it closes the file."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("w+b", buffering=0)
        self._error: OSError | None = None
        self.seek, self.tell = self._file.seek, self._file.tell
        self.read, self.readinto, self.close = self._file.read, self._file.readinto, self._file.close

    def write(self, data: memoryview) -> int:
        left = memoryview(data)
        with self._kept():
            while left:
                left = left[self._file.write(left) :]
        return len(data)

    def truncate(self, size: int) -> None:
        with self._kept():
            self._file.truncate(size)

    def flush(self) -> None:
        """Do nothing: the file has no buffer."""

    @contextmanager
    def _kept(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self._error = self._error or error  # the first is the cause

    def check(self) -> None:
        """Raise the error of a write that failed."""
        if self._error is not None:
            raise self._error


def _append(group: Any, rig: Rig, frame: SensorFrame, index: int) -> None:
    """Write a frame at an index; what it lacks and others have is 0, truth nan."""
    for words, value in (frame.numbers() | frame.images(rig)).items():
        if words == "proximity_time_s" and not rig.has_proximity:
            continue
        name, array = words.replace("_", "/", 1), np.asarray(value)
        if name not in group:
            kept: dict[str, Any] = {"chunks": (1, *array.shape) if array.ndim else (256,)}
            kept |= {"compression": "gzip", "shuffle": True} if array.ndim else {}
            empty = np.nan if array.dtype == np.float32 else 0
            group.create_dataset(
                name, (index, *array.shape), array.dtype, maxshape=(None, *array.shape), fillvalue=empty, **kept
            )
        group[name].resize(index + 1, axis=0)
        group[name][index] = array


def _describe(file: Any, rig: Rig, rate_hz: float) -> None:
    count = len(file["sequence"])
    for name in ("tactile/color", "truth/contact", "truth/depth_m"):
        if name in file:
            file[name].resize(count, axis=0)
    file.attrs["rig"] = json.dumps(rig_to_json(rig))
    file.attrs["rate_hz"] = rate_hz
    if rig.has_proximity and rig.T_proximity_tactile is not None:
        file.attrs["T_proximity_tactile"] = np.array(rig.T_proximity_tactile)
    for name, camera in (("proximity", rig.proximity), ("tactile", rig.tactile)):
        if f"{name}/depth" in file:
            file[f"{name}/depth"].attrs["unit_m"] = camera.depth_unit_m
            _describe_lens(file[f"{name}/depth"], camera.intrinsics)
    if rig.proximity_color is not None:
        _describe_lens(file["proximity/color"], rig.proximity_color.intrinsics)
        file["proximity/color"].attrs["T_color_depth"] = np.array(rig.proximity_color.T_color_depth)


def _describe_lens(images: Any, lens: Intrinsics) -> None:
    images.attrs["K"] = lens.camera_matrix()
    images.attrs["distortion"] = str(lens.distortion)
    images.attrs["coefficients"] = np.array(lens.coefficients)
