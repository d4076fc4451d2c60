"""Two alignments compared: the tactile image laid over the proximity image, and the contact patch."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from ...core.calibration.geometry import Alignment, color_lens, color_pose, moved, proximity_pixels
from ...core.contact.pipeline import ContactPipeline
from ...core.errors import TactuneError
from ...core.model.arrays import BoolArray, Float32Array, Float64Array, Uint8Array
from ...core.model.clouds import valid_depth
from ...core.model.frames import Rig, SensorFrame
from ...core.preset import Preset
from ...widgets.basics.colormaps import Theme
from ...widgets.clouds.cloud_data import DepthCloud
from ..worker.rendering import Scene, membrane_sample_m, patch_view
from ..worker.results import ColorBy
from .pictures import picture
from .prediction import clicked_ray
from .session import ProximityImage

_FILL = (5, 5)
_BEHIND_M = 0.02


@dataclass(frozen=True, eq=False)
class Overlay:
    """Both images in proximity pixels, RGB32 (H, W, 4), and the mask where the tactile one is known."""

    proximity: Uint8Array
    tactile: Uint8Array
    known: BoolArray

    def blended(self, share: float) -> Uint8Array:
        """Blend both images; ``share`` is the weight of the tactile one, 0 to 1."""
        mixed = cv2.addWeighted(self.proximity, 1.0 - share, self.tactile, share, 0.0)
        return np.where(self.known[:, :, None], mixed, self.proximity).astype(np.uint8)


def make_overlay(alignment: Alignment, rig: Rig, frame: SensorFrame, image: ProximityImage) -> Overlay:
    """Warp the tactile image into a proximity image, colour onto colour or depth onto depth."""
    base = picture(frame, rig, "proximity", image, stretch=True)
    over = picture(frame, rig, "tactile", image, stretch=True)
    places, known = tactile_places(alignment, rig, frame, image)
    first, second = (np.ascontiguousarray(places[:, :, axis]) for axis in (0, 1))
    tactile = np.asarray(cv2.remap(over.pixels, first, second, cv2.INTER_LINEAR), dtype=np.uint8)
    return Overlay(base.pixels, tactile, known)


def tactile_places(
    alignment: Alignment, rig: Rig, frame: SensorFrame, image: ProximityImage
) -> tuple[Float32Array, BoolArray]:
    """Return the tactile pixel of every proximity pixel, float32 (H, W, 2), and the mask where there is one.

    The membrane measured by the tactile camera is first projected into the proximity image and its holes are filled
    from their surroundings. Every pixel is then projected back through the membrane's surface.
    """
    v, u = np.nonzero(valid_depth(frame.tactile_depth))
    raw_m = frame.tactile_depth[v, u] * rig.tactile.depth_unit_m
    depth_m = _splat(alignment.points_m(rig, np.column_stack([u, v, raw_m])), rig, image)
    known = np.isfinite(depth_m)
    places = np.full((*depth_m.shape, 2), -1.0, np.float32)
    if known.any():
        rows, columns = np.nonzero(known)
        pixels = np.column_stack([columns, rows]).astype(np.float64)
        points = clicked_ray(rig, image, pixels, depth_m[known].astype(np.float64))
        places[known] = alignment.tactile_pixels(rig, points)[0]
    return places, known


def _splat(points: Float64Array, rig: Rig, image: ProximityImage) -> Float32Array:
    """Return the distance along z of points (N, 3) in a proximity image, float32 (H, W); nan where no point is near."""
    height, width = color_lens(rig).shape if image == "color" else rig.proximity.intrinsics.shape
    pixels = np.rint(proximity_pixels(rig, points, image == "color"))
    inside = ((pixels >= 0) & (pixels < (width, height))).all(axis=1) & (points[:, 2] > 0)
    u, v = pixels[inside].astype(np.intp).T
    seen = moved(color_pose(rig), points[inside]) if image == "color" else points[inside]
    total, weight = np.zeros((height, width), np.float32), np.zeros((height, width), np.float32)
    total[v, u], weight[v, u] = seen[:, 2], 1.0
    blurred: Any = [cv2.boxFilter(part, -1, _FILL, normalize=False) for part in (total, weight)]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(blurred[1] > 0.5, blurred[0] / blurred[1], np.float32(np.nan)).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Patch:
    """The patch found with one alignment: its cloud and area, or the reason why there is none."""

    cloud: DepthCloud | None = None
    points: int = 0
    area_mm2: float = 0.0
    problem: str = ""


class PatchFinder:
    """Finds patches with one pipeline. Not thread-safe."""

    def __init__(self) -> None:
        self._pipeline: ContactPipeline | None = None

    def find(self, preset: Preset, rig: Rig, frame: SensorFrame, theme: Theme) -> Patch:
        """Return the patch of a frame; its cloud without points behind the membrane, so the view frames the sensor."""
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
        cloud = patch_view(Scene(frame, patch, preset, rig, ColorBy.CONTACT, theme, (near, far)))
        if cloud is not None:
            behind = cloud.depth > (far + _BEHIND_M) / cloud.depth_unit_m
            cloud = replace(cloud, depth=np.where(behind, np.uint16(0), cloud.depth))
        return Patch(cloud, len(patch.points), patch.area_mm2)
