"""Checks of a preset: unusual combinations of fields, and whether it fits a rig."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..errors import RigMismatchError
from ..model.frames import ColorCamera, DepthCamera, Rig
from ..model.intrinsics import Intrinsics

if TYPE_CHECKING:
    from ..preset import Preset


def preset_notes(preset: Preset) -> list[str]:
    """Return sentences on combinations that work but are probably not intended; most presets give none."""
    return mask_notes(preset) + homography_notes(preset)


def mask_notes(preset: Preset) -> list[str]:
    """Return a sentence if the contact test needs the mask and the preset has it turned off."""
    note = preset.test.unmasked_note
    return [] if preset.mask.enabled or not note else [f"Preset {preset.name!r} {note}"]


def homography_notes(preset: Preset) -> list[str]:
    """Return a sentence if the contact test needs an alignment that is exact beyond one plane."""
    note = preset.test.homography_note
    return [] if preset.alignment.model != "homography" or not note else [f"Preset {preset.name!r} {note}"]


def rig_in_use(preset: Preset, rig: Rig) -> Rig:
    """Return the present rig with the lens distortion that the preset's calibration estimated.

    A lens of the preset's rig replaces the present one if the present one has no distortion and nothing else differs;
    `check_rig` says so.
    """
    made_for = preset.rig
    if made_for is None or not any(lens.has_distortion for lens in made_for.lenses()):
        return rig
    lenses = {role: _with_distortion(getattr(made_for, role), getattr(rig, role)) for role in ("tactile", "proximity")}
    before, now = made_for.proximity_color, rig.proximity_color
    color = None
    if now is not None:
        same = before is not None and _same_camera(made_for.proximity, rig.proximity)
        color = _distorted(before.intrinsics, now.intrinsics) if same and before is not None else now.intrinsics
    found = rig.with_lenses(lenses["tactile"], lenses["proximity"], color)
    return rig if found == rig else found


def _with_distortion(made_for: DepthCamera, found: DepthCamera) -> Intrinsics:
    same = _same_camera(made_for, found)
    return _distorted(made_for.intrinsics, found.intrinsics) if same else found.intrinsics


def _same_camera(made_for: DepthCamera, found: DepthCamera) -> bool:
    return made_for.serial == found.serial or not (made_for.serial and found.serial)


def _distorted(made_for: Intrinsics, found: Intrinsics) -> Intrinsics:
    if found.has_distortion or not made_for.has_distortion:
        return found
    changes = {"distortion": made_for.distortion, "coefficients": made_for.coefficients}
    bent = found.model_copy(update=changes)
    return bent if not _lens_difference(made_for, bent) else found


def check_rig(preset: Preset, rig: Rig) -> list[str]:
    """Return sentences on differences between the preset's rig and the present rig, and on their consequences.

    Raises
    ------
    RigMismatchError
        The image sizes differ, or the region of interest lies outside the image.
    """
    stated, warnings = rig, []
    rig = rig_in_use(preset, stated)
    if rig is not stated:
        warnings.append(
            f"Preset {preset.name!r} contains lens distortion that the source does not state; the preset's is used. "
            "Calibrate again if the source removes distortion itself."
        )
    if preset.rig is not None:
        for role in ("proximity", "tactile"):
            warnings += _compare(preset.name, role, getattr(preset.rig, role), getattr(rig, role))
        warnings += _compare_color(preset.name, preset.rig.proximity_color, rig.proximity_color)
    _check_region(preset, rig)
    return warnings + homography_notes(preset)


def _compare(name: str, role: str, made_for: DepthCamera, found: DepthCamera) -> list[str]:
    if made_for.intrinsics.shape != found.intrinsics.shape:
        raise RigMismatchError(
            f"preset {name!r} was made for {role} images of {_size(made_for)} pixels, "
            f"this {role} camera gives {_size(found)}; choose a preset of this rig or calibrate a new one"
        )
    warnings = []
    if made_for.serial and found.serial and made_for.serial != found.serial:
        warnings.append(
            f"Preset {name!r} was made for the {role} camera {made_for.serial}, this one is {found.serial}; "
            "check the alignment."
        )
    warnings += _compare_lenses(name, role, made_for.intrinsics, found.intrinsics)
    if made_for.depth_unit_m != found.depth_unit_m:
        warnings.append(
            f"Preset {name!r} was made for a {role} depth unit of {made_for.depth_unit_m:g} m, here it is "
            f"{found.depth_unit_m:g} m; the rig's own is used."
        )
    return warnings


def _compare_lenses(name: str, role: str, made_for: Intrinsics, found: Intrinsics) -> list[str]:
    """Return one sentence on the first field that differs by more than another driver's rounding."""
    field = _lens_difference(made_for, found)
    if not field:
        return []
    return [
        f"Preset {name!r} was made for other {role} intrinsics ({field} {getattr(made_for, field)}, here "
        f"{getattr(found, field)}); check the alignment."
    ]


def _lens_difference(made_for: Intrinsics, found: Intrinsics) -> str:
    """Return the first field that differs by more than another driver's rounding; empty for none."""
    for field in Intrinsics.model_fields:
        before, now = getattr(made_for, field), getattr(found, field)
        same = before == now if field == "distortion" else np.allclose(before, now, rtol=1e-5, atol=1e-6)
        if not same:
            return field
    return ""


def _compare_color(name: str, made_for: ColorCamera | None, found: ColorCamera | None) -> list[str]:
    """Return sentences on the proximity colour camera: it decides which colour a point gets."""
    if made_for is None and found is None:
        return []
    if made_for is None or found is None:
        with_camera = "this rig" if made_for is None else "the rig it was made for"
        return [f"Preset {name!r}: only {with_camera} has a separate colour camera; check the mask."]
    warnings = _compare_lenses(name, "colour", made_for.intrinsics, found.intrinsics)
    if not np.allclose(made_for.T_color_depth, found.T_color_depth, atol=1e-5):
        warnings.append(
            f"Preset {name!r} was made for a colour camera that stood differently to the depth camera; check the mask."
        )
    return warnings


def _size(camera: DepthCamera) -> str:
    return f"{camera.intrinsics.width} x {camera.intrinsics.height}"


def _check_region(preset: Preset, rig: Rig) -> None:
    left, top, _, _ = preset.region.rectangle
    camera = rig.proximity
    if preset.region.enabled and (left >= camera.intrinsics.width or top >= camera.intrinsics.height):
        raise RigMismatchError(
            f"region.rectangle starts at ({left}, {top}), outside the proximity image of {_size(camera)} pixels; "
            "move the region into the image"
        )
