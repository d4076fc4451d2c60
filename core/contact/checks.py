"""Checks of a preset: unusual combinations of fields, and whether it fits a rig."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import RigMismatchError
from ..model.frames import DepthCamera, Rig
from ..model.intrinsics import Intrinsics

if TYPE_CHECKING:
    from ..preset import Preset


def preset_notes(preset: Preset) -> list[str]:
    """Return sentences on combinations that work but are probably not intended; most presets give none."""
    note = preset.test.unmasked_note
    unmasked = [f"Preset {preset.name!r} {note}"] if note and not preset.mask.enabled else []
    return unmasked + homography_notes(preset)


def homography_notes(preset: Preset) -> list[str]:
    """Return a sentence if the contact test needs an alignment that is exact beyond one plane."""
    note = preset.test.homography_note
    return [f"Preset {preset.name!r} {note}"] if note and preset.alignment.model == "homography" else []


def _lens_difference(made_for: Intrinsics, found: Intrinsics) -> str:
    """Return the first field that differs by more than another driver's rounding, with both values; empty for none."""
    for field in Intrinsics.model_fields:
        before, now = getattr(made_for, field), getattr(found, field)
        same = before == now if field == "distortion" else np.allclose(before, now, rtol=1e-5, atol=1e-6)
        if not same:
            return f"{field} {before}, here {now}"
    return ""


def check_test(preset: Preset, rig: Rig) -> None:
    """Raise `RigMismatchError` if the contact test needs a camera that the rig does not have."""
    if preset.test.needs_proximity and not rig.has_proximity:
        raise RigMismatchError(
            f"the contact test {preset.contact_test} compares two cameras, and this rig has a tactile camera only; "
            "choose the contact test pressure, as by --set contact_test=pressure"
        )


def _other_cameras(made_for: Rig, rig: Rig) -> dict[str, str]:
    """Return how the depth cameras that both rigs have differ, by role; none that are alike."""
    found: dict[str, str] = {}
    for role in ("proximity", "tactile") if rig.has_proximity and made_for.has_proximity else ("tactile",):
        before, now = getattr(made_for, role), getattr(rig, role)
        same_camera = before.serial == now.serial or not (before.serial and now.serial)
        same_unit = before.depth_unit_m == now.depth_unit_m
        differences = (
            "" if same_camera else f"serial number {before.serial}, here {now.serial}",
            _lens_difference(before.intrinsics, now.intrinsics),
            "" if same_unit else f"depth unit {before.depth_unit_m:g} m, here {now.depth_unit_m:g} m",
        )
        if any(differences):
            found[role] = "; ".join(filter(None, differences))
    return found


def for_rig(preset: Preset, rig: Rig) -> Preset:
    """Return a preset for a rig, without what was measured on other cameras: untouched frame, noise, inflation."""
    before, values = preset.rig, dict[str, Any](rig=rig)
    if before is not None and (before.has_proximity != rig.has_proximity or _other_cameras(before, rig)):
        unknown = preset.pressure.model_copy(update={"gauge_pa": 0.0, "gauge_sigma_pa": 0.0})
        values |= {"untouched": None, "noise": None, "verdict": None, "pressure": unknown}
    return preset.model_copy(update=values)


def check_rig(preset: Preset, rig: Rig) -> list[str]:
    """Return how the rig differs from the preset's; `RigMismatchError` if sizes do, or the region is outside."""
    name, made_for, warnings = f"Preset {preset.name!r}", preset.rig, []
    if made_for is not None:
        for role, words in _other_cameras(made_for, rig).items():
            sizes = [_size(getattr(each, role)) for each in (made_for, rig)]
            if sizes[0] != sizes[1]:
                raise RigMismatchError(
                    f"preset {preset.name!r} was made for {role} images of {sizes[0]} pixels, this {role} camera "
                    f"gives {sizes[1]}; choose a preset of this rig or calibrate a new one"
                )
            check = "check the alignment" if rig.has_proximity else "set up this rig, or open its own preset"
            warnings.append(f"{name} was made for another {role} camera ({words}); {check}.")
        if rig.has_proximity and not made_for.has_proximity:
            warnings.append(f"{name} was made for a rig of one camera; calibrate the alignment.")
        color, color_now = made_for.proximity_color, rig.proximity_color  # they decide which colour a point gets
        same_color = color is color_now
        if color is not None and color_now is not None:
            same_color = not _lens_difference(color.intrinsics, color_now.intrinsics)
            same_color &= np.allclose(color.T_color_depth, color_now.T_color_depth, atol=1e-5)
        if rig.has_proximity and not same_color:
            warnings.append(f"{name} was made for another colour camera or another pose of it; check the mask.")
    left, top, _, _ = preset.region.rectangle
    camera = rig.proximity
    if preset.region.enabled and (left >= camera.intrinsics.width or top >= camera.intrinsics.height):
        raise RigMismatchError(
            f"region.rectangle starts at ({left}, {top}), outside the proximity image of {_size(camera)} pixels; "
            "move the region into the image"
        )
    return warnings + homography_notes(preset)


def _size(camera: DepthCamera) -> str:
    return f"{camera.intrinsics.width} x {camera.intrinsics.height}"
