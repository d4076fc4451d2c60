"""Small rigs and frames with distinctive numbers, and a comparison of frames."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tactune.core.model.frames import ColorCamera, DepthCamera, GroundTruth, Rig, SensorFrame
from tactune.core.model.intrinsics import Distortion, Intrinsics
from tactune.core.output import RecordingStatus, SessionWriter

POSE = ((0.0, -1.0, 0.0, 0.04), (1.0, 0.0, 0.0, -0.01), (0.0, 0.0, 1.0, 0.1 / 3), (0.0, 0.0, 0.0, 1.0))


@pytest.fixture(scope="session")
def make_rig() -> Callable[..., Rig]:
    def make(
        proximity: tuple[int, int] = (7, 5), tactile: tuple[int, int] = (6, 4), color: tuple[int, int] | None = (9, 3)
    ) -> Rig:
        def lens(size: tuple[int, int], **extra: object) -> Intrinsics:
            return Intrinsics(width=size[0], height=size[1], fx=460.1, fy=1 / 3, cx=size[0] / 2, cy=-0.5, **extra)

        bent = {"distortion": Distortion.BROWN_CONRADY, "coefficients": (0.1, 0.2 / 3, -1e-17, 4.0, 5.0)}
        return Rig(
            proximity=DepthCamera(model="L515", serial="f0", intrinsics=lens(proximity), depth_unit_m=0.00025),
            tactile=DepthCamera(model="D405", intrinsics=lens(tactile, **bent), depth_unit_m=0.1 / 1000),
            proximity_color=None if color is None else ColorCamera(intrinsics=lens(color), T_color_depth=POSE),
            T_proximity_tactile=POSE,
        )

    return make


@pytest.fixture(scope="session")
def rig(make_rig: Callable[..., Rig]) -> Rig:
    return make_rig()


@pytest.fixture(scope="session")
def make_frame() -> Callable[..., SensorFrame]:
    """Make a frame of noise for a rig, different for each seed."""

    def make(rig: Rig, seed: int = 0, **changes: object) -> SensorFrame:
        rng = np.random.default_rng(seed)
        shape, tactile = rig.proximity.intrinsics.shape, rig.tactile.intrinsics.shape
        truth_m = rng.uniform(0.1, 0.4, shape).astype(np.float32)
        truth_m[0, 0] = np.nan
        values: dict[str, object] = {
            "sequence": 100 + seed,
            "proximity_depth": rng.integers(0, 65536, shape, np.uint16),
            "tactile_depth": rng.integers(0, 65536, tactile, np.uint16),
            "proximity_color": rng.integers(0, 256, (*rig.proximity_color_shape, 3), np.uint8),
            "tactile_color": rng.integers(0, 256, (*tactile, 3), np.uint8),
            "proximity_time_s": 1.7e9 + seed / 7,
            "tactile_time_s": 1.7e9 + seed / 7 + 0.0031,
            "truth": GroundTruth(rng.random(shape) < 0.5, truth_m),
        }
        return SensorFrame(**(values | changes))  # type: ignore[arg-type]

    return make


@pytest.fixture
def make_frames(rig: Rig, make_frame: Callable[..., SensorFrame]) -> Callable[[int], list[SensorFrame]]:
    return lambda count: [make_frame(rig, seed) for seed in range(count)]


@pytest.fixture(scope="session")
def record() -> Callable[..., RecordingStatus]:
    """Write frames to a file, losing none."""

    def write(path: Path, rig: Rig, frames: list[SensorFrame], **options: object) -> RecordingStatus:
        with SessionWriter(path, rig, **options) as writer:  # type: ignore[arg-type]
            for frame in frames:
                assert writer.put(frame, wait=True)
        status = writer.close()
        assert status.error == ""
        return status

    return write


@pytest.fixture(scope="session")
def same_frame() -> Callable[[SensorFrame, SensorFrame], bool]:
    """Whether two frames have the same bits everywhere."""

    def bits(array: np.ndarray | None) -> object:
        return None if array is None else (array.dtype.str, array.shape, array.tobytes())

    def everything(frame: SensorFrame) -> list[object]:
        truth = frame.truth
        arrays = [frame.proximity_depth, frame.tactile_depth, frame.proximity_color, frame.tactile_color]
        arrays += [None, None] if truth is None else [truth.contact, truth.depth_m]
        times = np.array([frame.proximity_time_s, frame.tactile_time_s])
        return [frame.sequence, *map(bits, (times, *arrays))]

    return lambda first, second: everything(first) == everything(second)
