"""Where contact ends: there the membrane leaves the object, as its tension and the pressure make it.

A free membrane of tension T under the pressure p bulges by p / T (Young and Laplace), twice its mean curvature. Between
it and an object that bulges by k there is a gap g, whose second derivatives on the surface add up to p / T - k. Where
the object touches, g is 0, and nowhere is it negative: an obstacle problem, as in Kinderlehrer and Stampacchia 1980,
"An Introduction to Variational Inequalities and Their Applications", chapter 1. The proximity camera tells k, the
tactile camera p / T, and both their depths the gap, with noise and a bias that is another one in each part of the
image. The solution is drawn to what is measured; the bias is that with which it comes nearest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Final

import numpy as np

from ...model.arrays import AnyArray, BoolArray, Float32Array, Float64Array, Int32Array
from ...model.clouds import ray_table
from ...model.frames import Rig
from ...preset import MembraneSection
from ..kernels import balance as balance_kernels
from ..kernels import membrane as kernels
from .gaps import Gaps
from .press import Pressed, with_nearest

#: Over so many cells of two by two pixels the object's shape is averaged, sigma.
_SHAPE_CELLS: Final = 2.0
#: Share of such a window that must be usable for the curvature, and for the slope.
_LEAST_SHARE, _LEAST_SHARE_OF_SLOPE = np.float32(0.5), np.float32(0.05)
#: How far the object's curvature is carried on to where it is not known, cells.
_REACH_CELLS: Final = 8.0
#: The gap is solved for where it is at most so many times the largest gap of what is near; cells at the border of what
#: is known are held at what is measured from the largest gap itself on.
_FARTHEST: Final = 2.5
#: Over this length what is measured draws the gap to it, metres.
_TRUST_M: Final = 0.008
#: The least by which the membrane is pushed against the object, 1/m; a flat one is pushed by p / T, some 10/m.
_LEAST_PUSH: Final = 5.0
#: A larger gap is none of contact, metres; and how exactly it is solved for.
_TOUCHING_M: Final = 5e-5
_EXACT_M: Final = 2e-5
_RELAXATION: Final = balance_kernels.Relaxation(np.float32(1.6), np.float32(_EXACT_M), 300)
#: Biases are tried up to the largest believed, so far apart, metres; those with fewer cells of contact are left out. No
#: larger one is sought in any case.
_BIAS_STEP_M: Final = 0.0003
_FEWEST_TOUCHING: Final = 6
_LARGEST_BIAS_M: Final = 0.003
#: A larger group of contact of which nothing is left was no speck, and stays, pixels.
_SPECK_PX: Final = 80


@dataclass(frozen=True, eq=False)
class Cells:
    """Squares of two by two pixels, with what the balance needs; images are (H, W).

    Attributes
    ----------
    measured_m : float32
        Gap along the normal, free of the bias that prints tell.
    smooth_m : float32
        Its local mean.
    weight : float32
        Share of the pixels that tell it.
    known : bool
        Whether there is a local mean.
    push_per_m : float32
        How much less the object bulges than the free membrane.
    sides_m : float32, shape (2, H, W)
        Length along the surface to the right and down.
    facing : float32
        Share of a difference along the ray that is along the normal.
    """

    measured_m: Float32Array
    smooth_m: Float32Array
    weight: Float32Array
    known: BoolArray
    push_per_m: Float32Array
    sides_m: Float32Array
    facing: Float32Array


def balanced_contact(pressed: Pressed, gaps: Gaps, section: MembraneSection, rig: Rig) -> BoolArray:
    """Return contact without the pixels at which a membrane in balance has left the object.

    Specks of which nothing would be left go; larger groups stay, and the only ones do.

    Parameters
    ----------
    pressed : Pressed
        Its images are those of ``gaps``.
    """
    contact = pressed.contact
    if not section.balance or np.isnan(pressed.free_per_m) or min(contact.shape) < 6 or not contact.any():
        return contact
    import cv2

    cells = cells_of(gaps, pressed.free_per_m, section, rig)
    left = left_cells(cells, _halved(contact), section)
    stays = contact & ~_doubled(left, contact.shape)
    if not stays.any():
        return contact
    count, groups, boxes, _ = cv2.connectedComponentsWithStats(contact.view(np.uint8))
    whole = np.bincount(groups[stays], minlength=count) == 0
    whole &= boxes[:, cv2.CC_STAT_AREA] > _SPECK_PX
    whole[0] = False
    return np.asarray(stays | whole[groups])


def cells_of(gaps: Gaps, free_per_m: float, section: MembraneSection, rig: Rig) -> Cells:
    """Average over squares of two by two pixels and measure the object's shape.

    Parameters
    ----------
    free_per_m : float
        Twice the mean curvature of the free membrane.
    """
    import cv2

    differences, camera = gaps.differences, rig.proximity.intrinsics
    height, width = differences.usable.shape
    means = np.empty((7, height // 2, width // 2), np.float32)
    images = balance_kernels.GapImages(
        differences.difference_m, differences.depth_m, differences.usable, gaps.gap_m, gaps.known
    )
    balance_kernels.average_cells(images, kernels.RayWindow(ray_table(camera), *differences.corner), means)
    difference, weight, *_, gap, seen = means
    share, x, y, z = (
        cv2.GaussianBlur(part, (0, 0), _SHAPE_CELLS, borderType=cv2.BORDER_CONSTANT) for part in means[1:5]
    )
    points = np.stack([x, y, z]) / np.maximum(share, np.float32(1e-6))
    bulge, sides, facing = np.empty_like(weight), np.empty((2, *weight.shape), np.float32), np.empty_like(weight)
    kernels.bulges(points, share, _LEAST_SHARE, bulge)
    flat_m = 2 / camera.fx, 2 / camera.fy
    balance_kernels.measure_cells(points, share, _LEAST_SHARE_OF_SLOPE, flat_m, section.slope, sides, facing)
    bias_m = gaps.differences.print_bias_m if section.bias_m > 0 else 0.0
    push = np.nan_to_num(np.float32(free_per_m) - with_nearest(bulge, _REACH_CELLS), nan=free_per_m)
    return Cells(
        (difference - np.float32(bias_m)) * facing,
        gap + np.float32(gaps.bias_m - bias_m) * facing,
        weight,
        seen > 0,
        np.maximum(push, np.float32(_LEAST_PUSH)),
        sides,
        facing,
    )


def _framed(cells: Cells) -> Cells:
    """Return the same with a frame of unknown cells about it, so that those at the border are solved for, too."""

    def framed(image: AnyArray) -> AnyArray:
        return np.pad(image, [(0, 0)] * (image.ndim - 2) + [(1, 1)] * 2, mode="edge")

    wide = Cells(*(framed(getattr(cells, field.name)) for field in fields(cells)))
    wide.known[[0, -1]] = wide.known[:, [0, -1]] = False
    return wide


def left_cells(cells: Cells, firm: BoolArray, section: MembraneSection) -> BoolArray:
    """Return the cells that the membrane has left, in groups of cells with a small gap that are firm contact in part.

    Parameters
    ----------
    firm : bool, shape (H, W)
    """
    import cv2

    cells, firm = _framed(cells), np.pad(firm, 1)
    inside, groups = _inside(cells, firm, section.gap_m)
    if not inside.any():
        return np.zeros_like(firm[1:-1, 1:-1])
    balance = _Balance(cells, inside, firm, groups)
    biases = _biases_of_groups(balance, int(groups.max()) + 1, section.bias_m)
    # cells beside a group, which are held at what is measured, have its bias
    groups = cv2.dilate(groups.astype(np.float32), np.ones((3, 3), np.uint8)).astype(np.int32)
    told = ~np.isnan(biases)
    gap = balance.gaps(np.where(told, biases, np.float32(0))[groups])
    left = cells.known & (gap > np.float32(_TOUCHING_M)) & told[groups]
    return np.asarray(left[1:-1, 1:-1])


def _inside(cells: Cells, firm: BoolArray, gap_m: float) -> tuple[BoolArray, Int32Array]:
    """Return the cells whose gap is solved for, and the number of each one's group, 0 for none."""
    import cv2

    inside = cells.known & (cells.smooth_m < np.float32(_FARTHEST * gap_m))
    rim = cv2.erode(cells.known.view(np.uint8), np.ones((3, 3), np.uint8)) == 0
    inside &= ~(rim & (cells.smooth_m > np.float32(gap_m)))
    count, groups = cv2.connectedComponents(inside.view(np.uint8))
    firm_in_part = np.bincount(groups[firm & inside], minlength=count) > 0
    inside &= firm_in_part[groups]
    return inside, np.where(inside, groups, 0).astype(np.int32, copy=False)


class _Balance:
    """The equations of the cells inside, in their order."""

    def __init__(self, cells: Cells, inside: BoolArray, firm: BoolArray, groups: Int32Array) -> None:
        size = int(np.count_nonzero(inside))
        self.places, self._links = np.empty(size, np.int32), np.empty((7, size), np.float32)
        even = balance_kernels.link_cells(
            inside, cells.known, cells.sides_m, cells.weight, np.float32(_TRUST_M), self.places, self._links
        )
        self._equations = balance_kernels.Equations(self.places, self._links, even)
        self._cells = cells
        measured, push, facing, self.weight, self.firm, self.groups = (
            image.reshape(-1)[self.places]
            for image in (cells.measured_m, cells.push_per_m, cells.facing, cells.weight, firm, groups)
        )
        self._measured_m, self._load = measured, self._links[5] * push
        self.along_ray = np.float32(1) / facing
        self.measured_along_ray_m = measured * self.along_ray

    def gaps(self, bias_m: Float32Array | np.float32, start: Float32Array | None = None) -> Float32Array:
        """Return the gap of all cells with a bias, one or one for each cell; where it is not solved for, the mean."""
        cells, shift = self._cells, bias_m * self._cells.facing
        loads = self._links[4] * (self._measured_m - shift.reshape(-1)[self.places]) - self._load
        gaps = np.maximum(cells.smooth_m - shift, np.float32(0))
        if start is not None:
            gaps.reshape(-1)[self.places] = start.reshape(-1)[self.places]
        balance_kernels.settle(gaps.reshape(-1), gaps.shape[1], self._equations, loads, _RELAXATION)
        return gaps


def _biases_of_groups(balance: _Balance, count: int, most_m: float) -> Float32Array:
    """Return the bias of each group with which its gaps come nearest to what is measured; nan where none is told.

    From the largest bias down, until the misfit of every group grows or it touches nowhere any more.
    """
    most_m = min(most_m, _LARGEST_BIAS_M)
    tried = np.linspace(most_m, -most_m, 2 * math.ceil(most_m / _BIAS_STEP_M) + 1).astype(np.float32)
    misfits = np.full((len(tried), count), np.inf)
    gap = None
    for i, bias_m in enumerate(tried):
        gap = balance.gaps(bias_m, gap)
        misfit, touching = np.zeros(count), np.zeros(count, np.int64)
        balance_kernels.misfit_of_groups(
            gap.reshape(-1)[balance.places], balance.along_ray, balance.measured_along_ray_m - bias_m, balance.weight,
            balance.groups, balance.firm, misfit, touching,
        )  # fmt: skip
        misfits[i] = np.where(touching >= _FEWEST_TOUCHING, misfit, np.inf)
        if i > 0 and (np.isinf(misfits[i]) | (misfits[i] > misfits[i - 1])).all():
            break
    return lowest(tried, misfits)


def lowest(tried: Float32Array, misfits: Float64Array) -> Float32Array:
    """Return where each column is lowest, by the parabola through its least value and the two beside it.

    Parameters
    ----------
    tried : float32, shape (N,)
        Evenly spaced.
    misfits : float64, shape (N, M)

    Returns
    -------
    float32, shape (M,)
        nan where no value is finite.
    """
    best = misfits.argmin(axis=0)
    columns = np.arange(misfits.shape[1])
    found = np.where(np.isfinite(misfits[best, columns]), tried[best], np.float32(np.nan))
    if len(tried) < 3:
        return found
    middle = np.clip(best, 1, len(tried) - 2)
    before, here, after = (misfits[middle + step, columns] for step in (-1, 0, 1))
    with np.errstate(invalid="ignore", divide="ignore"):
        bend = before - 2 * here + after
        shift = (before - after) / (2 * bend) * (tried[1] - tried[0])
    told = (best == middle) & np.isfinite(shift) & (bend > 0)
    return np.where(told, found + shift.astype(np.float32), found)


def _halved(image: BoolArray) -> BoolArray:
    """Return which cells of two by two pixels are set in at least half."""
    height, width = (side // 2 * 2 for side in image.shape)
    pixels = image[:height, :width].view(np.uint8)
    count = pixels[::2, ::2] + pixels[::2, 1::2] + pixels[1::2, ::2] + pixels[1::2, 1::2]
    return np.asarray(count >= 2)


def _doubled(cells: BoolArray, shape: tuple[int, ...]) -> BoolArray:
    """Return an image of pixels from one of cells; a last odd row or column is that before it."""
    image = np.pad(cells, ((0, shape[0] % 2), (0, shape[1] % 2)), mode="edge")
    return image.repeat(2, axis=0).repeat(2, axis=1)[: shape[0], : shape[1]]
