"""Where the pixels of one image lie in the other: the partner of a click, and one image laid over the other."""

from __future__ import annotations

import cv2
import numpy as np

from ...core.calibration.geometry import Alignment, color_lens, color_pose, moved, ray_seen
from ...core.model.alignment import Place
from ...core.model.arrays import Float64Array, IndexArray, Uint8Array
from ...core.model.clouds import valid_depth
from ...core.model.frames import Rig, SensorFrame
from .pictures import picture
from .session import ImageChoice, tactile_depth

_NEAREST_M, _FARTHEST_M, _STEPS = 0.08, 1.2, 480


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
    in_color = image == "color" and rig.proximity_color is not None
    lens, pose = (color_lens(rig), color_pose(rig)) if in_color else (rig.proximity.intrinsics, np.eye(4))
    distances_m = np.linspace(_NEAREST_M, _FARTHEST_M, _STEPS)[:, None]
    points = moved(np.linalg.inv(pose), np.column_stack([ray_seen(lens, [place]) * distances_m, distances_m]))
    pixels, depth_m = alignment.tactile_pixels(rig, points)
    shape = rig.tactile.intrinsics.shape
    if alignment.pose is None and not in_color:
        return _inside(pixels[0], shape)
    beyond = depth_m - _membrane_m(frame, rig, alignment, pixels)
    crossing = np.flatnonzero((beyond[:-1] <= 0) & (beyond[1:] > 0))
    if len(crossing) == 0:
        return None
    first = int(crossing[0])
    share = -beyond[first] / (beyond[first + 1] - beyond[first])
    return _inside(pixels[first] + share * (pixels[first + 1] - pixels[first]), shape)


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


def overlay(alignment: Alignment, rig: Rig, frame: SensorFrame, image: ImageChoice) -> tuple[Uint8Array, Uint8Array]:
    """Return the tactile image, colour or depth, and the same where the proximity image lies over it, RGB32 (H, W, 4).

    The membrane's surface tells which pixel lies over which: without tactile depth there is none.
    """
    known, counts = valid_depth(frame.tactile_depth), frame.tactile_depth
    places = alignment.lookup(rig, np.where(known, counts * rig.tactile.depth_unit_m, np.nan), image == "color")
    places[~known] = -9.0  # outside
    below, over = (picture(frame, rig, side, image).pixels for side in ("tactile", "proximity"))
    both = cv2.remap(
        over, places[..., 0], places[..., 1], cv2.INTER_LINEAR, below.copy(), borderMode=cv2.BORDER_TRANSPARENT
    )
    return below, np.asarray(both, np.uint8)
