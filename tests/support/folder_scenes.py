"""A small rig, random frames and sources of them, to be written to folders and read back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fakes import FakeSource
from tactune.core.model.frames import ColorCamera, DepthCamera, GroundTruth, Rig, SensorFrame
from tactune.core.model.intrinsics import Distortion, Intrinsics
from tactune.core.output.writer import RecordingStatus, SessionWriter

UNIT_M = 0.00025
POSE = ((0.0, -1.0, 0.0, 0.04), (1.0, 0.0, 0.0, -0.01), (0.0, 0.0, 1.0, 0.1 / 3), (0.0, 0.0, 0.0, 1.0))


def lens(width: int, height: int, **extra: object) -> Intrinsics:
    return Intrinsics(width=width, height=height, fx=460.1, fy=1 / 3, cx=width / 2, cy=-0.5, **extra)


def make_rig(
    proximity: tuple[int, int] = (7, 5), tactile: tuple[int, int] = (6, 4), color: tuple[int, int] | None = (9, 3)
) -> Rig:
    """A rig whose images have these widths and heights."""
    bent = {"distortion": Distortion.BROWN_CONRADY, "coefficients": (0.1, 0.2 / 3, -1e-17, 4.0, 5.0)}
    return Rig(
        proximity=DepthCamera(model="L515", serial="f0", intrinsics=lens(*proximity), depth_unit_m=UNIT_M),
        tactile=DepthCamera(model="D405", intrinsics=lens(*tactile, **bent), depth_unit_m=0.1 / 1000),
        proximity_color=None if color is None else ColorCamera(intrinsics=lens(*color), T_color_depth=POSE),
        T_proximity_tactile=POSE,
    )


RIG = make_rig(color=(9, 8))


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


def make_frames(count: int) -> list[SensorFrame]:
    return [make_frame(seed) for seed in range(count)]


def record(path: Path, rig: Rig, frames: list[SensorFrame], **options: Any) -> RecordingStatus:
    """Write frames to a recording, losing none."""
    with SessionWriter(path, rig, **options) as writer:
        for frame in frames:
            assert writer.put(frame, wait=True)
    status = writer.close()
    assert status.error == ""
    return status


def list_source(frames: list[SensorFrame], rig: Rig = RIG, untouched: SensorFrame | None = None) -> FakeSource:
    """Return a recording of these frames."""
    return FakeSource(rig=rig, frames=frames, name="list", untouched=untouched)
