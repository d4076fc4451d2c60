"""Two small cameras side by side and the depths that they see: helpers, and the fixtures ``rig`` and ``make_frame``."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

from tactune.core.model.frames import DepthCamera, Rig, SensorFrame
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


@pytest.fixture(scope="session")
def rig() -> Rig:
    pose = np.eye(4)
    pose[0, 3] = BASELINE_M
    return Rig(
        proximity=DepthCamera(model="L515", serial="p", intrinsics=lens(115.0, 80.0, 59.0), depth_unit_m=1e-5),
        tactile=DepthCamera(model="D405", serial="t", intrinsics=lens(97.0, 78.0, 60.0), depth_unit_m=1e-5),
        T_proximity_tactile=pose.tolist(),
    )


MakeFrame = Callable[..., SensorFrame]


@pytest.fixture
def make_frame(rig: Rig) -> MakeFrame:
    """A frame from depths in metres."""

    def make(proximity_m: npt.ArrayLike, tactile_m: npt.ArrayLike, index: int = 0, **times: float) -> SensorFrame:
        shape = (HEIGHT, WIDTH)
        return SensorFrame(
            sequence=index,
            proximity_depth=counts(np.broadcast_to(proximity_m, shape), rig.proximity),
            tactile_depth=counts(np.broadcast_to(tactile_m, shape), rig.tactile),
            proximity_color=np.zeros((*shape, 3), np.uint8),
            **times,
        )

    return make
