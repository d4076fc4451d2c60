"""Two small cameras side by side, and the depths that they see."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from tactune.core.model.frames import DepthCamera
from tactune.core.model.intrinsics import Intrinsics

WIDTH, HEIGHT = 160, 120
BASELINE_M = 0.040


def lens(f: float, cx: float, cy: float) -> Intrinsics:
    return Intrinsics(width=WIDTH, height=HEIGHT, fx=f, fy=f, cx=cx, cy=cy)


def plane_depth(camera: DepthCamera, normal: npt.ArrayLike, distance_m: float) -> npt.NDArray[np.float64]:
    """Depth at which each ray meets the plane normal . p = distance."""
    rays = camera.intrinsics.rays().astype(np.float64)
    homogeneous = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=2)
    return distance_m / (homogeneous @ (np.asarray(normal) / np.linalg.norm(normal)))


def counts(depth_m: npt.ArrayLike, camera: DepthCamera) -> npt.NDArray[np.uint16]:
    return np.rint(np.asarray(depth_m) / camera.depth_unit_m).astype(np.uint16)
