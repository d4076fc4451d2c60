"""Where the middle of a dot is that lies on a bend: the middle of what is printed, not of what the picture shows."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from ..model.arrays import AnyArray, BoolArray, Float64Array, IndexArray, Int32Array, Uint8Array
from .dot_edges import SeenSurface

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


def middles_on_bends(
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
