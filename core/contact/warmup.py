"""Compiles every kernel of the pipeline before the first frame, so that no frame waits for it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from ..model.frames import ColorCamera, DepthCamera, Rig, SensorFrame
from ..model.intrinsics import Intrinsics
from ..preset import Preset
from .kernels import chain as kernels
from .kernels.colors import color_lookup
from .kernels.compiling import Compiled, compiled_so_far, is_kept
from .kernels.equilibrium import settle
from .kernels.membrane import find_differences
from .masking import colors_at, in_hsv_range
from .outliers.point_search import search_points
from .outliers.row_search import search_rows
from .outliers.statistical import below_threshold, compare_with_all
from .pipeline import ContactPipeline

Progress = Callable[[float, str], None]

#: The message while kernels are compiled.
COMPILING: Final = "Compiling the pipeline for this computer; this happens once"

_WIDTH, _HEIGHT = 96, 64


def is_compiled() -> bool:
    """Return whether the largest kernels are compiled and cached on disk; compiles nothing."""
    largest = kernels.find_candidates, search_rows, search_points, color_lookup, find_differences, settle
    return all(map(is_kept, largest))


def warm_up_if_needed(progress: Progress) -> None:
    """Compile the kernels that the first frame would wait for, unless they are compiled."""
    if not is_compiled():
        warm_up(progress)


def warm_up(progress: Progress = lambda share, words: None) -> Compiled:
    """Run every kernel once, on an artificial frame.

    Parameters
    ----------
    progress : callable
        Called with the share done, 0 to 1, and a description of the work.

    Returns
    -------
    Compiled
        How many kernels were compiled, how many were loaded from disk, and where they are cached.
    """
    progress(0.05, COMPILING)
    rig, frame = _rig(), _frame()
    preset = Preset(contact_test="tolerance").with_values(
        {"mask.enabled": True, "mask.value": (0, 9), "outliers.min_cluster_area_mm2": 1.0, "tolerance.t": 0.05}
    )
    pipeline = ContactPipeline(preset, rig)
    patch = pipeline.process(frame)
    points, pixels = patch.points, np.flatnonzero(patch.mask)
    few = np.arange(min(4, len(points)))
    means = np.empty(len(points))
    membrane = preset.with_value("contact_test", "membrane")
    steps: list[Callable[[], object]] = [
        lambda: patch.provenance,
        lambda: patch.aligned,
        lambda: below_threshold(np.ones(len(points)), 2.0),
        lambda: compare_with_all(few, points, 2, means),
        lambda: colors_at(points, pixels, frame.proximity_color, rig),
        lambda: in_hsv_range(frame.proximity_color, preset.mask),
        lambda: ContactPipeline(membrane, rig).process(frame).provenance,
        lambda: ContactPipeline(membrane.with_value("membrane.frames", 2), rig).process(frame).mask,
        lambda: ContactPipeline(membrane, rig).process(_bulging_frame()).mask,
    ]
    for done, step in enumerate(steps):
        progress((done + 1) / (len(steps) + 1), COMPILING)
        step()
    progress(1.0, "The pipeline is compiled")
    return compiled_so_far()


def _rig() -> Rig:
    lens = Intrinsics(width=_WIDTH, height=_HEIGHT, fx=70.0, fy=70.0, cx=47.5, cy=31.5)
    camera = DepthCamera(intrinsics=lens, depth_unit_m=0.0001)
    unit = np.eye(4).tolist()
    return Rig(
        proximity=camera,
        tactile=camera,
        proximity_color=ColorCamera(intrinsics=lens, T_color_depth=unit),
        T_proximity_tactile=unit,
    )


def _frame() -> SensorFrame:
    """Return a frame whose surface has a smooth and a ragged half, and a lone point."""
    depth = np.full((_HEIGHT, _WIDTH), 3000, np.uint16)
    depth[:, 40:] += np.random.default_rng(0).integers(0, 300, (_HEIGHT, _WIDTH - 40)).astype(np.uint16)
    depth[:, 60:] = 0
    depth[0, -1] = 9000
    return SensorFrame(0, depth, depth.copy(), np.full((_HEIGHT, _WIDTH, 3), 128, np.uint8))


def _bulging_frame() -> SensorFrame:
    """Return a frame of a bulging membrane that is a little flattened where an object touches its centre."""
    v, u = np.mgrid[:_HEIGHT, :_WIDTH] - np.array([_HEIGHT, _WIDTH])[:, None, None] / 2
    square = np.maximum(u * u + v * v, 400.0)
    membrane = 3000 - square / 16
    behind = np.where(square < 500, membrane, membrane + 2000)
    color = np.full((_HEIGHT, _WIDTH, 3), 128, np.uint8)
    return SensorFrame(1, behind.astype(np.uint16), membrane.astype(np.uint16), color)
