"""Tell whether a preset belongs to the rig at hand."""

from __future__ import annotations

from .errors import RigMismatchError
from .frames import DepthCamera, Rig
from .intrinsics import Intrinsics
from .preset import Preset


def check_rig(preset: Preset, rig: Rig) -> list[str]:
    """Return sentences on what differs between the preset's rig and the one at hand.

    Raises
    ------
    RigMismatchError
        The image sizes differ, so that the preset cannot mean the same pixels, or the region of
        interest lies outside the image.
    """
    warnings = []
    if preset.rig is not None:
        for role in ("proximity", "tactile"):
            warnings += _compare(preset.name, role, getattr(preset.rig, role), getattr(rig, role))
    _check_region(preset, rig)
    return warnings


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
    for field in Intrinsics.model_fields:
        before, now = getattr(made_for.intrinsics, field), getattr(found.intrinsics, field)
        if before != now:
            warnings.append(
                f"Preset {name!r} was made for other {role} intrinsics ({field} {before}, here {now}); "
                "check the alignment."
            )
            break
    if made_for.depth_unit_m != found.depth_unit_m:
        warnings.append(
            f"Preset {name!r} was made for a {role} depth unit of {made_for.depth_unit_m:g} m, here it is "
            f"{found.depth_unit_m:g} m; the rig's own is used."
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
