"""Two small cameras side by side and a wall that they see: helpers, and the fixture ``rig``."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from fakes import FakeSource
from tactune.core.model.frames import DepthCamera, Rig, SensorFrame
from tactune.core.model.intrinsics import Intrinsics

WIDTH, HEIGHT = 160, 120
BASELINE_M = 0.040
#: The colour of the wall's prints, and a mask for them.
PRINT = (214, 40, 160)
PRINT_MASK = {"mask.enabled": True, "mask.hue": (145, 175), "mask.saturation": (110, 255), "mask.value": (60, 255)}


def lens(f: float, cx: float, cy: float) -> Intrinsics:
    return Intrinsics(width=WIDTH, height=HEIGHT, fx=f, fy=f, cx=cx, cy=cy)


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


def wall_frame(rig: Rig, index: int, step_m: float = 0.0, bias_m: float = 0.004) -> SensorFrame:
    """A wall with prints 300 mm away and noise of 0.6 and 0.3 mm; the proximity camera reads ``bias_m`` too far."""
    near, far = np.random.default_rng(index).normal(0, (0.0006, 0.0003), (HEIGHT, WIDTH, 2)).transpose(2, 0, 1)
    color = np.full((HEIGHT, WIDTH, 3), 120, np.uint8)
    color[30:50, 50:70] = color[70:90, 80:100] = color[60:80, 40:60] = PRINT
    depth_m = 0.300 + step_m * index
    proximity, tactile = counts(depth_m + bias_m + near, rig.proximity), counts(depth_m + far, rig.tactile)
    return SensorFrame(index, proximity, tactile, color, proximity_time_s=index / 30, tactile_time_s=index / 30)


def wall_source(rig: Rig, length: int = 30, live: bool = False, **options: float) -> FakeSource:
    """A recording of the wall, or cameras in front of it."""
    return FakeSource(length, rig, make=lambda index, rig: wall_frame(rig, index, **options), name="wall", live=live)
