"""The preset: everything a person calibrates and tunes, as one strict, frozen model.

Each field carries its bounds, its unit and a sentence on what it does; the sliders of the GUI, the
JSON Schema and the messages for bad values are all made from these.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated, Any, Literal

from pydantic import Field

from ..model.frames import Rig
from .alignment import AlignmentSection, HomographyAlignment, RigidAlignment
from .cameras import CameraSection, CamerasSection
from .contact import MaskSection, MembraneSection, OutlierSection, RangeSection, RegionSection, ToleranceSection
from .fields import Section, described

__all__ = [
    "AlignmentSection",
    "MembraneSection",
    "CameraSection",
    "CamerasSection",
    "HomographyAlignment",
    "MaskSection",
    "OutlierSection",
    "Preset",
    "RangeSection",
    "UntouchedRecord",
    "RegionSection",
    "RigidAlignment",
    "ToleranceSection",
    "now",
]


class UntouchedRecord(Section):
    """The untouched membrane: averaged frames in a file beside the preset."""

    file: Annotated[
        str,
        described("File", "Name of the file in the preset's own folder.", hidden=True),
        Field(min_length=1, max_length=255, pattern=r"^[^/\\]+$"),
    ]
    sha256: Annotated[
        str,
        described("Hash", "SHA-256 of the images in it, so that no other file is taken for it.", hidden=True),
        Field(pattern=r"^[0-9a-f]{64}$"),
    ]
    frames: Annotated[
        int, described("Frames", "How many frames were averaged.", unit="frames", hidden=True), Field(ge=1, le=100_000)
    ]


def now() -> datetime:
    """Return the present moment in UTC, to the second, as presets store it."""
    return datetime.now(UTC).replace(microsecond=0)


class Preset(Section):
    """All that a person calibrates and tunes, plus the rig that it was made for.

    ``rig`` is None for a preset that serves any rig. `tactune.core.preset.file` loads and saves it.
    """

    name: Annotated[str, Field(min_length=1, max_length=120)] = "untitled"
    notes: Annotated[str, Field(max_length=10_000)] = ""
    created: datetime = Field(default_factory=now)
    modified: datetime = Field(default_factory=now)
    rig: Rig | None = None
    alignment: AlignmentSection = AlignmentSection()
    contact_test: Annotated[
        Literal["tolerance", "membrane"],
        described(
            "Contact test",
            "tolerance: a pixel is in contact where both distances agree within t, as published. membrane: local "
            "means of the difference tell much smaller gaps apart, and the rim that is only near is taken away.",
        ),
    ] = "tolerance"
    mask: MaskSection = MaskSection(enabled=False)
    tolerance: ToleranceSection = ToleranceSection()
    outliers: OutlierSection = OutlierSection()
    membrane: MembraneSection = MembraneSection()
    range: RangeSection = RangeSection()
    region: RegionSection = RegionSection()
    cameras: CamerasSection = CamerasSection()
    untouched: Annotated[
        UntouchedRecord | None,
        described(
            "Untouched frame",
            "The untouched membrane, which some methods and the drift check compare with. Empty: not captured.",
            hidden=True,
        ),
    ] = None

    def with_value(self, path: str, value: Any) -> Preset:
        """Return a copy with one field changed, validated as a whole.

        Parameters
        ----------
        path : str
            Dotted path of the field, such as ``"mask.hue"``.
        value : object
            Anything that the field accepts.

        Raises
        ------
        PresetError
            No such field, or a value that it does not allow; the message names both.
        """
        return self.with_values({path: value})

    def with_values(self, values: dict[str, Any]) -> Preset:
        """Return a copy with several fields changed at once; see `with_value`."""
        from .file import parse_preset, set_path

        data = self.model_dump(mode="python")
        for path, value in values.items():
            set_path(data, path, value)
        return parse_preset(data, origin="preset")

    def value(self, path: str) -> Any:
        """Return the field at a dotted path, such as ``"tolerance.t"``."""
        target: Any = self
        for part in path.split("."):
            target = getattr(target, part)
        return target
