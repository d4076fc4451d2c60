"""Draws the image strip of a frame, on the worker thread, at the resolution that the screen shows."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from ...core.contact.masking import colors_at, in_hsv_range
from ...core.contact.pipeline import ContactPatch
from ...core.model.arrays import BoolArray, Float32Array, IndexArray, Uint8Array
from ...core.model.clouds import ray_table, valid_depth
from ...core.model.frames import Rig, SensorFrame
from ...core.model.intrinsics import Intrinsics
from ...core.preset import Preset
from ...widgets.images.strip_render import RenderedStrip, StripImages, render_strip, stride_for


def draw_strip(
    frame: SensorFrame,
    patch: ContactPatch | None,
    preset: Preset,
    rig: Rig,
    depth_range_m: tuple[float, float],
    *,
    accepted: float,
    width_hint: int,
) -> RenderedStrip:
    """Return the four panes, with both sides of the tolerance test as depths, so that they compare.

    ``accepted`` is the relative difference that counts as none, ``width_hint`` is how many screen pixels an
    image takes across; 0 draws all pixels.
    """
    typical_m = (depth_range_m[0] + depth_range_m[1]) / 2
    height, width = frame.proximity_depth.shape
    stride = stride_for(width, width_hint)
    every = np.s_[::stride, ::stride]
    counts = frame.proximity_depth[every]
    valid = valid_depth(counts)
    depth_m = counts * np.float32(rig.proximity.depth_unit_m)
    color = aligned_color(frame, rig, depth_m, valid, typical_m, stride)
    nothing = np.full(counts.shape, np.nan, np.float32)
    images = StripImages(
        color=color,
        mask_overlay=in_hsv_range(color, preset.mask) if preset.mask.enabled else None,
        proximity_m=np.where(valid, depth_m, nothing) if patch is None else patch.aligned.expected_m[every],
        tactile_m=nothing if patch is None else patch.aligned.measured_m[every],
        relative=nothing if patch is None else patch.relative_difference[every],
        tolerance=accepted,
        contact=None if patch is None else patch.mask[every],
        depth_range_m=depth_range_m,
    )
    return replace(render_strip(images), size=(width, height), stride=stride)


def aligned_color(
    frame: SensorFrame,
    rig: Rig,
    depth_m: Float32Array,
    valid: BoolArray,
    typical_m: float,
    stride: int = 1,
) -> Uint8Array:
    """Return the proximity colour in every ``stride``-th proximity depth pixel: uint8 (h, w, 3).

    A pixel without a depth is looked up at ``typical_m``, which shows the picture almost in place;
    where the colour camera does not see, the picture is black.
    """
    if rig.proximity_color is None:
        return frame.proximity_color[::stride, ::stride]
    rays = _rays_of_every(rig.proximity.intrinsics, stride)
    points = np.empty((*depth_m.shape, 3), np.float32)
    points[..., 2] = np.where(valid, depth_m, np.float32(typical_m))
    np.multiply(rays, points[..., 2:], out=points[..., :2])
    pixels = _pixels(depth_m.size)
    colors, _ = colors_at(points.reshape(-1, 3), pixels, frame.proximity_color, rig)
    return colors.reshape(*depth_m.shape, 3)


@lru_cache(maxsize=8)
def _rays_of_every(intrinsics: Intrinsics, stride: int) -> Float32Array:
    return np.ascontiguousarray(ray_table(intrinsics)[::stride, ::stride])


@lru_cache(maxsize=8)
def _pixels(count: int) -> IndexArray:
    return np.arange(count)
