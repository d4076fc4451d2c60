"""The methods by name, as the command line, tables and the application offer them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from ..contact.pipeline import ContactPipeline
from ..errors import TactuneError
from ..model.frames import Rig, SensorFrame
from ..preset import CONTACT_TESTS, Preset
from .mechanics import MembraneMechanics
from .method import ContactMethod, MethodPatch
from .proximity_only import ProximityOnly
from .tactile_only import TactileOnly


class Fusion(ContactMethod):
    """The contact pipeline with some of the preset's fields set, which make it one method among others.

    Parameters
    ----------
    preset : Preset
    rig : Rig
    name : str
    values : dict of str to object
        Fields of the preset by their paths.

    Raises
    ------
    RigMismatchError
        As `ContactPipeline` does.
    """

    def __init__(self, preset: Preset, rig: Rig, name: str, values: dict[str, Any]) -> None:
        self.name = name
        self._values = values
        self._pipeline = ContactPipeline(preset.with_values(values), rig)
        self.remembers = self._pipeline.preset.averaged_frames

    def update(self, preset: Preset) -> None:
        """Take another preset, without making anew what does not depend on what has changed.

        Raises
        ------
        RigMismatchError
            As the constructor does; the old preset then stays in force.
        """
        self._pipeline.update(preset.with_values(self._values))
        self.remembers = self._pipeline.preset.averaged_frames

    def find(self, frame: SensorFrame) -> MethodPatch:
        """Return the pipeline's patch."""
        patch = self._pipeline.process(frame)
        return MethodPatch(patch.points, lambda: patch.mask, averaged_frames=patch.averaged_frames)


def method_names() -> tuple[str, ...]:
    """Return the names that `make_method` knows, fusion first."""
    return (*FUSION_FIELDS, *_AGAINST_UNTOUCHED)


def needs_untouched(name: str) -> bool:
    """Return whether a method compares with a frame of the untouched membrane."""
    return name in _AGAINST_UNTOUCHED


def settings_of(name: str, preset: Preset) -> tuple[Any, ...]:
    """Return all of a preset that decides what a method finds: where it is equal, so are the patches.

    Parameters
    ----------
    name : str
        One of `method_names`.
    preset : Preset
    """
    alignment = preset.alignment
    pose = alignment.rigid, alignment.depth_scale, alignment.depth_offset_m
    if name not in FUSION_FIELDS:
        return pose
    values = FUSION_FIELDS[name]
    by_plane = (alignment.homography,) if values["alignment.model"] == "homography" else ()
    own = []
    for section in CONTACT_TESTS[values["contact_test"]].section_names:
        start = f"{section}."
        fixed = {path.removeprefix(start): value for path, value in values.items() if path.startswith(start)}
        own.append(getattr(preset, section).model_copy(update=fixed))
    return (preset.rig, *pose, *by_plane, preset.region, preset.range, preset.mask, *own)


def make_method(name: str, preset: Preset, rig: Rig, untouched: SensorFrame | None = None) -> ContactMethod:
    """Build a method by its name.

    Parameters
    ----------
    name : str
        One of `method_names`.
    preset : Preset
    rig : Rig
    untouched : SensorFrame, optional
        The inflated, untouched membrane; every method but fusion needs it.

    Raises
    ------
    TactuneError
        There is no such method, the untouched frame is missing, or the method cannot work with these.
    """
    if name in FUSION_FIELDS:
        return Fusion(preset, rig, name, FUSION_FIELDS[name])
    if name not in _AGAINST_UNTOUCHED:
        raise TactuneError(f"there is no method {name!r}; known are {', '.join(method_names())}")
    if untouched is None:
        raise TactuneError(
            f"{name} compares with the untouched membrane, but there is no untouched frame; "
            "capture one while nothing touches the membrane"
        )
    return _AGAINST_UNTOUCHED[name](preset, rig, untouched)


#: Which of the preset's fields each way of fusion sets.
FUSION_FIELDS: dict[str, dict[str, Any]] = {
    variant.name: dict(variant.fields) for test in CONTACT_TESTS.values() for variant in test.variants
}
_AGAINST_UNTOUCHED: dict[str, Callable[[Preset, Rig, SensorFrame], ContactMethod]] = {
    "proximity-only": ProximityOnly,
    "tactile-only": partial(TactileOnly, rule="share"),
    "tactile-threshold": partial(TactileOnly, rule="threshold"),
    "mechanics": MembraneMechanics,
}
