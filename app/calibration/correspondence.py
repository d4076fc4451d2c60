"""Where the pixels of one image lie in the other: the partner of a click, and one image laid over the other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from ...core.calibration.geometry import Alignment, color_lens, color_pose, moved, proximity_pixels, ray_seen
from ...core.model.alignment import Place
from ...core.model.arrays import BoolArray, Float32Array, Float64Array, IndexArray, Uint8Array
from ...core.model.clouds import valid_depth
from ...core.model.frames import Rig, SensorFrame
from .pictures import picture
from .session import ImageChoice, tactile_depth

_NEAREST_M, _FARTHEST_M, _STEPS = 0.08, 1.2, 480
_FILL = (5, 5)


def proximity_partner(
    alignment: Alignment, rig: Rig, frame: SensorFrame, image: ImageChoice, place: Place
) -> Place | None:
    """Predict the proximity pixel of a tactile pixel; None if that is not possible."""
    raw_m = tactile_depth(frame, rig, *place)
    in_color = image == "color" and rig.proximity_color is not None
    if raw_m is None and (in_color or alignment.pose is not None):
        return None
    shape = rig.proximity_color_shape if in_color else rig.proximity.intrinsics.shape
    return _inside(alignment.pixels(rig, [(*place, raw_m or 0.0)], in_color)[0], shape)


def tactile_partner(
    alignment: Alignment, rig: Rig, frame: SensorFrame, image: ImageChoice, place: Place
) -> Place | None:
    """Predict a tactile pixel: where the proximity pixel's ray meets the membrane by the tactile camera."""
    points = clicked_ray(rig, image, [place], np.linspace(_NEAREST_M, _FARTHEST_M, _STEPS))
    pixels, depth_m = alignment.tactile_pixels(rig, points)
    shape = rig.tactile.intrinsics.shape
    if alignment.pose is None and (image == "depth" or rig.proximity_color is None):
        return _inside(pixels[0], shape)
    beyond = depth_m - _membrane_m(frame, rig, alignment, pixels)
    crossing = np.flatnonzero((beyond[:-1] <= 0) & (beyond[1:] > 0))
    if len(crossing) == 0:
        return None
    first = int(crossing[0])
    share = -beyond[first] / (beyond[first + 1] - beyond[first])
    return _inside(pixels[first] + share * (pixels[first + 1] - pixels[first]), shape)


def clicked_ray(rig: Rig, image: ImageChoice, pixels: object, distances_m: Float64Array) -> Float64Array:
    """Return the points (N, 3) of the proximity depth frame at distances (N,) behind one pixel, or behind N pixels."""
    lens = color_lens(rig) if image == "color" else rig.proximity.intrinsics
    rays = ray_seen(lens, pixels)  # type: ignore[arg-type]
    points = np.column_stack([rays * distances_m[:, None], distances_m])
    return moved(np.linalg.inv(color_pose(rig)), points) if image == "color" else points


def _membrane_m(frame: SensorFrame, rig: Rig, alignment: Alignment, pixels: Float64Array) -> Float64Array:
    """Return the corrected tactile depth at pixels, nan where there is none."""
    height, width = frame.tactile_depth.shape
    nearest: IndexArray = np.clip(np.rint(pixels), -1, [width, height]).astype(np.intp)
    u, v = nearest.T
    inside = (u >= 0) & (v >= 0) & (u < width) & (v < height)
    counts = frame.tactile_depth[np.where(inside, v, 0), np.where(inside, u, 0)]
    depth_m = alignment.scale * counts * rig.tactile.depth_unit_m + alignment.offset_m
    return np.where(inside & valid_depth(counts), depth_m, np.nan)


def _inside(place: Float64Array, shape: tuple[int, int]) -> Place | None:
    u, v = float(place[0]), float(place[1])
    return (u, v) if -0.5 <= u <= shape[1] - 0.5 and -0.5 <= v <= shape[0] - 0.5 else None


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


def make_overlay(alignment: Alignment, rig: Rig, frame: SensorFrame, image: ImageChoice) -> Overlay:
    """Warp the tactile image, colour or depth, into a proximity image by way of the membrane's surface."""
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
    over = picture(frame, rig, "tactile", image).pixels
    first, second = (np.ascontiguousarray(places[:, :, axis]) for axis in (0, 1))
    tactile = np.asarray(cv2.remap(over, first, second, cv2.INTER_LINEAR), dtype=np.uint8)
    return Overlay(picture(frame, rig, "proximity", image).pixels, tactile, known)


def _splat(points: Float64Array, rig: Rig, image: ImageChoice) -> Float32Array:
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
