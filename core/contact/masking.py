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
    """Return which RGB colours (..., 3) lie in the mask's range of OpenCV's HSV; a low hue above the high wraps."""
    inside = np.empty(colors.shape[:-1], bool)
    colors_in_range(flat(colors, 3 * LANES), hsv_limits(section), inside.reshape(-1))
    return inside


def masked_share(image: Uint8Array, section: MaskSection) -> float:
    """Return the share of a colour image (H, W, 3) that the mask covers, of large images from every n-th pixel."""
    step = max(1, len(image) // 120)
    masked = in_hsv_range(np.ascontiguousarray(image[::step, ::step]), section)
    return float(np.count_nonzero(masked) / masked.size)


def colors_at(points: Float32Array, pixels: IndexArray, image: Uint8Array, rig: Rig) -> tuple[Uint8Array, BoolArray]:
    """Return the colour of each point (N, 3) in the proximity colour image, and whether the colour camera sees it.

    ``pixels`` are the points' flat depth pixels, for an image that is aligned to depth already.
    """
    if rig.proximity_color is None:
        return image.reshape(-1, 3)[pixels], np.ones(len(pixels), bool)
    T_c_d = np.asarray(rig.proximity_color.T_color_depth, dtype=np.float32)
    rotation, translation = np.ascontiguousarray(T_c_d[:3, :3]), np.ascontiguousarray(T_c_d[:3, 3])
    colors, seen = np.zeros((len(points), 3), np.uint8), np.empty(len(points), bool)
    color_lookup(
        points, rotation, translation, *lens_parameters(rig.proximity_color.intrinsics), image, colors, seen
    )  # fmt: skip
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
