"""The map of predicted alignment uncertainty, laid over an image."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
import pyqtgraph as pg
from scipy.interpolate import LinearNDInterpolator

from ...core.calibration import CalibrationReport
from ...core.calibration.quality import millimetres_per_pixel
from ...core.model.arrays import Float64Array, Uint8Array
from ...core.model.clouds import valid_depth
from ...core.model.frames import Rig, SensorFrame
from .pictures import pack_rgb, picture
from .prediction import project_into

_STEP_PX = 8
_COARSE = 4
_OPACITY = 0.62
#: The colours span the values up to this percentile: a corner far from all points shall not flatten the rest.
_PERCENTILE = 97.0


@dataclass(frozen=True, eq=False)
class UncertaintyPicture:
    """Pixels for the screen, (H, W, 4), and what the ends of the colours mean."""

    pixels: Uint8Array
    low: float
    high: float


@cache
def uncertainty_lut() -> Uint8Array:
    """Return the colours from certain (dark) to uncertain (bright): uint8 (256, 4)."""
    colors = pg.colormap.get("inferno").map(np.linspace(0.15, 0.98, 256), mode="byte")
    return np.ascontiguousarray(colors)


def membrane_grid(frame: SensorFrame, rig: Rig, step: int) -> Float64Array:
    """Return tactile pixels and raw depths (M, 3) of every ``step``-th pixel that has a depth, metres."""
    v, u = np.mgrid[step // 2 : frame.tactile_depth.shape[0] : step, step // 2 : frame.tactile_depth.shape[1] : step]
    counts = frame.tactile_depth[v, u]
    valid = valid_depth(counts)
    return np.column_stack([u[valid], v[valid], counts[valid] * rig.tactile.depth_unit_m]).astype(np.float64)


def uncertainty_picture(report: CalibrationReport, frame: SensorFrame, rig: Rig, unit: str) -> UncertaintyPicture:
    """Colour the proximity colour image by the alignment error expected there.

    Parameters
    ----------
    unit : {"px", "mm"}
        Proximity pixels, or millimetres across the line of sight.
    """
    fit = report.rigid if report.model == "rigid" else report.homography
    assert fit is not None
    shown = picture(frame, rig, "proximity", "color", stretch=True)
    height, width = shown.gray.shape
    places = membrane_grid(frame, rig, _STEP_PX)
    if len(places) < 4:
        return UncertaintyPicture(shown.pixels, 0.0, 1.0)
    sigma = np.sqrt((fit.sensitivity(places) ** 2).sum(axis=(1, 2)))
    if unit == "mm":
        sigma = sigma * millimetres_per_pixel(places[:, 2], rig)
    where = color_pixels(fit.predict(places), places[:, 2], rig)
    v, u = np.mgrid[0:height:_COARSE, 0:width:_COARSE]
    coarse = LinearNDInterpolator(where, sigma)(u, v)
    high = float(np.percentile(sigma, _PERCENTILE))
    low = min(float(sigma.min()), 0.999 * high)
    rows = np.clip((np.nan_to_num(coarse) - low) * (255 / (high - low)), 0, 255).astype(np.uint8)
    colors = cv2.resize(uncertainty_lut()[rows][:, :, :3], (width, height), interpolation=cv2.INTER_LINEAR)
    known = cv2.resize(np.isfinite(coarse).astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR)
    gray = cv2.cvtColor(shown.gray, cv2.COLOR_GRAY2RGB).astype(np.float32)
    weight = (_OPACITY * known)[:, :, None]
    blended = gray * (1 - weight) + colors * weight
    return UncertaintyPicture(pack_rgb(blended.astype(np.uint8)), low, high)


def color_pixels(depth_pixels: Float64Array, depth_m: Float64Array, rig: Rig) -> Float64Array:
    """Take proximity depth pixels (N, 2) at distances (N,) to pixels of the proximity colour image."""
    if rig.proximity_color is None:
        return depth_pixels
    rays = rig.proximity.intrinsics.normalise(depth_pixels)
    return project_into(np.column_stack([rays * depth_m[:, None], depth_m]), rig, "color")
