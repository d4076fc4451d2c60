"""Dark printed dots in a colour image: where their centroids are, to a fraction of a pixel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from ..calibration.detect import to_gray
from ..model.arrays import AnyArray, BoolArray, Float32Array, Float64Array, IndexArray, Int32Array, Uint8Array
from .dot_centres import middles_on_bends
from .dot_edges import SeenSurface

#: Widest dots looked for, pixels; the search tries one after the other.
DOT_WIDTHS_PX: Final = (11, 21, 41)
#: A dot is this much darker than what surrounds it, grey levels and multiples of the image's grain.
_LEAST_CONTRAST, _LEAST_OVER_GRAIN = 12.0, 6.0
#: The share of its darkest pixel's contrast that a pixel of a dot has.
_EDGE_SHARE: Final = 0.45
_LEAST_AREA_PX: Final = 3
_LONGEST_ASPECT: Final = 4.0
_LEAST_FILL: Final = 0.5


@dataclass(frozen=True, eq=False)
class Spots:
    """Dark spots in an image.

    Attributes
    ----------
    pixels : float64, shape (N, 2)
        Their middles ``(u, v)``.
    area_m2 : float64, shape (N,)
        How much of the surface they cover.
    at_step : bool, shape (N,)
        Whether the surface ends beside them, or is hidden.
    """

    pixels: Float64Array
    area_m2: Float64Array
    at_step: BoolArray

    def __len__(self) -> int:
        return len(self.pixels)

    def some(self, chosen: AnyArray) -> Spots:
        """Return those of a mask or of numbers."""
        return Spots(self.pixels[chosen], self.area_m2[chosen], self.at_step[chosen])


def find_dots(image: AnyArray, width_px: int, surface: SeenSurface) -> Spots:
    """Find dark spots that are narrower than a width, whatever the brightness of what they lie on.

    A spot's pixels count by the surface that each shows, so that its middle is that on the surface, even where
    the farther half is foreshortened. No spot reaches over a step of depth.

    Parameters
    ----------
    image : uint8, shape (H, W) or (H, W, 3)
        Colour is RGB.
    width_px : int
        Spots of this width and more are taken for the background; an odd number.
    surface : SeenSurface
        What the image shows.
    """
    gray = to_gray(image)
    element = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width_px, width_px))
    contrast = cv2.morphologyEx(gray, cv2.MORPH_BLACKHAT, element).astype(np.float32)
    smooth = cv2.GaussianBlur(contrast, (0, 0), 0.8)
    grain = float(np.median(smooth))
    least = max(_LEAST_CONTRAST, _LEAST_OVER_GRAIN * grain)
    reach = max(width_px // 4, 1) * 2 + 1
    peak = cv2.dilate(smooth, np.ones((reach, reach), np.uint8))
    labels, stats = surface.regions((smooth > _EDGE_SHARE * peak) & (peak > least))
    beside_step = surface.near_step(1)
    darkness = np.maximum(contrast - float(np.median(contrast)), 0.0) * surface.area_m2
    total, means = _means(labels, beside_step, darkness, len(stats))
    numbers = _dot_like(stats, gray.shape, width_px)
    numbers = numbers[total[numbers] > 0]
    area, beside = (
        np.bincount(labels.ravel(), of.ravel(), len(stats))[numbers] for of in (surface.area_m2, beside_step)
    )
    ink = _ink(gray, contrast, labels, numbers)
    middles, printed = middles_on_bends(surface, gray, labels, numbers, means[numbers], ink)
    return Spots(middles, np.asarray(area, np.float64), beside > 0).some(printed)


def _ink(
    gray: Uint8Array,
    contrast: Float32Array,
    labels: Int32Array,
    numbers: IndexArray,
) -> float:
    """Return how much darker the darkest pixel of most spots is than what surrounds it, as a share."""
    if len(numbers) == 0:
        return 0.0
    inside = labels > 0
    darker = contrast[inside] / np.maximum(gray[inside] + contrast[inside], 1.0)
    most = np.zeros(int(labels.max()) + 1)
    np.maximum.at(most, labels[inside], darker)
    return float(np.median(most[numbers]))


def _means(
    labels: Int32Array, beside_step: BoolArray, weight: Float64Array, count: int
) -> tuple[Float64Array, Float64Array]:
    """Return the weight of each region, (K,), and its mean pixel, (K, 2), with the half-dark pixels around it.

    Without these the mean moves by up to 0.15 pixels with how the outline falls on the pixels.
    """
    around = cv2.dilate(labels.astype(np.float32), cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3)))
    wider = np.where((labels > 0) | beside_step, labels, around.astype(np.int32))
    rows, columns = np.nonzero(wider)
    label, share = wider[rows, columns], weight[rows, columns]
    total, u, v = (np.bincount(label, of, count) for of in (share, share * columns, share * rows))
    return np.asarray(total), np.asarray(np.column_stack([u, v]) / np.maximum(total, 1e-300)[:, None])


def _dot_like(stats: AnyArray, shape: tuple[int, ...], width_px: int) -> IndexArray:
    """Return the numbers of the regions that may be dots: small, filled, not cut by the image's edge."""
    x, y, w, h, area = stats.T
    fits = (area >= _LEAST_AREA_PX) & (np.maximum(w, h) <= width_px) & (area >= _LEAST_FILL * w * h)
    fits &= np.maximum(w, h) <= _LONGEST_ASPECT * np.minimum(w, h)
    fits &= (x > 0) & (y > 0) & (x + w < shape[1]) & (y + h < shape[0])
    fits[0] = False
    return np.flatnonzero(fits)
