"""Two cameras side by side before scenes whose depths are known."""

from __future__ import annotations

import os

if not any(os.environ.get(name) for name in ("QT_QPA_PLATFORM", "DISPLAY", "WAYLAND_DISPLAY")):
    os.environ["QT_QPA_PLATFORM"] = "offscreen"

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

from side_by_side import BASELINE_M, HEIGHT, WIDTH, counts, lens
from tactune.core.model.frames import DepthCamera, Rig, SensorFrame


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
