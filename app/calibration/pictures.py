"""The images that are clicked in: colour or depth of a snapshot."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ...core.model.alignment import Side
from ...core.model.arrays import Float64Array, Uint8Array
from ...core.model.clouds import valid_depth
from ...core.model.frames import Rig, SensorFrame
from ...widgets.basics.colormaps import depth_lut
from ...widgets.images.strip_render import NO_VALUE_RGB, color_pane
from .session import ImageChoice


@dataclass(frozen=True, eq=False)
class Picture:
    """One image: pixels (H, W, 4) as ``QImage.Format_RGB32``, and grey (H, W), in which snapping searches."""

    pixels: Uint8Array
    gray: Uint8Array


def picture(frame: SensorFrame, rig: Rig, side: Side, choice: ImageChoice) -> Picture:
    """Return the image of one side with its contrast stretched: depth also where it has no colour."""
    color = frame.proximity_color if side == "proximity" else frame.tactile_color
    if choice == "color" and color is not None:
        gray = cv2.cvtColor(np.ascontiguousarray(color), cv2.COLOR_RGB2GRAY)
        low, high = np.percentile(gray[::4, ::4], (0.5, 99.5))
        scale = 255.0 / max(high - low, 1.0)
        shown = cv2.convertScaleAbs(np.maximum(color, np.uint8(low)), alpha=scale, beta=-low * scale)
        return Picture(color_pane(np.asarray(shown), None), np.asarray(gray, dtype=np.uint8))
    counts = frame.proximity_depth if side == "proximity" else frame.tactile_depth
    camera = rig.proximity if side == "proximity" else rig.tactile
    valid = valid_depth(counts)
    depth_m = np.where(valid, counts * np.float32(camera.depth_unit_m), np.float32(0.0))
    sample = depth_m[::3, ::3][valid[::3, ::3]]
    low, high = np.percentile(sample, (1.0, 99.0)) if len(sample) else (0.0, 1.0)
    rows = np.clip((depth_m - low) * (255.0 / max(high - low, 1e-6)), 0, 255).astype(np.uint8)
    rgb = depth_lut()[rows, :3]
    rgb[~valid] = NO_VALUE_RGB
    return Picture(color_pane(rgb, None), np.where(valid, rows, np.uint8(0)).astype(np.uint8))


def membrane_grid(frame: SensorFrame, rig: Rig, step: int) -> Float64Array:
    """Return (u, v, raw depth in metres) of every ``step``-th tactile pixel with a depth: float64 (M, 3)."""
    v, u = np.mgrid[step // 2 : frame.tactile_depth.shape[0] : step, step // 2 : frame.tactile_depth.shape[1] : step]
    counts = frame.tactile_depth[v, u]
    valid = valid_depth(counts)
    return np.column_stack([u[valid], v[valid], counts[valid] * rig.tactile.depth_unit_m]).astype(np.float64)
