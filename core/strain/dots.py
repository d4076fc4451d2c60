"""Dark printed dots in a colour image: their centroids on the printed sheet, to a fraction of a pixel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from ..calibration.detect import to_gray
from ..model.arrays import AnyArray, BoolArray, Float32Array, Float64Array, IndexArray, Int32Array, Uint8Array
from .surface import SeenSurface

#: Widest dots looked for, pixels; the search tries one after the other.
DOT_WIDTHS_PX: Final = (11, 21, 41)
#: A dot is this much darker than what surrounds it, grey levels and multiples of the image's grain.
_LEAST_CONTRAST, _LEAST_OVER_GRAIN = 12.0, 6.0
#: The share of its darkest pixel's contrast that a pixel of a dot has.
_EDGE_SHARE: Final = 0.45
_LEAST_AREA_PX: Final = 3
_LONGEST_ASPECT: Final = 4.0
_LEAST_FILL: Final = 0.5
#: So near to a step spots are looked at more closely, pixels, within so many pixels around each.
_NEAR_PX: Final = 8
_RADIUS_PX: Final = 9
#: The surface bends over lines across a spot: these are so long to either side, pixels.
_STRIP_PX: Final = 5.0
_FEWEST_PX, _FEWEST_LINES = 25, 6
#: The direction of the bend is that in which pixels show more and more surface, within so many pixels.
_DIRECTION_PX: Final = 5.0
#: How much a kink in the depths of those lines costs, against the misfit to one line's.
_STIFFNESS: Final = 0.1
#: Beyond the last line, the surface goes on to the rim of its pixels, as it is sampled along the bend.
_RIM_PX, _SAMPLE_PX = 0.5, 0.1
#: Brightness of the bare surface: pixels for its fit at least, and how far from dots.
_FEWEST_BARE_PX, _BARE_PX = 15, 1
#: A spot's ink is that of the pixel than which so many of its pixels are darker, percent.
_INK_PERCENT: Final = 15.0
#: Pixels that seem to have this share of the ink have none, and those that seem to have that one are full of it.
_BARE_SHARE, _FULL_SHARE = 0.2, 0.9
#: A spot with less than this share of the others' ink is a shadow.
_LEAST_INK: Final = 0.6
#: A middle is moved at most so far, pixels.
_FARTHEST_PX: Final = 1.0


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
    middles, printed = centroids_on_bends(surface, gray, labels, numbers, means[numbers], ink)
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


def centroids_on_bends(
    surface: SeenSurface,
    gray: Uint8Array,
    labels: Int32Array,
    numbers: IndexArray,
    pixels: Float64Array,
    ink: float,
) -> tuple[Float64Array, BoolArray]:
    """Find the middles of spots near a step of depth anew, and which of them are no shadows.

    Of a dot on a bend the part that is seen at a low angle is shorter and darker. So the surface is unrolled along
    the bend, and what is printed is told from the shade by the brightness of the bare surface around.

    Parameters
    ----------
    surface : SeenSurface
    gray : uint8, shape (H, W)
    labels : int32, shape (H, W)
        Numbers of spots, 0 outside.
    numbers : intp, shape (N,)
        The spots in question.
    pixels : float64, shape (N, 2)
        Their middles, ``(u, v)``, as far as known.
    ink : float
        How much darker than the bare surface dots are, as a share.

    Returns
    -------
    middles : float64, shape (N, 2)
        Those that are not near a step, or cannot be told better, are where they were.
    printed : bool, shape (N,)
    """
    middles, printed = pixels.copy(), np.ones(len(pixels), bool)
    near = surface.near_step(_NEAR_PX)
    for place, number in enumerate(numbers):
        u, v = np.rint(pixels[place]).astype(int)
        if near[v, u]:
            spot = _Spot(surface, gray, labels, int(number), pixels[place])
            printed[place] = not spot.is_bare(_LEAST_INK * ink)
            moved = spot.middle()
            if moved is not None and np.hypot(*(moved - pixels[place])) <= _FARTHEST_PX:
                middles[place] = moved
    return middles, printed


class _Spot:
    """One spot and what is around it, on its own side of steps."""

    def __init__(
        self,
        surface: SeenSurface,
        gray: Uint8Array,
        labels: Int32Array,
        number: int,
        pixel: Float64Array,
    ) -> None:
        top, left = (max(round(float(at)) - _RADIUS_PX, 0) for at in pixel[::-1])
        part = np.s_[top : round(float(pixel[1])) + _RADIUS_PX + 1, left : round(float(pixel[0])) + _RADIUS_PX + 1]
        self._pixel, self._intrinsics = pixel, surface.intrinsics
        self._corner = np.array([left, top], np.float64)
        self._labels, self._gray = labels[part], gray[part].astype(np.float64)
        self._spot = self._labels == number
        self._depth, self._area = surface.depth_m[part], surface.area_m2[part]
        self._own = surface.part(part).side_of(self._spot)
        self._ink, self._bare = self._brightness()

    def is_bare(self, least_ink: float) -> bool:
        """Whether the spot is hardly darker than the surface around it; not, where that is not known."""
        return self._bare is not None and self._ink < least_ink

    def middle(self) -> Float64Array | None:
        """Return the pixel that shows the middle; None where that cannot be told."""
        along = self._bend()
        if along is None or self._bare is None or self._ink <= 0:
            return None
        arc = self._unrolled(along)
        if arc is None:
            return None
        places, length = arc
        rows, columns = np.nonzero(self._printable())
        share = (self._bare[rows, columns] - self._gray[rows, columns]) / (self._bare[rows, columns] * self._ink)
        share = np.clip((share - _BARE_SHARE) / (_FULL_SHARE - _BARE_SHARE), 0.0, 1.0)
        at = self._away(rows, columns) @ along
        # over each pixel, the length of the surface, and the mean place on it times that length
        moment = np.concatenate([[0.0], np.cumsum((length[1:] ** 2 - length[:-1] ** 2) / 2)])
        low, high = at - 0.5, at + 0.5
        shown, times_place = (np.interp(high, places, of) - np.interp(low, places, of) for of in (length, moment))
        total = float(share @ shown)
        if total <= 0:
            return None
        return self._pixel + np.interp(share @ times_place / total, length, places) * along

    def _away(self, rows: AnyArray, columns: AnyArray) -> Float64Array:
        """Return the ways from the middle as far as known to pixels of the part, (M, 2)."""
        return np.column_stack([columns, rows]) + (self._corner - self._pixel)

    def _printable(self) -> BoolArray:
        """Tell the pixels that may show a bit of the spot."""
        around = cv2.dilate(self._spot.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))) > 0
        return np.asarray(around & self._own & (self._spot | (self._labels == 0)))

    def _brightness(self) -> tuple[float, Float64Array | None]:
        """Return how much darker the spot is than the bare surface, as a share, and how bright this would be."""
        width = 2 * _BARE_PX + 1
        bare = self._own & (cv2.dilate((self._labels > 0).astype(np.uint8), np.ones((width, width), np.uint8)) == 0)
        away = self._away(*np.indices(self._gray.shape).reshape(2, -1))
        known = (bare.ravel()) & (np.hypot(*away.T) < _RADIUS_PX)
        if np.count_nonzero(known) < _FEWEST_BARE_PX:
            return 0.0, None
        x, y = away.T / _RADIUS_PX
        design = np.stack([np.ones(len(x)), x, y, x * x, x * y, y * y], axis=1)
        fit = np.linalg.lstsq(design[known], self._gray.ravel()[known], rcond=None)[0]
        brightness = np.maximum(design @ fit, 1.0).reshape(self._gray.shape)
        return 1.0 - float(np.percentile((self._gray / brightness)[self._spot], _INK_PERCENT)), brightness

    def _bend(self) -> Float64Array | None:
        """Return the direction in the image, a unit vector, in which the surface is seen at ever lower angles."""
        rows, columns = np.nonzero(self._own)
        away = self._away(rows, columns)
        within = np.hypot(*away.T) < _DIRECTION_PX
        if np.count_nonzero(within) < _FEWEST_BARE_PX:
            return None
        design = np.column_stack([np.ones(np.count_nonzero(within)), away[within]])
        gradient = np.linalg.lstsq(design, self._area[rows, columns][within], rcond=None)[0][1:]
        size = float(np.hypot(*gradient))
        return gradient / size if size > 0 else None

    def _unrolled(self, along: Float64Array) -> tuple[Float64Array, Float64Array] | None:
        """Return places along the bend, pixels, and the length of the surface from the first to each, metres."""
        rows, columns = np.nonzero(self._own)
        away = self._away(rows, columns)
        at, beside = away @ along, away @ np.array([-along[1], along[0]])
        strip = (np.abs(beside) < _STRIP_PX) & (np.abs(at) < _RADIUS_PX)
        at, beside, depth = at[strip], beside[strip], self._depth[rows, columns][strip]
        lines = np.arange(np.floor(at.min(initial=0)), np.ceil(at.max(initial=0)) + 1)
        if len(at) < _FEWEST_PX or len(lines) < _FEWEST_LINES:
            return None
        nearness = np.maximum(1.0 - np.abs(at[:, None] - lines), 0.0)
        design = np.column_stack([nearness, beside, beside**2, beside * at])
        kinks = np.zeros((len(lines) - 2, design.shape[1]))
        kinks[:, : len(lines)] = np.sqrt(_STIFFNESS * len(at) / len(lines)) * np.diff(np.eye(len(lines)), 2, axis=0)
        target = np.concatenate([depth, np.zeros(len(kinks))])
        depths = np.linalg.lstsq(np.vstack([design, kinks]), target, rcond=None)[0][: len(lines)]
        central = at[np.abs(beside) < 1.5]
        if len(central) < 2:
            return None
        places = np.arange(central.min(), central.max() + _RIM_PX, _SAMPLE_PX)
        beyond = np.maximum(places - lines[-1], 0.0)
        z = np.interp(places, lines, depths) + beyond * (depths[-1] - depths[-2])
        rays = self._intrinsics.normalise(self._pixel + places[:, None] * along)
        steps = np.linalg.norm(np.diff(np.column_stack([rays * z[:, None], z]), axis=0), axis=1)
        return places, np.concatenate([[0.0], np.cumsum(steps)])
