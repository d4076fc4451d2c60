"""A small scene with known truth, for the tables of an evaluation."""

from __future__ import annotations

import numpy as np

from rigs import one_place_rig
from tactune.core.model.frames import GroundTruth, SensorFrame
from tactune.core.sources import SeekableSource

RIG = one_place_rig(64, 48, 60.0, tactile_unit_m=0.00025)
CONTACT = np.zeros((48, 64), bool)
CONTACT[10:30, 10:40] = True


class SmallScene(SeekableSource):
    """A flat contact 0.3 m away, none if its name says that it hovers; the seed moves nothing."""

    def __init__(self, name: str) -> None:
        super().__init__(name, RIG, length=6)
        self.contact = CONTACT & ("hover" not in name)

    def read(self, index: int) -> SensorFrame:
        counts = np.full((48, 64), 1200, np.uint16)
        truth = GroundTruth(self.contact, np.full((48, 64), 0.3, np.float32))
        return SensorFrame(index, counts, counts, np.zeros((48, 64, 3), np.uint8), truth=truth)
