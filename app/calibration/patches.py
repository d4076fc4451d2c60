"""The fused patch under two alignments, for two clouds beside each other."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...core.contact.pipeline import ContactPipeline
from ...core.errors import TactuneError
from ...core.model.frames import Rig, SensorFrame
from ...core.preset import Preset
from ...widgets.basics.colormaps import Theme
from ...widgets.clouds.cloud_data import DepthCloud
from ..worker.rendering import Scene, membrane_sample_m, patch_view
from ..worker.results import ColorBy

_BEHIND_M = 0.02


@dataclass(frozen=True, eq=False)
class Patch:
    """What one alignment finds: a cloud, its area, or why there is none."""

    cloud: DepthCloud | None = None
    points: int = 0
    area_mm2: float = 0.0
    problem: str = ""


class PatchFinder:
    """Keeps one pipeline and finds patch after patch; not for two threads at once."""

    def __init__(self) -> None:
        self._pipeline: ContactPipeline | None = None

    def find(self, preset: Preset, rig: Rig, frame: SensorFrame, theme: Theme) -> Patch:
        """Return the patch of a frame."""
        try:
            if self._pipeline is None:
                self._pipeline = ContactPipeline(preset, rig)
            elif self._pipeline.preset is not preset:
                self._pipeline.update(preset)
            patch = self._pipeline.process(frame)
        except TactuneError as error:
            self._pipeline = None
            return Patch(problem=str(error))
        sample_m = membrane_sample_m(frame, preset, rig)
        near, far = (float(sample_m.min()), float(sample_m.max()) + 1e-3) if len(sample_m) else (0.0, 1.0)
        scene = Scene(frame, patch, preset, rig, ColorBy.CONTACT, theme, (near, far))
        return Patch(_near_part(patch_view(scene), far), len(patch.points), patch.area_mm2)


def _near_part(cloud: DepthCloud | None, far_m: float) -> DepthCloud | None:
    """Leave out the room behind the membrane, so that the view frames the sensor."""
    if cloud is None:
        return None
    farthest = (far_m + _BEHIND_M) / cloud.depth_unit_m
    return replace(cloud, depth=np.where(cloud.depth > farthest, np.uint16(0), cloud.depth))
