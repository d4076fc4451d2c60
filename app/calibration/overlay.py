"""Two alignments compared: the tactile image laid over the proximity image, and the contact patch."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import cv2
import numpy as np

from ...core.contact.alignment import tactile_homography, tactile_pose
from ...core.contact.pipeline import ContactPipeline
from ...core.errors import TactuneError
from ...core.model.arrays import BoolArray, Float32Array, Float64Array, Uint8Array
from ...core.model.clouds import ray_table, valid_depth
from ...core.model.frames import Rig, SensorFrame
from ...core.preset import AlignmentSection, Preset
from ...widgets.basics.colormaps import CONTACT_RGB, Theme
from ...widgets.clouds.cloud_data import DepthCloud
from ..worker.rendering import Scene, membrane_sample_m, patch_view
from ..worker.results import ColorBy
from .pictures import picture
from .prediction import Alignment, project_into
from .session import ProximityImage

_FILL = (5, 5)
_SQUARE_PX = 40
_CANNY = (60, 140)


class OverlayMode(StrEnum):
    """How both images are combined."""

    BLEND = "Blend"
    CHECKER = "Checkerboard"
    BLINK = "Blink"
    EDGES = "Edges"


@dataclass(frozen=True, eq=False)
class Overlay:
    """Both images in proximity pixels, RGB32 (H, W, 4), and the mask where the tactile one is known."""

    proximity: Uint8Array
    tactile: Uint8Array
    known: BoolArray
    edges: BoolArray

    def composed(self, mode: OverlayMode, share: float, blinked: bool = False) -> Uint8Array:
        """Combine both images into one.

        Parameters
        ----------
        mode : OverlayMode
        share : float
            Weight of the tactile image in blending, 0 to 1.
        blinked : bool
            Whether blinking shows the tactile image now.
        """
        if mode is OverlayMode.BLEND:
            mixed = cv2.addWeighted(self.proximity, 1.0 - share, self.tactile, share, 0.0)
            return np.where(self.known[:, :, None], mixed, self.proximity).astype(np.uint8)
        if mode is OverlayMode.BLINK:
            return self.tactile if blinked else self.proximity
        if mode is OverlayMode.CHECKER:
            v, u = np.indices(self.known.shape)
            other = ((u // _SQUARE_PX + v // _SQUARE_PX) % 2 == 1) & self.known
            return np.where(other[:, :, None], self.tactile, self.proximity).astype(np.uint8)
        gray = cv2.cvtColor(cv2.cvtColor(self.proximity, cv2.COLOR_BGRA2GRAY), cv2.COLOR_GRAY2BGRA)
        drawn: Uint8Array = np.asarray(gray, dtype=np.uint8)
        drawn[self.edges] = (*CONTACT_RGB[::-1], 255)
        return drawn


def alignment_of_preset(section: AlignmentSection, rig: Rig) -> Alignment:
    """Return the alignment that a preset's section describes for a rig.

    Raises
    ------
    RigMismatchError
        The section takes the pose from the rig, but the rig has none.
    """
    if section.model == "rigid":
        return Alignment(pose=tactile_pose(section, rig), scale=section.depth_scale, offset_m=section.depth_offset_m)
    return Alignment(
        homography=tactile_homography(section, rig), scale=section.depth_scale, offset_m=section.depth_offset_m
    )


def make_overlay(alignment: Alignment, rig: Rig, frame: SensorFrame, image: ProximityImage) -> Overlay:
    """Warp the tactile image into a proximity image, colour onto colour or depth onto depth."""
    base = picture(frame, rig, "proximity", image, stretch=True)
    over = picture(frame, rig, "tactile", image, stretch=True)
    places, known = tactile_places(alignment, rig, frame, image)
    first, second = (np.ascontiguousarray(places[:, :, axis]) for axis in (0, 1))
    tactile = np.asarray(cv2.remap(over.pixels, first, second, cv2.INTER_LINEAR), dtype=np.uint8)
    gray = np.asarray(cv2.cvtColor(tactile, cv2.COLOR_BGRA2GRAY))
    edges = cv2.Canny(cv2.GaussianBlur(gray, (0, 0), 1.0), *_CANNY) > 0
    inner = cv2.erode(known.view(np.uint8), np.ones((7, 7), np.uint8)).astype(bool)
    return Overlay(base.pixels, tactile, known, np.asarray(edges & inner))


def tactile_places(
    alignment: Alignment, rig: Rig, frame: SensorFrame, image: ProximityImage
) -> tuple[Float32Array, BoolArray]:
    """Return the tactile pixel of every proximity pixel, float32 (H, W, 2), and the mask where there is one.

    The membrane measured by the tactile camera is first projected into the proximity image and its holes are filled
    from their surroundings. Every pixel is then projected back through the membrane's surface.
    """
    shape = rig.proximity_color_shape if image == "color" else rig.proximity.intrinsics.shape
    depth_m = _splat(_membrane_points(alignment, rig, frame), rig, image, shape)
    known = np.isfinite(depth_m)
    color = rig.proximity_color if image == "color" else None
    lens = rig.proximity.intrinsics if color is None else color.intrinsics
    seen = np.concatenate([ray_table(lens)[known] * depth_m[known, None], depth_m[known, None]], axis=1)
    points = seen.astype(np.float64)
    if color is not None:
        T_depth_color = np.linalg.inv(np.asarray(color.T_color_depth))
        points = points @ T_depth_color[:3, :3].T + T_depth_color[:3, 3]
    places = np.full((*shape, 2), -1.0, np.float32)
    if len(points):
        places[known] = _seen_by_tactile(alignment, rig, points)
    return places, known


def _membrane_points(alignment: Alignment, rig: Rig, frame: SensorFrame) -> Float64Array:
    """Return the membrane's points in the proximity depth frame (N, 3), metres."""
    counts = frame.tactile_depth
    valid = valid_depth(counts)
    depth_m = alignment.scale * counts[valid] * rig.tactile.depth_unit_m + alignment.offset_m
    if alignment.pose is not None:
        rays = ray_table(rig.tactile.intrinsics)[valid].astype(np.float64)
        points = np.column_stack([rays * depth_m[:, None], depth_m])
        return np.asarray(points @ alignment.pose[:3, :3].T + alignment.pose[:3, 3])
    assert alignment.homography is not None
    v, u = np.nonzero(valid)
    mapped = np.column_stack([u, v, np.ones(len(u))]) @ alignment.homography.T
    rays = rig.proximity.intrinsics.normalise(mapped[:, :2] / mapped[:, 2:])
    return np.column_stack([rays * depth_m[:, None], depth_m])


def _seen_by_tactile(alignment: Alignment, rig: Rig, points: Float64Array) -> Float64Array:
    if alignment.pose is not None:
        T_t_p = np.linalg.inv(alignment.pose)
        return rig.tactile.intrinsics.project(points @ T_t_p[:3, :3].T + T_t_p[:3, 3])
    assert alignment.homography is not None
    flat = rig.proximity.intrinsics.project(points)
    mapped = np.column_stack([flat, np.ones(len(flat))]) @ np.linalg.inv(alignment.homography).T
    return np.asarray(mapped[:, :2] / mapped[:, 2:])


def _splat(points: Float64Array, rig: Rig, image: ProximityImage, shape: tuple[int, int]) -> Float32Array:
    """Return the distance along z of points (N, 3) in a proximity image, float32 (H, W); nan where no point is near."""
    height, width = shape
    pixels = np.rint(project_into(points, rig, image))
    inside = ((pixels >= 0) & (pixels < (width, height))).all(axis=1) & (points[:, 2] > 0)
    u, v = pixels[inside].astype(np.intp).T
    distance = points[inside, 2]
    if image == "color" and rig.proximity_color is not None:
        T_color_depth = np.asarray(rig.proximity_color.T_color_depth)
        distance = points[inside] @ T_color_depth[2, :3] + T_color_depth[2, 3]
    total, weight = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    total[v, u], weight[v, u] = distance, 1.0
    blurred: Any = [cv2.boxFilter(part, -1, _FILL, normalize=False) for part in (total, weight)]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(blurred[1] > 0.5, blurred[0] / blurred[1], np.float32(np.nan)).astype(np.float32)


_BEHIND_M = 0.02


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
    """Drop points behind the membrane, so that the view frames the sensor."""
    if cloud is None:
        return None
    farthest = (far_m + _BEHIND_M) / cloud.depth_unit_m
    return replace(cloud, depth=np.where(cloud.depth > farthest, np.uint16(0), cloud.depth))
