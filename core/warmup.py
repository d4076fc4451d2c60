"""Compiles the kernels of a contact test, or all, before the first frame, so that no frame waits for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

import numpy as np

from .contact.kernels.colors import color_lookup
from .contact.kernels.compiling import Compiled, compiled_so_far, counting_compiled, is_kept
from .contact.kernels.membrane import add_to_means, collect_points, find_differences
from .contact.kernels.quadric import bend_quadrics, fit_quadrics
from .contact.kernels.tolerance import find_candidates
from .contact.masking import in_hsv_range
from .contact.outliers.point_search import search_all
from .contact.outliers.row_search import search_rows
from .contact.pipeline import ContactPipeline
from .contact.pixels import colors_at
from .model.frames import ColorCamera, DepthCamera, Rig, SensorFrame
from .model.intrinsics import Intrinsics
from .preset import Preset

#: Called with the share done, 0 to 1, and what is done.
Progress = Callable[[float, str], None]

_WIDTH, _HEIGHT = 96, 64
#: Number of kernels of a frame, by contact test, those of the mask in the untouched frame included; of the average.
_KERNELS: Final = {"tolerance": 10, "membrane": 14, "pressure": 9}
_AVERAGE_KERNELS: Final = 2
#: The largest and the last kernels of each test, and what the window reads of a patch.
_LARGEST: Final[dict[str, tuple[Any, ...]]] = {
    "tolerance": (find_candidates, search_all),
    "membrane": (find_differences, collect_points),
    "pressure": (fit_quadrics, bend_quadrics),
}
_ALL: Final = (*sum(_LARGEST.values(), ()), search_rows, add_to_means, color_lookup)


def is_compiled(preset: Preset | None = None) -> bool:
    """Return whether the kernels of a preset's contact test, or else all, are cached on disk; compiles nothing."""
    if preset is None:
        return all(map(is_kept, _ALL))
    average = (add_to_means,) if preset.averaged_frames > 1 else ()
    # a test that somebody adds is compiled by its first frame
    return all(map(is_kept, (*_LARGEST.get(preset.contact_test, ()), *average)))


def warm_up_if_needed(progress: Progress, preset: Preset | None = None) -> None:
    """Compile what the first frame of a preset's contact test would wait for, or everything, unless it is compiled."""
    if is_compiled(preset):
        return
    if preset is None:
        warm_up(progress)
    else:
        warm_up_test(preset, progress)


def warm_up_test(preset: Preset, progress: Progress) -> None:
    """Compile the kernels of a preset's contact test, and no others; tells before the first kernel and after each."""
    test, averages = preset.contact_test, preset.averaged_frames > 1
    total = _KERNELS.get(test, 1) + _AVERAGE_KERNELS * averages

    def tell(done: int) -> None:
        number = min(done + 1, total)  # other threads may compile something else meanwhile
        progress((number - 0.5) / total, f"Compiling the {test} test for this computer, once: {number} of {total}")

    tell(0)
    with counting_compiled(tell):
        _pipeline(_preset(test, 2 if averages else 1)).process(_frame(test))
    progress(1.0, f"The {test} test is compiled")


def warm_up_views(test: str) -> None:
    """Compile what the window reads of a frame, and of its patch by a contact test beside the points."""
    rig, frame, preset = _rig(test), _frame(test), _preset(test)
    patch = _pipeline(preset).process(frame)
    _ = patch.provenance, patch.aligned
    colors_at(patch.points, np.flatnonzero(patch.mask), frame.proximity_color, rig)
    in_hsv_range(frame.proximity_color, preset.mask)


def warm_up(progress: Progress = lambda share, words: None) -> Compiled:
    """Run every kernel once, on artificial frames; return how many were compiled, and where they are cached."""
    for number, preset in enumerate((_preset("tolerance"), _preset("membrane", 2), _preset("pressure"))):
        warm_up_test(preset, lambda share, words, number=number: progress((number + share) / 4, words))  # type: ignore[misc]
    warm_up_views("membrane")
    progress(1.0, "All contact tests are compiled")
    return compiled_so_far()


def _pipeline(preset: Preset) -> ContactPipeline:
    """Return a pipeline in whose untouched frame the membrane is farther away, and nowhere flat."""
    frame = _frame(preset.contact_test, flat_px=0.0)
    return ContactPipeline(
        preset, _rig(preset.contact_test), replace(frame, tactile_depth=frame.tactile_depth + np.uint16(300))
    )


def _preset(test: str, frames: int = 1) -> Preset:
    """Return a preset with which the artificial frames need every kernel of a contact test."""
    values = {"mask.enabled": True, "mask.value": (0, 9), "outliers.min_cluster_area_mm2": 1.0, "tolerance.t": 0.05}
    return Preset(contact_test=test).with_values(values | {"membrane.frames": frames})


def _size(test: str) -> tuple[int, int]:
    """Return height and width of the artificial images; the pressure test reads cells of many pixels."""
    return (2 * _HEIGHT, 2 * _WIDTH) if test == "pressure" else (_HEIGHT, _WIDTH)


def _rig(test: str) -> Rig:
    height, width = _size(test)
    lens = Intrinsics(width=width, height=height, fx=0.73 * width, fy=0.73 * width, cx=width / 2, cy=height / 2)
    camera, pose = DepthCamera(intrinsics=lens, depth_unit_m=0.0001), np.eye(4).tolist()
    color = ColorCamera(intrinsics=lens, T_color_depth=pose)
    return Rig(proximity=camera, tactile=camera, proximity_color=color, T_proximity_tactile=pose)


def _frame(test: str, flat_px: float = 20.0) -> SensorFrame:
    """Return a frame in which a contact test finds contact, by every kernel that it has."""
    height, width = _size(test)
    color = np.full((height, width, 3), 128, np.uint8)
    if test == "tolerance":  # a surface with a smooth and a ragged half, and a lone point
        depth = np.full((height, width), 3000, np.uint16)
        depth[:, 40:] += np.random.default_rng(0).integers(0, 300, (height, width - 40)).astype(np.uint16)
        depth[:, 60:] = 0
        depth[0, -1] = 9000
        return SensorFrame(0, depth, depth.copy(), color)
    # a bulging membrane that is flat within this radius, where an object touches its centre
    v, u = np.mgrid[:height, :width] - np.array([height, width])[:, None, None] / 2
    square = np.maximum(u * u + v * v, flat_px**2)
    membrane = 3000 - square / 16
    behind = np.where(square < 500, membrane, membrane + 2000)
    return SensorFrame(1, behind.astype(np.uint16), membrane.astype(np.uint16), color)
