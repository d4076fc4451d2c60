"""Prediction of a click's partner in the other image."""

from __future__ import annotations

import numpy as np

from ...core.calibration.geometry import Alignment, color_lens, color_pose, moved, ray_seen
from ...core.model.alignment import Place
from ...core.model.arrays import Float64Array, IndexArray
from ...core.model.clouds import valid_depth
from ...core.model.frames import Rig, SensorFrame
from .pictures import tactile_depth_at
from .session import ProximityImage

_NEAREST_M, _FARTHEST_M, _STEPS = 0.08, 1.2, 480


def proximity_partner(
    alignment: Alignment, rig: Rig, frame: SensorFrame, image: ProximityImage, place: Place
) -> Place | None:
    """Predict the proximity pixel of a tactile pixel; None if that is not possible."""
    raw_m = tactile_depth_at(frame, rig, *place)
    in_color = image == "color" and rig.proximity_color is not None
    if raw_m is None and (in_color or alignment.pose is not None):
        return None
    shape = rig.proximity_color_shape if in_color else rig.proximity.intrinsics.shape
    return _inside(alignment.pixels(rig, [(*place, raw_m or 0.0)], in_color)[0], shape)


def tactile_partner(
    alignment: Alignment, rig: Rig, frame: SensorFrame, image: ProximityImage, place: Place
) -> Place | None:
    """Predict the tactile pixel of a pixel of a proximity image.

    The click's ray is followed until it intersects the membrane measured by the tactile camera.
    """
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


def clicked_ray(rig: Rig, image: ProximityImage, pixels: object, distances_m: Float64Array) -> Float64Array:
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
