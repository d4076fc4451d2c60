"""The headless core: what a robot program calls. Never imports Qt or OpenGL.

``from tactune.core import ContactPipeline, load_preset, open_source``. Names are imported when first used, so that
reading a preset does not load the compiled kernels.
"""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

# OpenCV reads these when it is loaded. A damaged JPEG of 1 kB may claim gigapixels, which it would fill with grey.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(2**26))
os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")  # messages of ours say what is wrong with an image
os.environ.setdefault("OPENCV_THREAD_POOL_ACTIVE_WAIT_WORKER", "0")  # else its threads keep cores busy between calls

if TYPE_CHECKING:
    from .calibration.calibrate import calibrate as calibrate
    from .calibration.points import read_points as read_points
    from .contact.pipeline import ContactPipeline as ContactPipeline
    from .errors import TactuneError as TactuneError
    from .estimation.pose import PoseTracker as PoseTracker
    from .estimation.tilt import TiltEstimator as TiltEstimator
    from .model.frames import Rig as Rig
    from .model.frames import SensorFrame as SensorFrame
    from .model.patch import ContactPatch as ContactPatch
    from .output.publisher import Publisher as Publisher
    from .output.writer import SessionWriter as SessionWriter
    from .preset import Preset as Preset
    from .preset.file import save_preset as save_preset
    from .rig.noise import measure_noise as measure_noise
    from .rig.untouched import find_untouched as find_untouched
    from .rig.untouched import kept_untouched as kept_untouched
    from .sources.presets import load_preset as load_preset
    from .sources.registry import open_source as open_source
    from .tuning.advice.proposal import Evidence as Evidence
    from .tuning.advice.suggest import suggest_all as suggest_all

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
    "calibrate": ".calibration.calibrate",
    "find_untouched": ".rig.untouched",
    "kept_untouched": ".rig.untouched",
    "load_preset": ".sources.presets",
    "measure_noise": ".rig.noise",
    "open_source": ".sources.registry",
    "read_points": ".calibration.points",
    "save_preset": ".preset.file",
    "suggest_all": ".tuning.advice.suggest",
}

__all__ = list(_HOME)  # the type checker sees the imports above


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name], __name__), name)
