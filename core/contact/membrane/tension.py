"""How strongly the free membrane is curved, which is its pressure over its tension.

A free membrane under the pressure p and the tension T has twice the mean curvature p / T everywhere (Young-Laplace).
Only the tactile camera is used, so a bias between the cameras has no effect.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final

import numpy as np

from ...model.alignment import AlignmentSection
from ...model.arrays import Float32Array
from ...model.clouds import ray_table
from ...model.frames import Rig, SensorFrame
from ...model.intrinsics import Intrinsics
from ..kernels import membrane as kernels
from ..kernels.membrane import BLOCK_PX

#: Sigma of the window over blocks of tactile pixels.
_WINDOW_BLOCKS: Final = 2.5
#: Share of a window that must have depth.
_MIN_SHARE: Final = np.float32(0.7)
#: With fewer blocks the usual curvature is assumed, 1/m; other values are limited.
_MIN_BLOCKS: Final = 100
USUAL_PER_M: Final = 10.0
LIMITS_PER_M: Final = (3.0, 40.0)


def free_curvature_per_m(frame: SensorFrame, alignment: AlignmentSection, rig: Rig) -> float:
    """Return twice the mean curvature of the free membrane, 1/m: as measured, within limits, or else a usual one."""
    return usable_curvature_per_m(measured_curvature_per_m(frame, alignment, rig))


def usable_curvature_per_m(measured_per_m: float) -> float:
    """Return a measured curvature within limits; the usual one for nan."""
    return USUAL_PER_M if math.isnan(measured_per_m) else float(np.clip(measured_per_m, *LIMITS_PER_M))


def measured_curvature_per_m(frame: SensorFrame, alignment: AlignmentSection, rig: Rig) -> float:
    """Measure twice the mean curvature of the free membrane, 1/m; nan without enough tactile depth.

    It is the median over the tactile image: contact is flatter or dented, but covers less than half of what the camera
    sees, and noise has no mean.
    """
    import cv2

    camera = rig.tactile.intrinsics
    shape = camera.height // BLOCK_PX, camera.width // BLOCK_PX
    if min(shape) < 3:
        return math.nan
    unit_m, offset_m = rig.tactile.depth_unit_m * alignment.depth_scale, alignment.depth_offset_m
    # Points are averaged, not depths: at the image's border their mean is shifted, but lies on the surface.
    points, bulge = np.empty((2, *shape, 4), np.float32), np.empty(shape, np.float32)
    kernels.block_points(
        frame.tactile_depth, _rays_of_blocks(camera), np.float32(unit_m), np.float32(offset_m), points[0]
    )
    cv2.GaussianBlur(points[0], (0, 0), _WINDOW_BLOCKS, points[1], borderType=cv2.BORDER_CONSTANT)
    kernels.bulges(points[1], _MIN_SHARE, bulge)
    bulge = bulge[~np.isnan(bulge)]
    if len(bulge) < _MIN_BLOCKS:
        return math.nan
    middle = len(bulge) // 2
    return float(np.partition(bulge, middle)[middle])


@lru_cache(maxsize=8)
def _rays_of_blocks(camera: Intrinsics) -> Float32Array:
    """Return ``(x / z, y / z)`` at the centre of each block, shape (h, w, 2)."""
    rays = ray_table(camera)[: camera.height // BLOCK_PX * BLOCK_PX, : camera.width // BLOCK_PX * BLOCK_PX]
    squares = rays.reshape(camera.height // BLOCK_PX, BLOCK_PX, camera.width // BLOCK_PX, BLOCK_PX, 2)
    return np.ascontiguousarray(squares.mean(axis=(1, 3)), np.float32)
