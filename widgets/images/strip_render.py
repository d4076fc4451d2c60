"""Renders the images of a frame to pixels for the image strip; runs on any thread."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from ...core.model.arrays import BoolArray, Float32Array, Uint8Array
from ..basics.colormaps import (
    CONTACT_RGB,
    DIFFERENCE_LIMIT,
    MASKED_RGB,
    depth_lut,
    difference_index,
    difference_lut,
    tint,
)

#: Names of the images.
IMAGES: Final = ("color", "proximity", "tactile", "difference")

_Packed = npt.NDArray[np.uint32]

#: Pixels without a value: a grey that none of the maps contains.
NO_VALUE_RGB: Final = (104, 104, 110)

#: What the mask covers is mixed with its colour by this share.
MASK_TINT: Final = 0.6

_KERNEL = np.ones((5, 5), np.uint8)  # a rim of two pixels: one alone gets lost when the image is shown smaller


@dataclass(frozen=True, eq=False)
class StripImages:
    """One frame's images at every ``stride``-th pixel, nan without depth; ``relative`` is (dp - dt) / dp."""

    color: Uint8Array
    mask_overlay: BoolArray | None
    proximity_m: Float32Array
    tactile_m: Float32Array
    relative: Float32Array
    tolerance: float
    depth_range_m: tuple[float, float]
    size: tuple[int, int]
    stride: int = 1
    contact: BoolArray | None = None


@dataclass(frozen=True, eq=False)
class RenderedStrip:
    """The images by name, (h, w, 4) as ``QImage.Format_RGB32``; ``size`` is that of the whole image."""

    panes: dict[str, Uint8Array]
    size: tuple[int, int]
    stride: int
    depth_range_m: tuple[float, float]
    tolerance: float
    difference_limit: float
    masked_share: float | None = None


def render_strip(images: StripImages, wanted: Collection[str] = IMAGES) -> RenderedStrip:
    """Draw the images whose names are wanted."""
    limit = max(DIFFERENCE_LIMIT, 2.0 * images.tolerance)
    depths, differences = _pack_lut(depth_lut()), _pack_lut(difference_lut(round(images.tolerance, 6), limit))
    draw: dict[str, Callable[[], _Packed]] = {
        "color": lambda: _colored(images.color, images.mask_overlay),
        "proximity": lambda: np.take(depths, _depth_index(images.proximity_m, images.depth_range_m)),
        "tactile": lambda: np.take(depths, _depth_index(images.tactile_m, images.depth_range_m)),
        "difference": lambda: np.take(differences, difference_index(images.relative, limit)),
    }
    packed = {name: draw[name]() for name in IMAGES if name in wanted}
    if images.contact is not None:
        outline = _outline(images.contact)
        for pane in packed.values():
            pane[outline] = _pack_rgb(CONTACT_RGB)
    return RenderedStrip(
        panes={
            name: np.ascontiguousarray(pane).view(np.uint8).reshape(*pane.shape, 4) for name, pane in packed.items()
        },
        size=images.size,
        stride=images.stride,
        depth_range_m=images.depth_range_m,
        tolerance=images.tolerance,
        difference_limit=limit,
    )


def stride_for(width: int, width_hint: int) -> int:
    """Return the step at which an image is drawn whose whole width takes ``width_hint`` screen pixels; 0 draws all."""
    return max(1, int(width / width_hint + 0.1)) if width_hint > 0 else 1


def _depth_index(depth_m: Float32Array, range_m: tuple[float, float]) -> Uint8Array:
    """Take depths to rows 1 to 255 of a table, nan to row 0."""
    near, far = range_m
    rows = depth_m * np.float32(254.0 / (far - near))
    rows += np.float32(1.5 - near * 254.0 / (far - near))
    np.clip(rows, np.float32(1.0), np.float32(255.0), out=rows)
    np.fmax(rows, np.float32(0.0), out=rows)  # nan becomes 0
    return rows.astype(np.uint8)


def _colored(color: Uint8Array, mask: BoolArray | None) -> _Packed:
    bgra = np.asarray(cv2.cvtColor(np.ascontiguousarray(color), cv2.COLOR_RGB2BGRA), np.uint8)
    if mask is not None:
        tint(bgra, mask, MASKED_RGB, MASK_TINT)
    return bgra.view(np.uint32)[:, :, 0]


def _outline(region: BoolArray) -> BoolArray:
    """Return the outline of a region. Small holes are filled first, since their outlines would hide the image."""
    closed = cv2.morphologyEx(np.ascontiguousarray(region).view(np.uint8), cv2.MORPH_CLOSE, _KERNEL)
    return np.asarray(closed != cv2.erode(closed, _KERNEL))


def _pack_rgb(rgb: tuple[int, int, int]) -> np.uint32:
    return np.uint32(0xFF000000 | rgb[0] << 16 | rgb[1] << 8 | rgb[2])


def _pack_lut(lut: Uint8Array) -> _Packed:
    """Return a table of packed colours whose row 0 stands for *no value*."""
    wide = lut.astype(np.uint32)
    packed: _Packed = (0xFF000000 | wide[:, 0] << 16 | wide[:, 1] << 8 | wide[:, 2]).astype(np.uint32)
    packed[0] = _pack_rgb(NO_VALUE_RGB)
    return packed
