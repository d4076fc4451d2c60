"""The headless core: presets, the contact pipeline, sources. Never imports Qt.

What a robot program needs is here: ``from tactune.core import ContactPipeline, load_preset, open_source``.
Names are imported when first used, so that reading a preset does not load the compiled kernels.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .contact.pipeline import ContactPatch, ContactPipeline
    from .errors import TactuneError
    from .estimation.pose import PoseTracker
    from .estimation.tilt import TiltEstimator
    from .model.frames import Rig, SensorFrame
    from .model.provenance import Provenance
    from .preset import Preset
    from .preset.file import save_preset
    from .sources.presets import load_preset
    from .sources.registry import open_source

_HOME = {
    "ContactPatch": ".model.patch",
    "ContactPipeline": ".contact.pipeline",
    "PoseTracker": ".estimation.pose",
    "Preset": ".preset",
    "Provenance": ".model.provenance",
    "Rig": ".model.frames",
    "SensorFrame": ".model.frames",
    "TactuneError": ".errors",
    "TiltEstimator": ".estimation.tilt",
    "load_preset": ".sources.presets",
    "open_source": ".sources.registry",
    "save_preset": ".preset.file",
}

__all__ = [
    "ContactPatch",
    "ContactPipeline",
    "PoseTracker",
    "Preset",
    "Provenance",
    "Rig",
    "SensorFrame",
    "TactuneError",
    "TiltEstimator",
    "load_preset",
    "open_source",
    "save_preset",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name], __name__), name)
