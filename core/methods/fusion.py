"""The contact pipeline as methods: one for each variant that a contact test names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..contact.pipeline import ContactPipeline
from ..model.frames import Rig, SensorFrame
from ..preset import CONTACT_TESTS, Preset
from .method import ContactMethod, MethodKind, MethodPatch, pose_settings


@dataclass(frozen=True)
class FusionVariant:
    """A choice of preset fields that is a method of its own; see `MethodKind`."""

    name: str
    fields: Mapping[str, Any]
    tip: str
    rgb: tuple[int, int, int]


_VARIANTS = (
    FusionVariant(
        "fusion-membrane",
        {"contact_test": "membrane", "alignment.model": "rigid", "membrane.frames": 1},
        "Both cameras: where a membrane in equilibrium of tension and pressure touches the object",
        (0, 158, 115),
    ),
    FusionVariant(
        "fusion-averaged",
        {"contact_test": "membrane", "alignment.model": "rigid", "membrane.frames": 15},
        "fusion-membrane on the mean of up to 15 frames while the membrane is still",
        (119, 68, 255),
    ),
    FusionVariant(
        "fusion-rigid",
        {"contact_test": "tolerance", "alignment.model": "rigid"},
        "Contact where both cameras measure the same distance, aligned by the tactile camera's pose",
        (213, 94, 0),
    ),
    FusionVariant(
        "fusion-homography",
        {"contact_test": "tolerance", "alignment.model": "homography"},
        "Contact where both cameras measure the same distance, aligned by a homography as published",
        (230, 159, 0),
    ),
)


class Fusion(ContactMethod):
    """The contact pipeline with some preset fields set, as one method among others.

    Parameters
    ----------
    preset : Preset
    rig : Rig
    name : str
    values : mapping of str to object
        Fields of the preset by their paths.

    Raises
    ------
    RigMismatchError
        As `ContactPipeline` does.
    """

    def __init__(self, preset: Preset, rig: Rig, name: str, values: Mapping[str, Any]) -> None:
        self.name = name
        self._values = values
        self._pipeline = ContactPipeline(preset.with_values(dict(values)), rig)
        self.remembers = self._pipeline.preset.averaged_frames

    def update(self, preset: Preset) -> None:
        """Use another preset; results that do not depend on the changed fields stay cached.

        Raises
        ------
        RigMismatchError
            As the constructor does; the old preset then stays in use.
        """
        self._pipeline.update(preset.with_values(dict(self._values)))
        self.remembers = self._pipeline.preset.averaged_frames

    def find(self, frame: SensorFrame) -> MethodPatch:
        """Return the pipeline's patch."""
        patch = self._pipeline.process(frame)
        return MethodPatch(patch.points, lambda: patch.mask, averaged_frames=patch.averaged_frames)


def fusion_kinds() -> dict[str, MethodKind]:
    """Return the variants of the pipeline."""
    return {variant.name: _kind_of(variant) for variant in _VARIANTS}


def _kind_of(variant: FusionVariant) -> MethodKind:
    fields = variant.fields
    homography = fields["alignment.model"] == "homography"
    test = CONTACT_TESTS[fields["contact_test"]]
    sections, by_noise = tuple(test.sections), any("noise" in fields for fields in test.steps.values())

    def make(preset: Preset, rig: Rig, untouched: SensorFrame | None) -> ContactMethod:
        return Fusion(preset, rig, variant.name, fields)

    def settings_of(preset: Preset) -> tuple[Any, ...]:
        by_plane = (preset.alignment.homography,) if homography else ()
        noise = (preset.noise,) if by_noise else ()
        own = [_with_fields(getattr(preset, section), section, fields) for section in sections]
        return (preset.rig, *pose_settings(preset), *by_plane, preset.region, preset.range, preset.mask, *noise, *own)

    return MethodKind(variant.name, variant.tip, variant.rgb, make, settings_of, fields=fields, rank=0)


def _with_fields(section: Any, name: str, fields: Mapping[str, Any]) -> Any:
    """Return a section of a preset with the fields that belong to it changed."""
    start = f"{name}."
    own = {path.removeprefix(start): value for path, value in fields.items() if path.startswith(start)}
    return section.model_copy(update=own)
