"""Dark printed dots in a colour image: where their centroids are, to a fraction of a pixel."""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from ..calibration.detect import to_gray
from ..frames import Float64Array

#: Widest dots looked for, pixels; the search tries one after the other.
DOT_WIDTHS_PX: Final = (11, 21, 41)
#: A dot is this much darker than what surrounds it, grey levels and multiples of the image's grain.
_LEAST_CONTRAST, _LEAST_OVER_GRAIN = 12.0, 6.0
#: The share of its darkest pixel's contrast that a pixel of a dot has.
_EDGE_SHARE: Final = 0.45
_LEAST_AREA_PX: Final = 3
_LONGEST_ASPECT: Final = 4.0
_LEAST_FILL: Final = 0.5


def find_dots(image: npt.NDArray[Any], width_px: int, area: Float64Array | None = None) -> Float64Array:
    """Find dark spots that are narrower than a width, whatever the brightness of what they lie on.

    Parameters
    ----------
    image : uint8, shape (H, W) or (H, W, 3)
        Colour is RGB.
    width_px : int
        Spots of this width and more are taken for the background; an odd number.
    area : float64, shape (H, W), optional
        How much of the surface each pixel shows. By it a dot's pixels count, so that the middle of a dot is
        that on the surface, even where its farther half is foreshortened.

    Returns
    -------
    float64, shape (N, 2)
        Centroids ``(u, v)``, pixels, weighted by contrast and area.
    """
    gray = to_gray(image)
    element = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width_px, width_px))
    contrast = cv2.morphologyEx(gray, cv2.MORPH_BLACKHAT, element).astype(np.float32)
    smooth = cv2.GaussianBlur(contrast, (0, 0), 0.8)
    grain = float(np.median(smooth))
    least = max(_LEAST_CONTRAST, _LEAST_OVER_GRAIN * grain)
    reach = max(width_px // 4, 1) * 2 + 1
    peak = cv2.dilate(smooth, np.ones((reach, reach), np.uint8))
    inside = (smooth > _EDGE_SHARE * peak) & (peak > least)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(inside.astype(np.uint8), connectivity=4)
    weight = np.maximum(smooth - grain, 0.0) * (1.0 if area is None else area)
    return _centroids(weight, labels, _dot_like(stats[:count], gray.shape, width_px, labels))


def _dot_like(
    stats: npt.NDArray[Any], shape: tuple[int, ...], width_px: int, labels: npt.NDArray[Any]
) -> npt.NDArray[np.intp]:
    """Return the numbers of the regions that may be dots: small, filled, not cut by the image's edge."""
    x, y, w, h, area = stats.T
    fits = (area >= _LEAST_AREA_PX) & (np.maximum(w, h) <= width_px) & (area >= _LEAST_FILL * w * h)
    fits &= np.maximum(w, h) <= _LONGEST_ASPECT * np.minimum(w, h)
    fits &= (x > 0) & (y > 0) & (x + w < shape[1]) & (y + h < shape[0])
    fits[0] = False
    return np.flatnonzero(fits)


def _centroids(weight: npt.NDArray[Any], labels: npt.NDArray[Any], numbers: npt.NDArray[np.intp]) -> Float64Array:
    rows, columns = np.nonzero(labels)
    label, share = labels[rows, columns], weight[rows, columns].astype(np.float64)
    total, u, v = (np.bincount(label, share * over, labels.max() + 1) for over in (1.0, columns, rows))
    usable = numbers[total[numbers] > 0]
    return np.column_stack([u[usable] / total[usable], v[usable] / total[usable]])
