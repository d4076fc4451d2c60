"""A method of finding contact patches: one interface, and all that lists, tables and plots need to know of it.

Another package adds a method by an entry point of the group ``tactune.methods`` that names a `MethodKind`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..model.arrays import BoolArray, Float32Array
from ..model.frames import Rig, SensorFrame
from ..preset import Preset

#: Red, green and blue, 0 to 255.
RGB = tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class MethodPatch:
    """What a method found in one frame.

    Attributes
    ----------
    points : float32, shape (N, 3)
        Metres, proximity depth frame.
    make_mask : callable
        Computes `mask`.
    failure : str
        Why the method failed on this frame, as a sentence; empty if it did not.
    averaged_frames : int
        Number of frames over which depth was averaged, this one included.
    """

    points: Float32Array
    make_mask: Callable[[], BoolArray]
    failure: str = ""
    averaged_frames: int = 1

    @cached_property
    def mask(self) -> BoolArray:
        """Proximity pixels in contact, bool, shape (H, W); computed when first read."""
        return self.make_mask()


class ContactMethod(ABC):
    """Finds the contact patch of one frame after another.

    Attributes
    ----------
    name : str
        As in the command line and in tables.
    remembers : int
        Number of frames to process up to and including the one that is judged.
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


def pose_settings(preset: Preset) -> tuple[Any, ...]:
    """Return what of a preset decides where tactile points lie in the proximity frame."""
    return preset.alignment.rigid, preset.alignment.depth_scale, preset.alignment.depth_offset_m


@dataclass(frozen=True)
class MethodKind:
    """A method that can be chosen by name.

    Attributes
    ----------
    name : str
        Also the name of its entry point.
    tip : str
        One sentence for tooltips.
    rgb : tuple of int
        Its colour on a light background.
    make : callable
        Builds the method from a preset, a rig and the untouched frame, which is None if not needed.
    settings_of : callable
        Returns all of a preset that decides the method's patches: equal settings, equal patches.
    needs_untouched : bool
        Whether it compares with a frame of the untouched membrane.
    fields : mapping of str to object, or None
        The preset fields that it sets for the contact pipeline; None for a method that does not use the pipeline.
    dark_rgb : tuple of int, optional
        Its colour on a dark background; ``rgb`` by default.
    rank : int
        Position in lists, lower first; equal ranks are sorted by name.
    """

    name: str
    tip: str
    rgb: RGB
    make: Callable[[Preset, Rig, SensorFrame | None], ContactMethod]
    settings_of: Callable[[Preset], tuple[Any, ...]] = pose_settings
    needs_untouched: bool = False
    fields: Mapping[str, Any] | None = None
    dark_rgb: RGB | None = None
    rank: int = 100


def failed(shape: tuple[int, int], reason: str) -> MethodPatch:
    """Return an empty patch with the reason of the failure."""
    return MethodPatch(np.empty((0, 3), np.float32), lambda: np.zeros(shape, bool), reason)
