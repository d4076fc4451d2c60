"""One interface for every way to find a contact patch."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..model.arrays import BoolArray, Float32Array
from ..model.frames import SensorFrame


@dataclass(frozen=True, eq=False)
class MethodPatch:
    """What a method found in one frame.

    Attributes
    ----------
    points : float32, shape (N, 3)
        Metres, proximity depth frame.
    failure : str
        Why the method gave up on this frame, as a sentence; empty where it did not.
    averaged_frames : int
        Over how many frames the depths were averaged, this one included.
    """

    points: Float32Array
    make_mask: Callable[[], BoolArray]
    failure: str = ""
    averaged_frames: int = 1

    @cached_property
    def mask(self) -> BoolArray:
        """Proximity pixels in contact, bool, shape (H, W); made when first asked for."""
        return self.make_mask()


class ContactMethod(ABC):
    """Finds the contact patch of one frame after another, in a way of its own.

    Attributes
    ----------
    name : str
        As the command line and tables write it.
    remembers : int
        How many frames should be shown before, and with, one that is judged.
    """

    name: str
    remembers: int = 1

    @abstractmethod
    def find(self, frame: SensorFrame) -> MethodPatch:
        """Return the contact patch of a frame.

        Raises
        ------
        FrameError
            An image does not have the rig's size.
        """


def failed(shape: tuple[int, int], reason: str) -> MethodPatch:
    """Return an empty patch with the reason why there is none."""
    return MethodPatch(np.empty((0, 3), np.float32), lambda: np.zeros(shape, bool), reason)
