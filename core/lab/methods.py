"""The methods that are compared: settings of the contact pipeline, and rivals as plain functions.

A rival is a function from a preset, a rig and a frame of the untouched membrane to the function that finds the contact
patch of a frame. Another package adds one by an entry point of the group ``tactune.methods``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from ..contact.pipeline import ContactPipeline
from ..errors import TactuneError
from ..model.frames import Rig, SensorFrame
from ..model.patch import ContactPatch
from ..model.plugins import added_by_others
from ..preset import Preset
from .single_camera import Find, pressure, proximity_only, tactile_only

MakeRival = Callable[[Preset, Rig, SensorFrame], Find]

#: The paper's method: homography alignment and the paper's tolerance.
STRAIGHT: Final = "straight"
MEMBRANE: Final = "fusion-membrane"
AVERAGED: Final = "fusion-averaged"
PRESSURE: Final = "pressure"
#: Methods that use the measured noise of a rig.
OF_NOISE: Final = (MEMBRANE, AVERAGED, PRESSURE)

#: Contact pipelines by name: the preset fields that each sets.
PIPELINES: Final[dict[str, dict[str, Any]]] = {
    STRAIGHT: {"contact_test": "tolerance", "alignment.model": "homography", "tolerance.t": 0.03},
    "fusion-rigid": {"contact_test": "tolerance", "alignment.model": "rigid"},
    "fusion-homography": {"contact_test": "tolerance", "alignment.model": "homography"},
    MEMBRANE: {"contact_test": "membrane", "alignment.model": "rigid", "membrane.frames": 1},
    AVERAGED: {"contact_test": "membrane", "alignment.model": "rigid", "membrane.frames": 15},
}

_GROUP: Final = "tactune.methods"


def mechanics(preset: Preset, rig: Rig, untouched: SensorFrame) -> Find:
    """Tactile camera: where something must press to explain the membrane's shape, by an elastic model."""
    from .mechanics import MembraneMechanics  # its solver is in the extra lab

    return MembraneMechanics(preset, rig, untouched).find


RIVALS: Final[dict[str, MakeRival]] = {
    "proximity-only": proximity_only,
    "tactile-only": tactile_only,
    "mechanics": mechanics,
    PRESSURE: pressure,
}


def patch_area_mm2(patch: ContactPatch) -> float:
    """Return a patch's area, projected on the plane across the optical axis: its pixels at the mean square depth."""
    if len(patch.points) == 0:
        return 0.0
    lens = patch.rig.proximity.intrinsics
    square_m2 = float(np.mean(np.square(patch.points[:, 2], dtype=np.float64)))
    return float(1e6 * np.count_nonzero(patch.mask) * square_m2 / (lens.fx * lens.fy))


def _added() -> tuple[dict[str, MakeRival], dict[str, str]]:
    return added_by_others(_GROUP, Callable)


def method_names() -> tuple[str, ...]:
    """Return the names that `make_method` knows, pipelines first."""
    return (*PIPELINES, *RIVALS, *(name for name in _added()[0] if name not in RIVALS))


def check_methods(names: Sequence[str], known: Sequence[str] | None = None) -> None:
    """Raise a `TactuneError` unless each name is one of the known ones, by default all."""
    known, problems = method_names() if known is None else known, _added()[1]
    for name in names:
        if name in problems:
            raise TactuneError(problems[name])
        if name not in known:
            raise TactuneError(f"there is no method {name!r}; known are {', '.join(known)}")


def make_method(name: str, preset: Preset, rig: Rig, untouched: SensorFrame | None = None) -> Find:
    """Build a method by its name; raises a `TactuneError` where there is none or it lacks an untouched frame."""
    check_methods([name])
    if name in PIPELINES:
        return ContactPipeline(preset.with_values(PIPELINES[name]), rig, untouched).process
    if untouched is None:
        raise TactuneError(f"{name} needs an untouched frame; capture one while nothing touches the membrane")
    return {**_added()[0], **RIVALS}[name](preset, rig, untouched)
