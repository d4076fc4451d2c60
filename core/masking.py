"""The colour mask: pixels of the bare membrane's colour reflect infrared and are no contact."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from . import kernels
from .frames import Rig
from .preset import MaskSection

Rgb = npt.NDArray[np.uint8]
Bools = npt.NDArray[np.bool_]


def in_hsv_range(colors: Rgb, section: MaskSection) -> Bools:
    """Tell which colours lie in the preset's range, OpenCV's 8-bit HSV, a low hue above the high wraps.

    Parameters
    ----------
    colors : uint8, shape (..., 3)
        RGB.

    Returns
    -------
    bool, shape (...)
    """
    if colors.size == 0:
        return np.zeros(colors.shape[:-1], bool)
    hsv = cv2.cvtColor(np.ascontiguousarray(colors).reshape(1, -1, 3), cv2.COLOR_RGB2HSV)[0]
    hue, saturation, value = hsv[:, 0], hsv[:, 1], hsv[:, 2]
    low, high = section.hue
    inside = (hue >= low) & (hue <= high) if low <= high else (hue >= low) | (hue <= high)
    inside &= (saturation >= section.saturation[0]) & (saturation <= section.saturation[1])
    inside &= (value >= section.value[0]) & (value <= section.value[1])
    return np.asarray(inside.reshape(colors.shape[:-1]))


def colors_at(points: npt.NDArray[np.float32], pixels: npt.NDArray[np.intp], image: Rgb, rig: Rig) -> tuple[Rgb, Bools]:
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
    lens, camera = kernels.lens_parameters(rig.proximity_color.intrinsics)
    colors = np.zeros((len(points), 3), np.uint8)
    seen = np.empty(len(points), bool)
    kernels.color_lookup(
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


def is_masked(
    points: npt.NDArray[np.float32], pixels: npt.NDArray[np.intp], image: Rgb, rig: Rig, section: MaskSection
) -> Bools:
    """Tell which points have the bare membrane's colour. A point that no colour is known of is kept."""
    if not section.enabled:
        return np.zeros(len(points), bool)
    colors, seen = colors_at(points, pixels, image, rig)
    return in_hsv_range(colors, section) & seen
