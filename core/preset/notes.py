"""What a preset can be used with but is probably not meant."""

from __future__ import annotations

from .preset import Preset


def preset_notes(preset: Preset) -> list[str]:
    """Return sentences on what can be used but is probably not meant; most presets give none."""
    return mask_notes(preset) + homography_notes(preset)


def mask_notes(preset: Preset) -> list[str]:
    """Return a sentence where the membrane test goes without the mask, which also tells it the cameras' bias."""
    if preset.contact_test != "membrane" or preset.mask.enabled:
        return []
    return [
        f"Preset {preset.name!r} makes the membrane test without the mask, so parts of the membrane that reflect "
        "infrared, such as prints, pass as contact; set mask.hue, mask.saturation and mask.value to their colour."
    ]


def homography_notes(preset: Preset) -> list[str]:
    """Return a sentence where the membrane test goes with a homography, which is exact on one plane only."""
    if preset.contact_test != "membrane" or preset.alignment.model != "homography":
        return []
    return [
        f"Preset {preset.name!r} tests contact by gaps of a millimetre, which a homography tells on one plane "
        "only; choose the rigid alignment, or the tolerance test."
    ]
