"""The headless core: what a robot program calls. Never imports Qt or OpenGL.

``from tactune.core import ContactPipeline, load_preset, open_source``. Names are imported when first used, so that
reading a preset does not load the compiled kernels.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .calibration import calibrate, read_points
    from .contact.pipeline import ContactPipeline
    from .errors import TactuneError
    from .estimation.pose import PoseTracker
    from .estimation.tilt import TiltEstimator
    from .model.frames import Rig, SensorFrame
    from .model.patch import ContactPatch
    from .output.publisher import Publisher
    from .output.writer import SessionWriter
    from .preset import Preset
    from .preset.file import save_preset
    from .rig.noise import measure_noise
    from .sources.presets import load_preset
    from .sources.registry import open_source
    from .tuning.advice.proposal import Evidence
    from .tuning.advice.suggest import suggest_all

_HOME = {
    "ContactPatch": ".model.patch",
    "ContactPipeline": ".contact.pipeline",
    "Evidence": ".tuning.advice.proposal",
    "PoseTracker": ".estimation.pose",
    "Preset": ".preset",
    "Publisher": ".output.publisher",
    "Rig": ".model.frames",
    "SensorFrame": ".model.frames",
    "SessionWriter": ".output.writer",
    "TactuneError": ".errors",
    "TiltEstimator": ".estimation.tilt",
    "calibrate": ".calibration",
    "load_preset": ".sources.presets",
    "measure_noise": ".rig.noise",
    "open_source": ".sources.registry",
    "read_points": ".calibration",
    "save_preset": ".preset.file",
    "suggest_all": ".tuning.advice.suggest",
}

__all__ = [
    "ContactPatch",
    "ContactPipeline",
    "Evidence",
    "PoseTracker",
    "Preset",
    "Publisher",
    "Rig",
    "SensorFrame",
    "SessionWriter",
    "TactuneError",
    "TiltEstimator",
    "calibrate",
    "load_preset",
    "measure_noise",
    "open_source",
    "read_points",
    "save_preset",
    "suggest_all",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name], __name__), name)
