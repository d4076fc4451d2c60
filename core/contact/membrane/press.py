"""Where the membrane is pressed: less curved there than where it is free.

A free membrane under the pressure p and the tension T has the mean curvature H = p / (2 T) everywhere (Young and
Laplace). An object that touches it takes over part of the pressure, so there the membrane bulges less, is flat, or
is dented. An object that is merely close changes nothing. One camera, the tactile one, tells, so no bias between
both cameras has a part in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from ...model.arrays import BoolArray, Float32Array, IndexArray
from ...model.clouds import ray_table
from ...model.frames import Rig, SensorFrame
from ...model.intrinsics import Intrinsics
from ...preset import Preset
from ..alignment import AlignmentModel
from ..kernels import membrane as kernels
from .gaps import Gaps, near_pixels

#: Side of the squares of tactile pixels over which depth is averaged first.
_SIDE_PX: Final = 4
#: Share of a window that must have depth.
_LEAST_SHARE: Final = np.float32(0.7)
#: A free membrane that bulges less, 1/m, tells nothing; nor does one of which so few squares are seen.
_LEAST_BULGE: Final = 1.0
_FEWEST_FREE: Final = 200
#: A group of contact presses lightly if no larger share of it is firm.
_LIGHT_SHARE: Final = 0.2
#: Fewer pixels of firm contact tell nothing about its gap, and fewer of a light one nothing about its own.
_FEWEST_FIRM: Final = 100
_FEWEST_LIGHT: Final = 10
#: As far as this, in every other pixel, what surrounds pressed pixels is believed to be pressed.
_EDGE: Final = 3


@dataclass(frozen=True, eq=False)
class Pressed:
    """Contact where the membrane is pressed, and how it bulges where it is free.

    Attributes
    ----------
    contact : bool, shape (H, W)
    free_per_m : float
        Twice the mean curvature of the free membrane, 1/m; nan where too little of it is seen or nothing asks for it.
    """

    contact: BoolArray
    free_per_m: float


def pressed_contact(
    contact: BoolArray, gaps: Gaps, frame: SensorFrame, preset: Preset, rig: Rig, alignment: AlignmentModel
) -> Pressed:
    """Leave out pixels of contact at which the membrane is as curved as where it is free.

    Contact stays where the curvature is not known, and a group of it that presses too lightly to be told stays if its
    gap is no larger than that of pressed contact elsewhere. What is neither in the region and range nor near an object
    counts as free.

    Parameters
    ----------
    contact : bool, shape (H, W)
        Like the images of ``gaps``. Where the gap is small the membrane is not taken for free.
    """
    section = preset.membrane
    too_small = min(rig.tactile.intrinsics.shape) < _SIDE_PX
    if not section.measures_curvature or too_small or not contact.any():
        return Pressed(contact, np.nan)
    import cv2

    near = near_pixels(gaps, section).view(np.uint8)
    # every other pixel tells enough of what is averaged over more than ten
    some = cv2.dilate(near, np.ones((2, 2), np.uint8), anchor=(0, 0))[::2, ::2].astype(bool)
    bulge = bulge_per_m(frame, preset, rig).reshape(-1)
    squares = _squares(some, gaps, rig, alignment)
    free = bulge.copy()
    free[squares[squares >= 0]] = np.nan
    free = free[~np.isnan(free)]
    if len(free) < _FEWEST_FREE or (usual := float(np.median(free))) < _LEAST_BULGE:
        return Pressed(contact, np.nan)
    if section.curvature == 0:
        return Pressed(contact, usual)
    pressed = np.zeros(some.shape, np.bool_)
    pressed[some] = ~(np.where(squares >= 0, bulge[squares], np.float32(np.nan)) > section.curvature * usual)
    # the window blurs the edge of contact, and a plate's edge bulges as much as what is free
    pressed = cv2.dilate(pressed.view(np.uint8), np.ones((_EDGE, _EDGE), np.uint8)).astype(bool)
    height, width = contact.shape
    firm = contact & pressed.repeat(2, axis=0).repeat(2, axis=1)[:height, :width]
    return Pressed(with_light_contact(firm, contact, gaps.gap_m, section.gap_m), usual)


def with_light_contact(firm: BoolArray, contact: BoolArray, gap_m: Float32Array, most_m: float) -> BoolArray:
    """Return firm contact, and connected groups with hardly any of it that are as near as the others' firm contact.

    These are the groups whose median gap is no larger than the median of that, and smaller by ``most_m`` at most.

    Parameters
    ----------
    firm, contact : bool, shape (H, W)
        Firm contact is part of contact.
    gap_m : float32, shape (H, W)
    most_m : float
    """
    import cv2

    count, groups, boxes, _ = cv2.connectedComponentsWithStats(contact.view(np.uint8))
    area = boxes[:, cv2.CC_STAT_AREA]
    light = np.bincount(groups[firm], minlength=count) <= _LIGHT_SHARE * area
    light[0] = False
    if not light.any():
        return firm
    others = firm & ~light[groups]
    if np.count_nonzero(others) < _FEWEST_FIRM:
        return firm
    usual = np.median(gap_m[others])
    light &= area >= _FEWEST_LIGHT
    for group in np.flatnonzero(light):
        left, top, width, height = boxes[group, :4]
        box = slice(top, top + height), slice(left, left + width)
        light[group] = usual - most_m <= np.median(gap_m[box][groups[box] == group]) <= usual
    return np.asarray(firm | light[groups])


def bulge_per_m(frame: SensorFrame, preset: Preset, rig: Rig) -> Float32Array:
    """Return twice the mean curvature of the membrane, positive where it bulges away from the camera.

    Returns
    -------
    float32, shape (h, w)
        1/m, of squares of four by four tactile pixels, smoothed; nan farther than two windows' sigma from where
        enough depth is known.
    """
    import cv2

    camera, alignment = rig.tactile.intrinsics, preset.alignment
    shape = camera.height // _SIDE_PX, camera.width // _SIDE_PX
    counts, shares = np.empty(shape, np.float32), np.empty(shape, np.float32)
    kernels.block_means(frame.tactile_depth, _SIDE_PX, counts, shares)
    depth = counts * np.float32(rig.tactile.depth_unit_m * alignment.depth_scale) + np.float32(alignment.depth_offset_m)
    sigma = max(preset.membrane.curvature_px / _SIDE_PX, 0.5)
    # Points are averaged, not depths: at the image's border their mean lies aside, but on the surface.
    parts = (shares, depth * shares, *(depth * shares * ray for ray in _rays_of_squares(camera)))
    known, z, x, y = (cv2.GaussianBlur(part, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT) for part in parts)
    bulge = np.empty(shape, np.float32)
    kernels.bulges(np.stack([x, y, z]) / np.maximum(known, np.float32(1e-6)), known, _LEAST_SHARE, bulge)
    return with_nearest(bulge, 2 * sigma + 1)


def with_nearest(image: Float32Array, reach_px: float) -> Float32Array:
    """Return an image in which what is unknown has the value of the nearest known pixel that is within reach."""
    import cv2

    unknown = np.isnan(image)
    if not unknown.any() or unknown.all():
        return image
    way, labels = cv2.distanceTransformWithLabels(
        unknown.view(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    of_label = np.full(int(labels.max()) + 1, np.nan, np.float32)
    of_label[labels[~unknown]] = image[~unknown]
    return np.where(way <= reach_px, of_label[labels], np.float32(np.nan))


@lru_cache(maxsize=8)
def _rays_of_squares(camera: Intrinsics) -> Float32Array:
    """Return ``(x / z, y / z)`` in the middle of each square, shape (2, h, w)."""
    rays = ray_table(camera)[: camera.height // _SIDE_PX * _SIDE_PX, : camera.width // _SIDE_PX * _SIDE_PX]
    squares = rays.reshape(camera.height // _SIDE_PX, _SIDE_PX, camera.width // _SIDE_PX, _SIDE_PX, 2)
    return np.ascontiguousarray(squares.mean(axis=(1, 3)).transpose(2, 0, 1), np.float32)


def _squares(some: BoolArray, gaps: Gaps, rig: Rig, alignment: AlignmentModel) -> IndexArray:
    """Return the flat square on which the membrane at some of every other pixel falls; -1 outside the image."""
    differences, across = gaps.differences, rig.tactile.intrinsics.width // _SIDE_PX
    down = rig.tactile.intrinsics.height // _SIDE_PX
    usable, (top, left) = differences.usable[::2, ::2][some], differences.corner
    depth = differences.depth_m[::2, ::2][some] - differences.difference_m[::2, ::2][some]
    depth = np.where(usable, depth, np.float32(depth[usable].mean() if usable.any() else 0))
    rows, columns = np.nonzero(some)
    pixels = (2 * rows + top) * rig.proximity.intrinsics.width + 2 * columns + left
    u, v = alignment.tactile_pixels(pixels, depth, rig)
    with np.errstate(invalid="ignore"):
        column, row = np.floor((u + 0.5) / _SIDE_PX), np.floor((v + 0.5) / _SIDE_PX)
        inside = (column >= 0) & (column < across) & (row >= 0) & (row < down)
    return np.where(inside, np.where(inside, row * across + column, 0).astype(np.intp), -1)
