"""Whether what is captured as the untouched membrane is untouched, as far as a preset can tell."""

from __future__ import annotations

from dataclasses import dataclass

from ..contact.pipeline import ContactPipeline
from ..errors import CalibrationError, FrameError, RigMismatchError
from ..model.frames import Rig, SensorFrame
from ..preset import Preset
from .drift import compare_with_untouched


@dataclass(frozen=True)
class TouchDoubt:
    """Why something seems to touch the membrane.

    Attributes
    ----------
    sentence : str
    certain : bool
        False where something else than a touch explains it as well.
    """

    sentence: str
    certain: bool


def touch_doubts(preset: Preset, rig: Rig, membrane: SensorFrame, earlier: SensorFrame | None) -> list[TouchDoubt]:
    """Return what speaks against a membrane that is said to be untouched; nothing where all is well.

    Parameters
    ----------
    preset : Preset
        Its pipeline should find no patch.
    rig : Rig
    membrane : SensorFrame
        One frame, or the median of several.
    earlier : SensorFrame or None
        The preset's present untouched frame.

    Raises
    ------
    FrameError
        The membrane is of another rig.
    """
    try:
        patch = ContactPipeline(preset, rig).process(membrane)
    except RigMismatchError:  # a preset for another sensor can tell nothing
        return []
    doubts = []
    if len(patch.points):
        found = f"the preset finds a contact patch of {patch.area_mm2 / 100:.1f} cm2 on what should be untouched"
        doubts.append(
            TouchDoubt(f"{found}; take away what touches the membrane or is close to it, and capture again", True)
            if preset.mask.enabled
            else TouchDoubt(f"{found}; that may be its prints, since the mask is off, or something touches it", False)
        )
    if earlier is not None and (dent := _dent(preset, rig, membrane, earlier)):
        doubts.append(TouchDoubt(dent, False))
    return doubts


def _dent(preset: Preset, rig: Rig, membrane: SensorFrame, earlier: SensorFrame) -> str:
    try:
        drift = compare_with_untouched(preset, rig, membrane, earlier)
    except (CalibrationError, FrameError):  # of another sensor, or blind: nothing to learn from it
        return ""
    if drift.verdict != "touched":
        return ""
    return (
        "in places the membrane is over 3 mm from where the preset's present untouched frame has it; one of both is "
        "touched"
    )
