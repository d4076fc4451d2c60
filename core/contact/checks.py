"""Checks of a preset: unusual combinations of fields, and whether it fits a rig."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..errors import RigMismatchError
from ..model.frames import DepthCamera, Rig
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

    def bent(before: Intrinsics, now: Intrinsics) -> Intrinsics:
        if now.has_distortion or not before.has_distortion:
            return now
        found = now.model_copy(update={"distortion": before.distortion, "coefficients": before.coefficients})
        return now if _lens_difference(before, found) else found

    def bent_if_same(before: DepthCamera, now: DepthCamera) -> Intrinsics:
        return bent(before.intrinsics, now.intrinsics) if _same_camera(before, now) else now.intrinsics

    before, now = made_for.proximity_color, rig.proximity_color
    color = None
    if now is not None:
        same = before is not None and _same_camera(made_for.proximity, rig.proximity)
        color = bent(before.intrinsics, now.intrinsics) if same and before is not None else now.intrinsics
    tactile, proximity = bent_if_same(made_for.tactile, rig.tactile), bent_if_same(made_for.proximity, rig.proximity)
    found = rig.with_lenses(tactile, proximity, color)
    return rig if found == rig else found


def _same_camera(made_for: DepthCamera, found: DepthCamera) -> bool:
    return made_for.serial == found.serial or not (made_for.serial and found.serial)


def _lens_difference(made_for: Intrinsics, found: Intrinsics) -> str:
    """Return the first field that differs by more than another driver's rounding; empty for none."""
    for field in Intrinsics.model_fields:
        before, now = getattr(made_for, field), getattr(found, field)
        same = before == now if field == "distortion" else np.allclose(before, now, rtol=1e-5, atol=1e-6)
        if not same:
            return field
    return ""


def check_rig(preset: Preset, rig: Rig) -> list[str]:
    """Return sentences on differences between the preset's rig and the present rig, and on their consequences.

    Raises
    ------
    RigMismatchError
        The image sizes differ, or the region of interest lies outside the image.
    """
    name, made_for, used = f"Preset {preset.name!r}", preset.rig, rig_in_use(preset, rig)
    warnings = []
    if used is not rig:
        warnings.append(
            f"{name} contains lens distortion that the source does not state; the preset's is used. "
            "Calibrate again if the source removes distortion itself."
        )
    if made_for is not None:
        for role in ("proximity", "tactile"):
            before, now = getattr(made_for, role), getattr(used, role)
            if before.intrinsics.shape != now.intrinsics.shape:
                raise RigMismatchError(
                    f"preset {preset.name!r} was made for {role} images of {_size(before)} pixels, this {role} camera "
                    f"gives {_size(now)}; choose a preset of this rig or calibrate a new one"
                )
            if not _same_camera(before, now):
                warnings.append(
                    f"{name} was made for the {role} camera {before.serial}, this one is {now.serial}; "
                    "check the alignment."
                )
            warnings += _compare_lenses(name, role, before.intrinsics, now.intrinsics)
            if before.depth_unit_m != now.depth_unit_m:
                warnings.append(
                    f"{name} was made for a {role} depth unit of {before.depth_unit_m:g} m, here it is "
                    f"{now.depth_unit_m:g} m; the rig's own is used."
                )
        color, color_now = made_for.proximity_color, used.proximity_color  # they decide which colour a point gets
        if color is not None and color_now is not None:
            warnings += _compare_lenses(name, "colour", color.intrinsics, color_now.intrinsics)
            if not np.allclose(color.T_color_depth, color_now.T_color_depth, atol=1e-5):
                warnings.append(
                    f"{name} was made for a colour camera that stood differently to the depth camera; check the mask."
                )
        elif color is not color_now:
            with_camera = "this rig" if color is None else "the rig it was made for"
            warnings.append(f"{name}: only {with_camera} has a separate colour camera; check the mask.")
    left, top, _, _ = preset.region.rectangle
    camera = rig.proximity
    if preset.region.enabled and (left >= camera.intrinsics.width or top >= camera.intrinsics.height):
        raise RigMismatchError(
            f"region.rectangle starts at ({left}, {top}), outside the proximity image of {_size(camera)} pixels; "
            "move the region into the image"
        )
    return warnings + homography_notes(preset)


def _compare_lenses(name: str, role: str, made_for: Intrinsics, found: Intrinsics) -> list[str]:
    field = _lens_difference(made_for, found)
    if not field:
        return []
    return [
        f"{name} was made for other {role} intrinsics ({field} {getattr(made_for, field)}, here "
        f"{getattr(found, field)}); check the alignment."
    ]


def _size(camera: DepthCamera) -> str:
    return f"{camera.intrinsics.width} x {camera.intrinsics.height}"
