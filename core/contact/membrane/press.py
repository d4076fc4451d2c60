"""Where the membrane is pressed: its curvature is smaller there than where it is free.

A free membrane under the pressure p and the tension T has the mean curvature H = p / (2 T) everywhere
(Young-Laplace). An object in contact carries part of the pressure, so the membrane is less curved, flat or dented
there. An object that is merely close changes nothing. Only the tactile camera is used, so a bias between the cameras
has no effect.
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

#: Side of the blocks of tactile pixels over which depth is averaged first.
_BLOCK_PX: Final = 4
#: Share of a window that must have depth.
_MIN_SHARE: Final = np.float32(0.7)
#: The smallest usable curvature of the free membrane, 1/m, and the fewest blocks from which it is measured.
_MIN_BULGE: Final = 1.0
_MIN_FREE: Final = 200
#: A group of contact is light if at most this share of it is firm.
_LIGHT_SHARE: Final = 0.2
#: The fewest pixels of firm contact, and of a light group, from which a gap is measured.
_MIN_FIRM: Final = 100
_MIN_LIGHT: Final = 10
#: Size of the dilation of pressed pixels, in every other pixel.
_EDGE: Final = 3


@dataclass(frozen=True, eq=False)
class Pressed:
    """Pressed contact, and the free membrane's curvature.

    Attributes
    ----------
    contact : bool, shape (H, W)
    free_per_m : float
        Twice the mean curvature of the free membrane, 1/m; nan if too little of it is seen or it is not needed.
    """

    contact: BoolArray
    free_per_m: float


def pressed_contact(
    contact: BoolArray, gaps: Gaps, frame: SensorFrame, preset: Preset, rig: Rig, alignment: AlignmentModel
) -> Pressed:
    """Return contact without the pixels where the membrane is as curved as where it is free.

    Contact of unknown curvature is kept. A group that presses too lightly to be detected is kept if its gap is no
    larger than that of firm contact elsewhere. The membrane counts as free wherever it is not near an object.

    Parameters
    ----------
    contact : bool, shape (H, W)
        Has the shape of the images of ``gaps``.
    """
    section = preset.membrane
    too_small = min(rig.tactile.intrinsics.shape) < _BLOCK_PX
    if not section.measures_curvature or too_small or not contact.any():
        return Pressed(contact, np.nan)
    import cv2

    near = near_pixels(gaps, section).view(np.uint8)
    # every other pixel is enough, because curvature is averaged over more than ten
    some = cv2.dilate(near, np.ones((2, 2), np.uint8), anchor=(0, 0))[::2, ::2].astype(bool)
    bulge = bulge_per_m(frame, preset, rig).reshape(-1)
    squares = _blocks_of(some, gaps, rig, alignment)
    free = bulge.copy()
    free[squares[squares >= 0]] = np.nan
    free = free[~np.isnan(free)]
    if len(free) < _MIN_FREE or (usual := float(np.median(free))) < _MIN_BULGE:
        return Pressed(contact, np.nan)
    if section.curvature == 0:
        return Pressed(contact, usual)
    pressed = np.zeros(some.shape, np.bool_)
    pressed[some] = ~(np.where(squares >= 0, bulge[squares], np.float32(np.nan)) > section.curvature * usual)
    # the window blurs the edge of contact, and the edge of a plate is as curved as the free membrane
    pressed = cv2.dilate(pressed.view(np.uint8), np.ones((_EDGE, _EDGE), np.uint8)).astype(bool)
    height, width = contact.shape
    firm = contact & pressed.repeat(2, axis=0).repeat(2, axis=1)[:height, :width]
    return Pressed(with_light_contact(firm, contact, gaps.gap_m, section.gap_m), usual)


def with_light_contact(firm: BoolArray, contact: BoolArray, gap_m: Float32Array, max_difference_m: float) -> BoolArray:
    """Return firm contact, and light groups that are as near as the firm contact of the other groups.

    A light group is kept if its median gap is at most that of firm contact, and smaller by at most
    ``max_difference_m``.

    Parameters
    ----------
    firm, contact : bool, shape (H, W)
        Firm contact is a subset of contact.
    gap_m : float32, shape (H, W)
    max_difference_m : float
    """
    import cv2

    count, groups, boxes, _ = cv2.connectedComponentsWithStats(contact.view(np.uint8))
    area = boxes[:, cv2.CC_STAT_AREA]
    light = np.bincount(groups[firm], minlength=count) <= _LIGHT_SHARE * area
    light[0] = False
    if not light.any():
        return firm
    others = firm & ~light[groups]
    if np.count_nonzero(others) < _MIN_FIRM:
        return firm
    usual = np.median(gap_m[others])
    light &= area >= _MIN_LIGHT
    for group in np.flatnonzero(light):
        left, top, width, height = boxes[group, :4]
        box = slice(top, top + height), slice(left, left + width)
        light[group] = usual - max_difference_m <= np.median(gap_m[box][groups[box] == group]) <= usual
    return np.asarray(firm | light[groups])


def bulge_per_m(frame: SensorFrame, preset: Preset, rig: Rig) -> Float32Array:
    """Return twice the mean curvature of the membrane, positive where it bulges away from the camera.

    Returns
    -------
    float32, shape (h, w)
        1/m, smoothed, per block of four by four tactile pixels; nan farther than two sigma from known depth.
    """
    import cv2

    camera, alignment = rig.tactile.intrinsics, preset.alignment
    shape = camera.height // _BLOCK_PX, camera.width // _BLOCK_PX
    counts, shares = np.empty(shape, np.float32), np.empty(shape, np.float32)
    kernels.block_means(frame.tactile_depth, _BLOCK_PX, counts, shares)
    depth = counts * np.float32(rig.tactile.depth_unit_m * alignment.depth_scale) + np.float32(alignment.depth_offset_m)
    sigma = max(preset.membrane.curvature_px / _BLOCK_PX, 0.5)
    # Points are averaged, not depths: at the image's border their mean is shifted, but lies on the surface.
    parts = (shares, depth * shares, *(depth * shares * ray for ray in _rays_of_blocks(camera)))
    known, z, x, y = (cv2.GaussianBlur(part, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT) for part in parts)
    bulge = np.empty(shape, np.float32)
    kernels.bulges(np.stack([x, y, z]) / np.maximum(known, np.float32(1e-6)), known, _MIN_SHARE, bulge)
    return with_nearest(bulge, 2 * sigma + 1)


def with_nearest(image: Float32Array, reach_px: float) -> Float32Array:
    """Return an image whose nan pixels have the value of the nearest known pixel within ``reach_px``."""
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
def _rays_of_blocks(camera: Intrinsics) -> Float32Array:
    """Return ``(x / z, y / z)`` at the centre of each block, shape (2, h, w)."""
    rays = ray_table(camera)[: camera.height // _BLOCK_PX * _BLOCK_PX, : camera.width // _BLOCK_PX * _BLOCK_PX]
    squares = rays.reshape(camera.height // _BLOCK_PX, _BLOCK_PX, camera.width // _BLOCK_PX, _BLOCK_PX, 2)
    return np.ascontiguousarray(squares.mean(axis=(1, 3)).transpose(2, 0, 1), np.float32)


def _blocks_of(some: BoolArray, gaps: Gaps, rig: Rig, alignment: AlignmentModel) -> IndexArray:
    """Return the flat block of the membrane at the marked pixels (every other pixel); -1 outside the image."""
    differences, across = gaps.differences, rig.tactile.intrinsics.width // _BLOCK_PX
    down = rig.tactile.intrinsics.height // _BLOCK_PX
    usable, (top, left) = differences.usable[::2, ::2][some], differences.corner
    depth = differences.depth_m[::2, ::2][some] - differences.difference_m[::2, ::2][some]
    depth = np.where(usable, depth, np.float32(depth[usable].mean() if usable.any() else 0))
    rows, columns = np.nonzero(some)
    pixels = (2 * rows + top) * rig.proximity.intrinsics.width + 2 * columns + left
    u, v = alignment.tactile_pixels(pixels, depth, rig)
    with np.errstate(invalid="ignore"):
        column, row = np.floor((u + 0.5) / _BLOCK_PX), np.floor((v + 0.5) / _BLOCK_PX)
        inside = (column >= 0) & (column < across) & (row >= 0) & (row < down)
    return np.where(inside, np.where(inside, row * across + column, 0).astype(np.intp), -1)
