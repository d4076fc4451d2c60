"""The images that are clicked in: colour, depth or relief of a snapshot, for the screen and for snapping."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot

import cv2
import numpy as np

from ...core.calibration.detect import Snapped, snap_to_feature
from ...core.calibration.snapshots import depth_under
from ...core.model.alignment import Place, Side
from ...core.model.arrays import AnyArray, Float32Array, Float64Array, Uint8Array
from ...core.model.clouds import valid_depth
from ...core.model.frames import Rig, SensorFrame
from ...widgets.basics.colormaps import depth_lut
from ...widgets.images.strip_render import NO_VALUE_RGB
from .session import ImageChoice

_RELIEF_SIGMA_PX = 9.0
_RELIEF_LIMIT_M = 0.002


@dataclass(frozen=True, eq=False)
class Picture:
    """One image: pixels (H, W, 4) as ``QImage.Format_RGB32``, and grey (H, W), in which snapping searches."""

    pixels: Uint8Array
    gray: Uint8Array


def image_choices(frame: SensorFrame, side: Side) -> tuple[ImageChoice, ...]:
    """Return the images that one side of a frame has."""
    if side == "tactile" and frame.tactile_color is None:
        return ("depth", "relative")
    return ("color", "depth", "relative")


def picture(frame: SensorFrame, rig: Rig, side: Side, choice: ImageChoice, stretch: bool) -> Picture:
    """Return the image of one side. A choice that is not available is replaced by the first one."""
    choices = image_choices(frame, side)
    choice = choice if choice in choices else choices[0]
    if choice == "color":
        color = frame.proximity_color if side == "proximity" else frame.tactile_color
        assert color is not None
        return _color_picture(color, stretch)
    counts = frame.proximity_depth if side == "proximity" else frame.tactile_depth
    camera = rig.proximity if side == "proximity" else rig.tactile
    depth_m = np.where(valid_depth(counts), counts * np.float32(camera.depth_unit_m), np.float32(np.nan))
    return _depth_picture(depth_m, stretch) if choice == "depth" else _relief_picture(depth_m, stretch)


def tactile_depth_at(frame: SensorFrame, rig: Rig, u: float, v: float) -> float | None:
    """Return the raw tactile depth in metres at a pixel, from its neighbourhood; None without depth."""
    return depth_under(frame.tactile_depth, rig.tactile.depth_unit_m, u, v)


def membrane_grid(frame: SensorFrame, rig: Rig, step: int) -> Float64Array:
    """Return (u, v, raw depth in metres) of every ``step``-th tactile pixel with a depth: float64 (M, 3)."""
    v, u = np.mgrid[step // 2 : frame.tactile_depth.shape[0] : step, step // 2 : frame.tactile_depth.shape[1] : step]
    counts = frame.tactile_depth[v, u]
    valid = valid_depth(counts)
    return np.column_stack([u[valid], v[valid], counts[valid] * rig.tactile.depth_unit_m]).astype(np.float64)


def pack_rgb(rgb: Uint8Array) -> Uint8Array:
    """Convert RGB (H, W, 3) to the memory layout of ``QImage.Format_RGB32``, (H, W, 4)."""
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(rgb), cv2.COLOR_RGB2BGRA), dtype=np.uint8)


def _color_picture(color: Uint8Array, stretch: bool) -> Picture:
    gray = cv2.cvtColor(np.ascontiguousarray(color), cv2.COLOR_RGB2GRAY)
    if stretch:
        low, high = np.percentile(gray[::4, ::4], (0.5, 99.5))
        scale = 255.0 / max(high - low, 1.0)
        color = np.asarray(cv2.convertScaleAbs(np.maximum(color, np.uint8(low)), alpha=scale, beta=-low * scale))
    return Picture(pack_rgb(color), np.asarray(gray, dtype=np.uint8))


def _depth_picture(depth_m: Float32Array, stretch: bool) -> Picture:
    ends = (1.0, 99.0) if stretch else (0.0, 100.0)
    return _mapped(depth_m, depth_lut()[:, :3], *_percentiles(depth_m, ends))


def _relief_picture(depth_m: Float32Array, stretch: bool) -> Picture:
    """Draw depth relative to its smoothed surroundings, which shows bumps and edges at any distance."""
    valid = np.isfinite(depth_m)
    weight = cv2.GaussianBlur(valid.astype(np.float32), (0, 0), _RELIEF_SIGMA_PX)
    smooth = cv2.GaussianBlur(np.nan_to_num(depth_m), (0, 0), _RELIEF_SIGMA_PX) / np.maximum(weight, 1e-6)
    relief: Float32Array = np.where(valid, smooth - depth_m, np.float32(np.nan)).astype(np.float32)
    limit = max(abs(end) for end in _percentiles(relief, (3.0, 97.0))) if stretch else _RELIEF_LIMIT_M
    grays = np.repeat(np.arange(256, dtype=np.uint8)[:, None], 3, axis=1)
    return _mapped(relief, grays, -limit, limit)


def _percentiles(values: Float32Array, ends: tuple[float, float]) -> tuple[float, float]:
    sample = values[::3, ::3]
    sample = sample[np.isfinite(sample)]
    if len(sample) == 0:
        return 0.0, 1.0
    low, high = (float(end) for end in np.percentile(sample, ends))
    return low, max(high, low + 1e-6)


def _mapped(values: Float32Array, lut: AnyArray, low: float, high: float) -> Picture:
    valid = np.isfinite(values)
    rows = np.clip((np.nan_to_num(values) - low) * (255.0 / (high - low)), 0, 255).astype(np.uint8)
    rgb = lut[rows]
    rgb[~valid] = NO_VALUE_RGB
    gray: Uint8Array = np.where(valid, rows, np.uint8(0)).astype(np.uint8)
    return Picture(pack_rgb(rgb.astype(np.uint8)), gray)


#: Largest distance that snapping moves a click, pixels.
REACH_PX = 6.0


def snap(picture: Picture, place: Place) -> Snapped | None:
    """Return the centre of the dot or the crossing near a pixel, or None."""
    return snap_to_feature(picture.gray, *place, radius=REACH_PX)


def landing(place: Place, found: Snapped | None) -> str:
    """Say what a click snapped to."""
    if found is None:
        return "nothing to snap to"
    name = "dot centre" if found.kind == "blob" else "crossing"
    return f"{name}, {hypot(found.u - place[0], found.v - place[1]):.1f} px away"
