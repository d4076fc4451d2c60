"""A tiny rig and flat scenes with a known contact, for recordings that every command can read."""

from __future__ import annotations

import numpy as np

from rigs import one_place_rig
from tactune.core.model.frames import GroundTruth, Rig, SensorFrame
from tactune.core.sources import SeekableSource

UNIT_M = 0.00025
MEMBRANE_M = 0.3


def small_rig(width: int, serial: str = "1") -> Rig:
    return one_place_rig(width, 48, 60.0, UNIT_M, serial=serial)


class FlatPress(SeekableSource):
    """A flat membrane at 300 mm, and an object that touches it where a subclass says."""

    def __init__(self, rig: Rig, length: int, with_truth: bool) -> None:
        super().__init__("small", rig, length)
        self._with_truth = with_truth

    def press(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        """Return where the object touches in a frame, and its depth in metres."""
        raise NotImplementedError

    def read(self, index: int) -> SensorFrame:
        contact, depth_m = self.press(index)
        shape = contact.shape
        return SensorFrame(
            sequence=index,
            proximity_depth=np.rint(depth_m / UNIT_M).astype(np.uint16),
            tactile_depth=np.full(shape, round(MEMBRANE_M / self.rig.tactile.depth_unit_m), np.uint16),
            proximity_color=np.full((*shape, 3), 90, np.uint8),
            truth=GroundTruth(contact, np.full(shape, MEMBRANE_M, np.float32)) if self._with_truth else None,
        )


class GrowingPress(FlatPress):
    """Contact is a square that grows from nothing, frame by frame; around it a gap of 60 mm."""

    def press(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        contact = np.zeros(self.rig.proximity.intrinsics.shape, bool)
        contact[8 : 8 + 8 * index, 8 : 8 + 8 * index] = True
        return contact, np.where(contact, MEMBRANE_M, 0.36)


class NoisyPress(FlatPress):
    """Contact is a square; around it a gap of 3.5 mm; noise of 1 mm.

    A tolerance of about 0.007 tells both apart best.
    """

    def __init__(self, seed: int, rig: Rig, length: int, with_truth: bool) -> None:
        super().__init__(rig, length, with_truth)
        self._seed = seed

    def press(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        contact = np.zeros(self.rig.proximity.intrinsics.shape, bool)
        contact[8:40, 8:40] = True
        noise_m = np.random.default_rng([self._seed, index]).normal(0, 0.001, contact.shape)
        return contact, np.where(contact, MEMBRANE_M, 0.3035) + noise_m
