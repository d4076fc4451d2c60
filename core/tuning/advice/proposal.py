"""A proposed change of the preset, with its evidence; a finding that says what is wrong with the present frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

from ...model.arrays import BoolArray, Uint8Array
from ...model.frames import Rig, SensorFrame
from ...preset import Preset


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
        """Return the preset with the changes.

        Raises
        ------
        PresetError
            The preset does not allow a value.
        """
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
