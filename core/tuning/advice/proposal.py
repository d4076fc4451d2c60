"""What suggestions and findings are made of: evidence, proposals and findings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import AdviceError, FrameError
from ...model.arrays import BoolArray, Uint8Array
from ...model.files import atomic_path
from ...model.frames import Rig, SensorFrame
from ...model.loading import parse_npz, read_file
from ...model.untouched_archive import frame_arrays, frame_from_bytes
from ...preset import Preset

_MASKS = ("contact", "known")


class MaskLabel(IntEnum):
    """What a proposed mask does to one proximity pixel of the frame that it was made from."""

    UNKNOWN = 0
    #: The proximity camera looks through the membrane, and the mask keeps the pixel.
    BARE = 1
    #: A print that reflects infrared, and the mask misses it.
    MISSED = 2
    #: A print that the mask covers.
    COVERED = 3
    #: The proximity camera looks through the membrane, but the mask drops the pixel.
    LOST = 4


@dataclass(frozen=True)
class Proposal:
    """A change of some preset fields.

    Attributes
    ----------
    section : str
        The section of the preset that it belongs to, such as ``"mask"``; ``"all"`` for several.
    changes : dict of str to object
        New value by dotted path, such as ``{"alignment.depth_offset_m": 0.0159}``. Empty if the present values are
        already those that follow from the evidence.
    label : str
        What it does, short enough for a button and the Edit menu, such as ``"Depth offset +15.9 mm"``.
    evidence : str
        What was measured, as one sentence.
    expected : str
        What it will change, as one sentence.
    weak : bool
        Whether it follows from the rig's noise alone, without examples of contact, or a mask from a pressed frame.
    picture : uint8, shape (H, W), or None
        `MaskLabel` of each proximity pixel, for a proposed mask.
    """

    section: str
    changes: Mapping[str, Any]
    label: str
    evidence: str
    expected: str
    weak: bool = False
    picture: Uint8Array | None = field(default=None, compare=False)

    def apply(self, preset: Preset) -> Preset:
        """Return the preset with the changes; raise a `PresetError` if it does not allow a value."""
        return preset.with_values(dict(self.changes))


@dataclass(frozen=True)
class Finding:
    """Something that is wrong with the present frame or preset.

    Attributes
    ----------
    name : str
        Name of the check that found it.
    field : str
        Dotted path of the field or section beside which it is shown.
    sentence : str
        What is wrong, with its number.
    proposal : Proposal or None
        The change that mends it.
    action : str
        Name of the window's action that helps if there is no proposal, such as ``"check_cameras"``; empty for none.
    explains_empty : bool
        Whether it explains why no contact is found.
    """

    name: str
    field: str
    sentence: str
    proposal: Proposal | None = None
    action: str = ""
    explains_empty: bool = False


@dataclass(frozen=True, eq=False)
class Example:
    """A frame with known contact.

    Attributes
    ----------
    frame : SensorFrame
    contact : (H, W) bool array or None
        The proximity pixels in contact; None if nothing touches the membrane.
    known : (H, W) bool array or None
        The proximity pixels whose ``contact`` is known; None for all.
    """

    frame: SensorFrame
    contact: BoolArray | None = None
    known: BoolArray | None = None

    @property
    def known_contact(self) -> BoolArray:
        """The pixels of known contact, (H, W)."""
        if self.contact is None:
            return np.zeros(self.frame.proximity_depth.shape, bool)
        return self.contact if self.known is None else self.contact & self.known

    def save(self, path: Path) -> None:
        """Write an ``.npz`` with the images and masks; raise an `ExportError` if that fails."""
        masks = {name: mask for name in _MASKS if (mask := getattr(self, name)) is not None}
        with atomic_path(path) as temporary:
            np.savez(temporary, allow_pickle=False, **frame_arrays(self.frame), **masks)

    @classmethod
    def load(cls, path: Path) -> Example:
        """Read an example; raise an `AdviceError` if it is missing or damaged, or a mask does not fit the frame."""
        try:
            data = read_file(path)
            frame, stored = frame_from_bytes(data), parse_npz(data)
        except (OSError, ValueError, FrameError) as error:
            raise AdviceError(f"{path}: the example cannot be read ({error}); mark it again") from error
        masks: dict[str, BoolArray] = {name: stored[name] for name in _MASKS if name in stored}
        for name, mask in masks.items():
            if mask.dtype != np.bool_ or mask.shape != frame.proximity_depth.shape:
                raise AdviceError(
                    f"{path}: {name} is {mask.dtype} {mask.shape}, not a bool mask of the frame's "
                    f"{frame.proximity_depth.shape} pixels; mark the example again"
                )
        return cls(frame, masks.get("contact"), masks.get("known"))


@dataclass(frozen=True, eq=False)
class Evidence:
    """What proposals are made from.

    Attributes
    ----------
    preset : Preset
        The present preset.
    rig : Rig
    frames : tuple of SensorFrame
        The newest frames, the present one last; at least one.
    untouched : SensorFrame or None
        A frame of the untouched membrane.
    examples : tuple of Example
    """

    preset: Preset
    rig: Rig
    frames: tuple[SensorFrame, ...]
    untouched: SensorFrame | None = None
    examples: tuple[Example, ...] = ()

    @property
    def frame(self) -> SensorFrame:
        """The present frame."""
        return self.frames[-1]

    @property
    def all_examples(self) -> tuple[Example, ...]:
        """The examples, the untouched frame among them."""
        return self.examples if self.untouched is None else (*self.examples, Example(self.untouched))

    @property
    def marked(self) -> list[tuple[SensorFrame, BoolArray]]:
        """Frames with marked contact, and the pixels of it."""
        return [(example.frame, example.known_contact) for example in self.examples if example.contact is not None]
