"""What suggestions and findings are made of: evidence, proposals and findings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import AdviceError, FrameError
from ...model.arrays import BoolArray
from ...model.files import atomic_path
from ...model.frames import Rig, SensorFrame
from ...model.loading import frame_arrays, frame_from_bytes, parse_npz, read_file
from ...preset import Preset


@dataclass(frozen=True)
class Proposal:
    """A change of fields of one section, or of ``"all"``: new values by path, label, evidence, expected effect."""

    section: str
    changes: Mapping[str, Any]
    label: str
    evidence: str
    expected: str

    def apply(self, preset: Preset) -> Preset:
        """Return the preset with the changes; raise a `PresetError` if it does not allow a value."""
        return preset.with_values(dict(self.changes))


@dataclass(frozen=True)
class Finding:
    """Something wrong with frame or preset in a sentence, the field beside which it is shown, and what helps."""

    name: str
    field: str
    sentence: str
    proposal: Proposal | None = None
    action: str = ""
    explains_empty: bool = False


@dataclass(frozen=True, eq=False)
class Example:
    """A frame, and its proximity pixels in contact, bool (H, W); None if nothing touches the membrane."""

    frame: SensorFrame
    contact: BoolArray | None = None

    @property
    def mask(self) -> BoolArray:
        """The pixels in contact, (H, W); none if nothing touches."""
        return np.zeros(self.frame.proximity_depth.shape, bool) if self.contact is None else self.contact

    def save(self, path: Path) -> None:
        """Write an ``.npz`` with the images and the contact; raise an `ExportError` if that fails."""
        contact = {} if self.contact is None else {"contact": self.contact}
        with atomic_path(path) as temporary:
            np.savez(temporary, allow_pickle=False, **frame_arrays(self.frame), **contact)

    @classmethod
    def load(cls, path: Path) -> Example:
        """Read an example; raise an `AdviceError` if it is missing or damaged, or its contact does not fit."""
        try:
            data = read_file(path)
            frame, stored = frame_from_bytes(data), parse_npz(data)
        except (OSError, ValueError, FrameError) as error:
            raise AdviceError(f"{path}: the example cannot be read ({error}); mark it again") from error
        contact = stored.get("contact")
        fits = contact is None or (contact.dtype == np.bool_ and contact.shape == frame.proximity_depth.shape)
        if not fits or "known" in stored:  # earlier versions stored which pixels of a painted contact were known
            raise AdviceError(f"{path}: the contact of the example is no mask of the whole frame; mark it again")
        return cls(frame, contact)


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
        return self.frames[-1]

    @property
    def all_examples(self) -> tuple[Example, ...]:
        """The examples, the untouched frame among them."""
        return self.examples if self.untouched is None else (*self.examples, Example(self.untouched))

    @property
    def marked(self) -> list[tuple[SensorFrame, BoolArray]]:
        """Frames with marked contact, and the pixels of it."""
        return [(example.frame, example.contact) for example in self.examples if example.contact is not None]
