"""What suggestions and findings are made of: evidence, proposals and findings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ...model.frames import Rig, SensorFrame
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
    """

    preset: Preset
    rig: Rig
    frames: tuple[SensorFrame, ...]
    untouched: SensorFrame | None = None

    @property
    def frame(self) -> SensorFrame:
        return self.frames[-1]
