"""A tiny rig and flat scenes with a known contact, for recordings that every command can read."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fakes import FakeSource
from rigs import one_place_rig
from tactune.core.model.frames import GroundTruth, Rig, SensorFrame

UNIT_M = 0.00025
MEMBRANE_M = 0.3


def small_rig(width: int, serial: str = "1") -> Rig:
    return one_place_rig(width, 48, 60.0, UNIT_M, serial=serial)


def _press(
    index: int, rig: Rig, side: slice, gap_m: float, with_truth: bool, noise_m: npt.ArrayLike = 0.0
) -> SensorFrame:
    """Return a frame of a flat membrane at 300 mm and an object that touches it in a square, with a gap around it."""
    shape = rig.proximity.intrinsics.shape
    contact = np.zeros(shape, bool)
    contact[side, side] = True
    depth_m = MEMBRANE_M + np.where(contact, 0.0, gap_m) + noise_m
    return SensorFrame(
        sequence=index,
        proximity_depth=np.rint(depth_m / UNIT_M).astype(np.uint16),
        tactile_depth=np.full(shape, round(MEMBRANE_M / rig.tactile.depth_unit_m), np.uint16),
        proximity_color=np.full((*shape, 3), 90, np.uint8),
        truth=GroundTruth(contact, np.full(shape, MEMBRANE_M, np.float32)) if with_truth else None,
    )


def growing_press(rig: Rig, length: int, with_truth: bool) -> FakeSource:
    """Contact is a square that grows from nothing, frame by frame; around it a gap of 60 mm."""

    def make(index: int, rig: Rig) -> SensorFrame:
        return _press(index, rig, slice(8, 8 + 8 * index), 0.06, with_truth)

    return FakeSource(length, rig, make=make, name="small")


def noisy_press(seed: int, rig: Rig, length: int, with_truth: bool) -> FakeSource:
    """Contact is a square; around it a gap of 3.5 mm; noise of 1 mm. A tolerance of about 0.007 tells both apart."""

    def make(index: int, rig: Rig) -> SensorFrame:
        noise_m = np.random.default_rng([seed, index]).normal(0, 0.001, rig.proximity.intrinsics.shape)
        return _press(index, rig, slice(8, 40), 0.0035, with_truth, noise_m)

    return FakeSource(length, rig, make=make, name="small")
