"""Renders the images of a frame to pixels for the image strip; runs on any thread."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from ...core.model.arrays import BoolArray, Float32Array, Uint8Array
from ...core.model.patch import relative_difference
from ..basics.colormaps import CONTACT_RGB, DIFFERENCE_LIMIT, MASKED_RGB, depth_lut, difference_lut, scale_index, tint

#: Names of the images.
IMAGES: Final = ("color", "proximity", "tactile", "difference")

#: Pixels without a value: a grey that none of the maps contains.
NO_VALUE_RGB: Final = (104, 104, 110)

#: What the mask covers is mixed with its colour by this share.
MASK_TINT: Final = 0.6

_KERNEL = np.ones((5, 5), np.uint8)  # a rim of two pixels: one alone gets lost when the image is shown smaller


@dataclass(frozen=True, eq=False)
class RenderedStrip:
    """The images by name, (h, w, 4) as ``QImage.Format_RGB32``; ``size`` is that of the whole image."""

    panes: dict[str, Uint8Array]
    size: tuple[int, int]
    stride: int
    depth_range_m: tuple[float, float]
    tolerance: float
    masked_share: float | None = None  # of the colour image; None without a mask
    shows_mask: bool = False


def difference_limit(tolerance: float) -> float:
    """Return the relative difference at both ends of the colour scale."""
    return max(DIFFERENCE_LIMIT, 2.0 * tolerance)


def color_pane(color: Uint8Array, mask: BoolArray | None) -> Uint8Array:
    """Draw colours, RGB, tinted where a mask covers them."""
    bgra = np.asarray(cv2.cvtColor(np.ascontiguousarray(color), cv2.COLOR_RGB2BGRA), np.uint8)
    if mask is not None:
        tint(bgra, mask, MASKED_RGB, MASK_TINT)
    return bgra


def depth_pane(depth_m: Float32Array, range_m: tuple[float, float]) -> Uint8Array:
    """Draw depth, nan where there is none."""
    return _colored(depth_lut(), scale_index(depth_m, *range_m))


def difference_pane(expected_m: Float32Array, measured_m: Float32Array, tolerance: float) -> Uint8Array:
    """Draw the relative difference of both depths; nan where one of them is missing."""
    limit, relative = difference_limit(tolerance), relative_difference(expected_m, measured_m)
    return _colored(difference_lut(round(tolerance, 6), limit), scale_index(relative, -limit, limit))


def outline_contact(panes: Iterable[Uint8Array], contact: BoolArray) -> None:
    """Outline contact in images, in place. Small holes are filled first, since their outlines would hide the image."""
    closed = cv2.morphologyEx(np.ascontiguousarray(contact).view(np.uint8), cv2.MORPH_CLOSE, _KERNEL)
    outline = np.asarray(closed != cv2.erode(closed, _KERNEL))
    for pane in panes:
        pane.view(np.uint32)[outline] = _pack_rgb(CONTACT_RGB)


def stride_for(width: int, width_hint: int) -> int:
    """Return the step at which an image is drawn whose whole width takes ``width_hint`` screen pixels; 0 draws all."""
    return max(1, int(width / width_hint + 0.1)) if width_hint > 0 else 1


def _colored(lut: Uint8Array, rows: Uint8Array) -> Uint8Array:
    """Return the colours of some rows of a table whose row 0 stands for *no value*."""
    wide = lut.astype(np.uint32)
    packed = (0xFF000000 | wide[:, 0] << 16 | wide[:, 1] << 8 | wide[:, 2]).astype(np.uint32)
    packed[0] = _pack_rgb(NO_VALUE_RGB)
    return np.take(packed, rows).view(np.uint8).reshape(*rows.shape, 4)


def _pack_rgb(rgb: tuple[int, int, int]) -> np.uint32:
    return np.uint32(0xFF000000 | rgb[0] << 16 | rgb[1] << 8 | rgb[2])
