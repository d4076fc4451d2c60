"""Dark printed dots in a colour image: their centroids on the printed sheet, to a fraction of a pixel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from ...calibration.detect import to_gray
from ...model.arrays import AnyArray, BoolArray, Float32Array, Float64Array, IndexArray, Int32Array, Uint8Array
from .surface import SeenSurface

#: Upper limits of the dot width, pixels; the search tries each.
DOT_WIDTHS_PX: Final = (11, 21, 41)
#: Minimum contrast of a dot: in grey levels, and in multiples of the image noise.
_MIN_CONTRAST, _MIN_CONTRAST_TO_NOISE = 12.0, 6.0
#: Pixels of a dot have at least this share of the contrast of its darkest pixel.
_EDGE_SHARE: Final = 0.45
_MIN_AREA_PX: Final = 3
_MAX_ASPECT: Final = 4.0
_MIN_FILL: Final = 0.5
#: Spots within this distance of a depth step are refined, pixels, from a window of this radius.
_NEAR_PX: Final = 8
_RADIUS_PX: Final = 9
#: The surface profile is fitted on lines across the bend: half their length, pixels, and the fewest pixels and lines.
_STRIP_PX: Final = 5.0
_MIN_PX, _MIN_LINES = 25, 6
#: Radius for the direction of the bend, along which the surface area per pixel grows, pixels.
_DIRECTION_PX: Final = 5.0
#: Weight of the profile's second differences against the depth misfit.
_STIFFNESS: Final = 0.1
#: The profile is extrapolated by this much beyond its last line, and sampled at this step, pixels.
_RIM_PX, _SAMPLE_PX = 0.5, 0.1
#: Fit of the bare surface's brightness: fewest pixels, and their distance from dots, pixels.
_MIN_BARE_PX, _BARE_PX = 15, 1
#: Ink level of a spot: this brightness percentile of its pixels, relative to the bare surface.
_INK_PERCENT: Final = 15.0
#: Below the first share of the ink level a pixel counts as bare, above the second as fully printed.
_BARE_SHARE, _FULL_SHARE = 0.2, 0.9
#: A spot with less than this share of the usual ink level is a shadow.
_MIN_INK: Final = 0.6
#: Larger refinements of a centroid are rejected, pixels.
_MAX_SHIFT_PX: Final = 1.0


@dataclass(frozen=True, eq=False)
class Spots:
    """Dark spots in an image.

    Attributes
    ----------
    pixels : float64, shape (N, 2)
        Centroids ``(u, v)``.
    area_m2 : float64, shape (N,)
        Surface area of each spot, square metres.
    at_step : bool, shape (N,)
        Whether the spot touches a depth step, where part of it may be hidden.
    """

    pixels: Float64Array
    area_m2: Float64Array
    at_step: BoolArray

    def __len__(self) -> int:
        return len(self.pixels)

    def some(self, chosen: AnyArray) -> Spots:
        """Return the spots selected by a mask or by indices."""
        return Spots(self.pixels[chosen], self.area_m2[chosen], self.at_step[chosen])


def find_dots(image: AnyArray, width_px: int, surface: SeenSurface) -> Spots:
    """Find dark spots that are narrower than a given width, independent of the background brightness.

    Pixels are weighted by the surface area they show, so the centroid is that on the surface, even if one half of
    the spot is foreshortened. No spot extends across a depth step.

    Parameters
    ----------
    image : uint8, shape (H, W) or (H, W, 3)
        Colour is RGB.
    width_px : int
        Spots of this width or more count as background; odd.
    surface : SeenSurface
        The surface that the image shows.
    """
    gray = to_gray(image)
    element = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width_px, width_px))
    contrast = cv2.morphologyEx(gray, cv2.MORPH_BLACKHAT, element).astype(np.float32)
    smooth = cv2.GaussianBlur(contrast, (0, 0), 0.8)
    grain = float(np.median(smooth))
    least = max(_MIN_CONTRAST, _MIN_CONTRAST_TO_NOISE * grain)
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
    centroids, printed = centroids_on_bends(surface, gray, labels, numbers, means[numbers], ink)
    return Spots(centroids, np.asarray(area, np.float64), beside > 0).some(printed)


def _ink(
    gray: Uint8Array,
    contrast: Float32Array,
    labels: Int32Array,
    numbers: IndexArray,
) -> float:
    """Return the median, over spots, of the relative contrast of the darkest pixel: 0 for none, 1 for black."""
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
    """Return the weight, (K,), and weighted centroid, (K, 2), of each region with the half-dark pixels around it.

    Without the half-dark pixels the centroid shifts by up to 0.15 pixels with the outline's subpixel position.
    """
    around = cv2.dilate(labels.astype(np.float32), cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3)))
    wider = np.where((labels > 0) | beside_step, labels, around.astype(np.int32))
    rows, columns = np.nonzero(wider)
    label, share = wider[rows, columns], weight[rows, columns]
    total, u, v = (np.bincount(label, of, count) for of in (share, share * columns, share * rows))
    return np.asarray(total), np.asarray(np.column_stack([u, v]) / np.maximum(total, 1e-300)[:, None])


def _dot_like(stats: AnyArray, shape: tuple[int, ...], width_px: int) -> IndexArray:
    """Return the labels of the regions that may be dots: small, filled, not cut by the image border."""
    x, y, w, h, area = stats.T
    fits = (area >= _MIN_AREA_PX) & (np.maximum(w, h) <= width_px) & (area >= _MIN_FILL * w * h)
    fits &= np.maximum(w, h) <= _MAX_ASPECT * np.minimum(w, h)
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
    """Refine the centroids of spots near a depth step, and tell which spots are printed and no shadows.

    On a bend, the part of a dot seen at a grazing angle appears shorter and darker. The surface is therefore unrolled
    along the bend, and print is separated from shading by the brightness of the bare surface around it.

    Parameters
    ----------
    surface : SeenSurface
    gray : uint8, shape (H, W)
    labels : int32, shape (H, W)
        Label of each pixel's spot, 0 outside.
    numbers : intp, shape (N,)
        Labels of the spots to refine.
    pixels : float64, shape (N, 2)
        Their centroids, ``(u, v)``.
    ink : float
        Usual contrast of dots relative to the bare surface, 0 to 1.

    Returns
    -------
    centroids : float64, shape (N, 2)
        Unchanged for spots that are far from steps or cannot be refined.
    printed : bool, shape (N,)
    """
    centroids, printed = pixels.copy(), np.ones(len(pixels), bool)
    near = surface.near_step(_NEAR_PX)
    for place, number in enumerate(numbers):
        u, v = np.rint(pixels[place]).astype(int)
        if near[v, u]:
            spot = _Spot(surface, gray, labels, int(number), pixels[place])
            printed[place] = not spot.is_bare(_MIN_INK * ink)
            moved = spot.centroid()
            if moved is not None and np.hypot(*(moved - pixels[place])) <= _MAX_SHIFT_PX:
                centroids[place] = moved
    return centroids, printed


class _Spot:
    """One spot and its surroundings, on its own side of depth steps."""

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
        """Tell whether the spot is hardly darker than the surface around it; False if that is unknown."""
        return self._bare is not None and self._ink < least_ink

    def centroid(self) -> Float64Array | None:
        """Return the pixel of the centroid on the unrolled surface; None if it cannot be determined."""
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
        # for each pixel: surface length, and mean position on it times that length
        moment = np.concatenate([[0.0], np.cumsum((length[1:] ** 2 - length[:-1] ** 2) / 2)])
        low, high = at - 0.5, at + 0.5
        shown, times_place = (np.interp(high, places, of) - np.interp(low, places, of) for of in (length, moment))
        total = float(share @ shown)
        if total <= 0:
            return None
        return self._pixel + np.interp(share @ times_place / total, length, places) * along

    def _away(self, rows: AnyArray, columns: AnyArray) -> Float64Array:
        """Return vectors from the initial centroid to pixels of the window, (M, 2)."""
        return np.column_stack([columns, rows]) + (self._corner - self._pixel)

    def _printable(self) -> BoolArray:
        """Tell the pixels that may show part of the spot."""
        around = cv2.dilate(self._spot.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))) > 0
        return np.asarray(around & self._own & (self._spot | (self._labels == 0)))

    def _brightness(self) -> tuple[float, Float64Array | None]:
        """Return the spot's ink level, 0 to 1, and the fitted brightness of the bare surface, (h, w), or None."""
        width = 2 * _BARE_PX + 1
        bare = self._own & (cv2.dilate((self._labels > 0).astype(np.uint8), np.ones((width, width), np.uint8)) == 0)
        away = self._away(*np.indices(self._gray.shape).reshape(2, -1))
        known = (bare.ravel()) & (np.hypot(*away.T) < _RADIUS_PX)
        if np.count_nonzero(known) < _MIN_BARE_PX:
            return 0.0, None
        x, y = away.T / _RADIUS_PX
        design = np.stack([np.ones(len(x)), x, y, x * x, x * y, y * y], axis=1)
        fit = np.linalg.lstsq(design[known], self._gray.ravel()[known], rcond=None)[0]
        brightness = np.maximum(design @ fit, 1.0).reshape(self._gray.shape)
        return 1.0 - float(np.percentile((self._gray / brightness)[self._spot], _INK_PERCENT)), brightness

    def _bend(self) -> Float64Array | None:
        """Return the image direction, a unit vector, along which the viewing angle becomes more grazing."""
        rows, columns = np.nonzero(self._own)
        away = self._away(rows, columns)
        within = np.hypot(*away.T) < _DIRECTION_PX
        if np.count_nonzero(within) < _MIN_BARE_PX:
            return None
        design = np.column_stack([np.ones(np.count_nonzero(within)), away[within]])
        gradient = np.linalg.lstsq(design, self._area[rows, columns][within], rcond=None)[0][1:]
        size = float(np.hypot(*gradient))
        return gradient / size if size > 0 else None

    def _unrolled(self, along: Float64Array) -> tuple[Float64Array, Float64Array] | None:
        """Return positions along the bend, pixels, and the arc length of the surface up to each, metres."""
        rows, columns = np.nonzero(self._own)
        away = self._away(rows, columns)
        at, beside = away @ along, away @ np.array([-along[1], along[0]])
        strip = (np.abs(beside) < _STRIP_PX) & (np.abs(at) < _RADIUS_PX)
        at, beside, depth = at[strip], beside[strip], self._depth[rows, columns][strip]
        lines = np.arange(np.floor(at.min(initial=0)), np.ceil(at.max(initial=0)) + 1)
        if len(at) < _MIN_PX or len(lines) < _MIN_LINES:
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
