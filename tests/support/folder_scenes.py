"""A small rig, random frames and sources of them, to be written to folders and read back."""

from __future__ import annotations

import numpy as np

from tactune.core.model.frames import ColorCamera, DepthCamera, GroundTruth, Rig, SensorFrame
from tactune.core.model.intrinsics import Distortion, Intrinsics
from tactune.core.sources.base import FrameSource, SeekableSource

UNIT_M = 0.00025
POSE = ((0.0, -1.0, 0.0, 0.04), (1.0, 0.0, 0.0, -0.01), (0.0, 0.0, 1.0, 0.1 / 3), (0.0, 0.0, 0.0, 1.0))


def lens(width: int, height: int, **extra: object) -> Intrinsics:
    return Intrinsics(width=width, height=height, fx=460.1, fy=1 / 3, cx=width / 2, cy=-0.5, **extra)


RIG = Rig(
    proximity=DepthCamera(model="L515", serial="f0", intrinsics=lens(7, 5), depth_unit_m=UNIT_M),
    tactile=DepthCamera(
        model="D405",
        intrinsics=lens(
            6, 4, distortion=Distortion.INVERSE_BROWN_CONRADY, coefficients=(0.1, 0.2 / 3, -1e-17, 4.0, 5.0)
        ),
        depth_unit_m=0.0001,
    ),
    proximity_color=ColorCamera(intrinsics=lens(9, 8), T_color_depth=POSE),
    T_proximity_tactile=POSE,
)


def make_frame(seed: int, rig: Rig = RIG, **changes: object) -> SensorFrame:
    rng = np.random.default_rng(seed)
    shape, tactile = rig.proximity.intrinsics.shape, rig.tactile.intrinsics.shape
    truth_m = rng.uniform(0.1, 0.4, shape).astype(np.float32)
    truth_m[0, 0] = np.nan
    values: dict[str, object] = {
        "sequence": 100 + seed,
        "proximity_depth": rng.integers(0, 65536, shape).astype(np.uint16),
        "tactile_depth": rng.integers(0, 65536, tactile).astype(np.uint16),
        "proximity_color": rng.integers(0, 256, (*rig.proximity_color_shape, 3)).astype(np.uint8),
        "tactile_color": rng.integers(0, 256, (*tactile, 3)).astype(np.uint8),
        "proximity_time_s": 1.7e9 + seed / 7,
        "tactile_time_s": 1.7e9 + seed / 7 + 0.0031,
        "truth": GroundTruth(rng.random(shape) < 0.5, truth_m),
    }
    return SensorFrame(**(values | changes))  # type: ignore[arg-type]


class ListSource(SeekableSource):
    def __init__(self, frames: list[SensorFrame], rig: Rig = RIG, untouched: SensorFrame | None = None) -> None:
        super().__init__("list", rig, len(frames))
        self.frames = frames
        self._untouched = untouched

    def read(self, index: int) -> SensorFrame:
        return self.frames[index]

    def untouched(self) -> SensorFrame | None:
        return self._untouched


class LiveSource(FrameSource):
    name = "live"
    rig = RIG  # type: ignore[assignment]

    def __init__(self) -> None:
        self._given = 0

    def next_frame(self) -> SensorFrame | None:
        self._given += 1
        return make_frame(self._given)


def assert_same(one: SensorFrame, other: SensorFrame) -> None:
    for name in ("proximity_depth", "tactile_depth", "proximity_color"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    assert (one.sequence, one.proximity_time_s, one.tactile_time_s) == (
        other.sequence,
        other.proximity_time_s,
        other.tactile_time_s,
    )
    assert (one.tactile_color is None) == (other.tactile_color is None)
    if one.tactile_color is not None:
        np.testing.assert_array_equal(one.tactile_color, other.tactile_color)
    assert (one.truth is None) == (other.truth is None)
    if one.truth is not None and other.truth is not None:
        np.testing.assert_array_equal(one.truth.contact, other.truth.contact)
        assert (one.truth.depth_m is None) == (other.truth.depth_m is None)
        if one.truth.depth_m is not None and other.truth.depth_m is not None:
            assert other.truth.depth_m.dtype == np.float32
            np.testing.assert_array_equal(one.truth.depth_m, other.truth.depth_m)
