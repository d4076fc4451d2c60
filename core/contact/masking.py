"""The colour mask: parts of the membrane that reflect infrared, such as prints, are no contact."""

from __future__ import annotations

import numpy as np

from ..model.arrays import BoolArray, Float32Array, IndexArray, Uint8Array
from ..model.frames import Rig
from ..model.sections import MaskSection
from .kernels.chain import ColorLookup, flat
from .kernels.colors import color_lookup, colors_in_range, hsv_limits
from .kernels.lenses import lens_parameters
from .kernels.simd import LANES


def in_hsv_range(colors: Uint8Array, section: MaskSection) -> BoolArray:
    """Tell which colours lie in the preset's range, OpenCV's 8-bit HSV, a low hue above the high wraps.

    Parameters
    ----------
    colors : uint8, shape (..., 3)
        RGB.

    Returns
    -------
    bool, shape (...)
    """
    inside = np.empty(colors.shape[:-1], bool)
    colors_in_range(flat(colors, 3 * LANES), hsv_limits(section), inside.reshape(-1))
    return inside


def masked_share(image: Uint8Array, section: MaskSection) -> float:
    """Return the share of a colour image (H, W, 3) that the mask covers, of large images from every n-th pixel."""
    step = max(1, len(image) // 120)
    masked = in_hsv_range(np.ascontiguousarray(image[::step, ::step]), section)
    return float(np.count_nonzero(masked) / masked.size)


def colors_at(points: Float32Array, pixels: IndexArray, image: Uint8Array, rig: Rig) -> tuple[Uint8Array, BoolArray]:
    """Return the proximity colour of each point and whether the colour camera sees it.

    Parameters
    ----------
    points : float32, shape (N, 3)
        Metres, proximity depth frame.
    pixels : int, shape (N,)
        Flat proximity depth pixel of each point.
    image : uint8, shape (H, W, 3)
        The proximity colour image.
    rig : Rig
        Its colour camera, or None for an image that is aligned to depth already.
    """
    if rig.proximity_color is None:
        return image.reshape(-1, 3)[pixels], np.ones(len(pixels), bool)
    T_c_d = np.asarray(rig.proximity_color.T_color_depth, dtype=np.float32)
    lens, camera = lens_parameters(rig.proximity_color.intrinsics)
    colors = np.zeros((len(points), 3), np.uint8)
    seen = np.empty(len(points), bool)
    color_lookup(
        points,
        np.ascontiguousarray(T_c_d[:3, :3]),
        np.ascontiguousarray(T_c_d[:3, 3]),
        lens,
        camera,
        image,
        colors,
        seen,
    )
    return colors, seen


def color_lookup_of(rig: Rig) -> ColorLookup:
    """Return where the colour of a proximity point is looked up."""
    if rig.proximity_color is None:
        lens = rig.proximity.intrinsics
        return ColorLookup(False, np.zeros(12, np.float32), 0, np.zeros(9, np.float32), lens.width, lens.height)
    T_c_d = np.asarray(rig.proximity_color.T_color_depth, dtype=np.float32)
    transform = np.concatenate([T_c_d[:3, :3].ravel(), T_c_d[:3, 3]])
    camera = rig.proximity_color.intrinsics
    return ColorLookup(True, transform, *lens_parameters(camera), camera.width, camera.height)
