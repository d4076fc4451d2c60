"""The edge of contact from the equilibrium of tension and pressure in the membrane.

A free membrane of tension T under the pressure p has twice the mean curvature p / T (Young-Laplace). For an object of
curvature k, the gap g between membrane and object satisfies laplacian(g) = p / T - k on the surface. In contact g is
0, and g is never negative: an obstacle problem (Kinderlehrer and Stampacchia, "An Introduction to Variational
Inequalities and Their Applications", 1980, chapter 1). The proximity camera measures k, the tactile camera p / T, and
both depths measure the gap, with noise and a bias that varies over the image. The solution is regularised towards the
measured gaps; the bias of each group is the one with the smallest misfit.
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

#: Sigma with which the object's shape is averaged, grid cells of two by two pixels.
_SHAPE_CELLS: Final = 2.0
#: Usable share of that window needed for the curvature, and for the slope.
_MIN_SHARE, _MIN_SHARE_OF_SLOPE = np.float32(0.5), np.float32(0.05)
#: How far the object's curvature is extrapolated, grid cells.
_REACH_CELLS: Final = 8.0
#: The gap is solved for where it is below this multiple of the preset's largest gap. Cells at the border of the known
#: region are fixed at the measured gap if that is above the largest gap.
_MAX_GAP_RATIO: Final = 2.5
#: Length over which the solution follows the measured gap, metres.
_TRUST_M: Final = 0.008
#: Lower limit of p / T - k, 1/m; for a flat object it is p / T, about 10/m.
_MIN_PUSH: Final = 5.0
#: Largest gap in contact, metres, and the accuracy of the solution.
_TOUCHING_M: Final = 5e-5
_EXACT_M: Final = 2e-5
_RELAXATION: Final = balance_kernels.Relaxation(np.float32(1.6), np.float32(_EXACT_M), 300)
#: Step between the biases that are tried, metres; the fewest cells in contact for a bias to count; and the upper limit
#: of the bias whatever the preset says, metres.
_BIAS_STEP_M: Final = 0.0003
_MIN_TOUCHING: Final = 6
_MAX_BIAS_M: Final = 0.003
#: A group that would vanish is kept if it is larger than this, pixels.
_SPECK_PX: Final = 80


@dataclass(frozen=True, eq=False)
class Cells:
    """Grid cells of two by two pixels, with what the equilibrium needs; images are (H, W).

    Attributes
    ----------
    measured_m : float32
        Gap along the normal, corrected for the bias measured on prints.
    smooth_m : float32
        Its local mean.
    weight : float32
        Share of usable pixels.
    known : bool
        Whether there is a local mean.
    push_per_m : float32
        p / T - k: curvature of the free membrane less that of the object.
    sides_m : float32, shape (2, H, W)
        Length along the surface to the right and down.
    facing : float32
        Ratio of a gap along the normal to the difference along the ray.
    """

    measured_m: Float32Array
    smooth_m: Float32Array
    weight: Float32Array
    known: BoolArray
    push_per_m: Float32Array
    sides_m: Float32Array
    facing: Float32Array


def balanced_contact(pressed: Pressed, gaps: Gaps, section: MembraneSection, rig: Rig) -> BoolArray:
    """Return contact without the pixels where a membrane in equilibrium has left the object.

    Small groups that would vanish are removed. Larger ones are kept, and so is contact that would vanish altogether.

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
    """Return the grid cells: averages over two by two pixels, and the object's shape.

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
    kernels.bulges(points, share, _MIN_SHARE, bulge)
    flat_m = 2 / camera.fx, 2 / camera.fy
    balance_kernels.measure_cells(points, share, _MIN_SHARE_OF_SLOPE, flat_m, section.slope, sides, facing)
    bias_m = gaps.differences.print_bias_m if section.bias_m > 0 else 0.0
    push = np.nan_to_num(np.float32(free_per_m) - with_nearest(bulge, _REACH_CELLS), nan=free_per_m)
    return Cells(
        (difference - np.float32(bias_m)) * facing,
        gap + np.float32(gaps.bias_m - bias_m) * facing,
        weight,
        seen > 0,
        np.maximum(push, np.float32(_MIN_PUSH)),
        sides,
        facing,
    )


def _framed(cells: Cells) -> Cells:
    """Return the cells padded by one unknown cell, so that those at the border are solved for as well."""

    def framed(image: AnyArray) -> AnyArray:
        return np.pad(image, [(0, 0)] * (image.ndim - 2) + [(1, 1)] * 2, mode="edge")

    wide = Cells(*(framed(getattr(cells, field.name)) for field in fields(cells)))
    wide.known[[0, -1]] = wide.known[:, [0, -1]] = False
    return wide


def left_cells(cells: Cells, firm: BoolArray, section: MembraneSection) -> BoolArray:
    """Return the cells that the membrane has left, in groups with a small gap that contain firm contact.

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
    # cells next to a group, which are fixed at the measured gap, have its bias
    groups = cv2.dilate(groups.astype(np.float32), np.ones((3, 3), np.uint8)).astype(np.int32)
    told = ~np.isnan(biases)
    gap = balance.gaps(np.where(told, biases, np.float32(0))[groups])
    left = cells.known & (gap > np.float32(_TOUCHING_M)) & told[groups]
    return np.asarray(left[1:-1, 1:-1])


def _inside(cells: Cells, firm: BoolArray, gap_m: float) -> tuple[BoolArray, Int32Array]:
    """Return the cells whose gap is solved for, and the number of each cell's group; 0 for none."""
    import cv2

    inside = cells.known & (cells.smooth_m < np.float32(_MAX_GAP_RATIO * gap_m))
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
        """Return the gap of all cells for one bias or one per cell; the mean gap where it is not solved for."""
        cells, shift = self._cells, bias_m * self._cells.facing
        loads = self._links[4] * (self._measured_m - shift.reshape(-1)[self.places]) - self._load
        gaps = np.maximum(cells.smooth_m - shift, np.float32(0))
        if start is not None:
            gaps.reshape(-1)[self.places] = start.reshape(-1)[self.places]
        balance_kernels.settle(gaps.reshape(-1), gaps.shape[1], self._equations, loads, _RELAXATION)
        return gaps


def _biases_of_groups(balance: _Balance, count: int, max_bias_m: float) -> Float32Array:
    """Return the bias of each group with the smallest misfit to the measured gaps; nan if there is none.

    Tries biases from the largest down, until the misfit of every group grows or no group touches.
    """
    max_bias_m = min(max_bias_m, _MAX_BIAS_M)
    tried = np.linspace(max_bias_m, -max_bias_m, 2 * math.ceil(max_bias_m / _BIAS_STEP_M) + 1).astype(np.float32)
    misfits = np.full((len(tried), count), np.inf)
    gap = None
    for i, bias_m in enumerate(tried):
        gap = balance.gaps(bias_m, gap)
        misfit, touching = np.zeros(count), np.zeros(count, np.int64)
        balance_kernels.misfit_of_groups(
            gap.reshape(-1)[balance.places], balance.along_ray, balance.measured_along_ray_m - bias_m, balance.weight,
            balance.groups, balance.firm, misfit, touching,
        )  # fmt: skip
        misfits[i] = np.where(touching >= _MIN_TOUCHING, misfit, np.inf)
        if i > 0 and (np.isinf(misfits[i]) | (misfits[i] > misfits[i - 1])).all():
            break
    return lowest(tried, misfits)


def lowest(tried: Float32Array, misfits: Float64Array) -> Float32Array:
    """Return the minimum of each column, by a parabola through its smallest value and the two neighbours.

    Parameters
    ----------
    tried : float32, shape (N,)
        Evenly spaced.
    misfits : float64, shape (N, M)

    Returns
    -------
    float32, shape (M,)
        nan if no value is finite.
    """
    best = misfits.argmin(axis=0)
    columns = np.arange(misfits.shape[1])
    found = np.where(np.isfinite(misfits[best, columns]), tried[best], np.float32(np.nan))
    if len(tried) < 3:
        return found
    centre = np.clip(best, 1, len(tried) - 2)
    before, here, after = (misfits[centre + step, columns] for step in (-1, 0, 1))
    with np.errstate(invalid="ignore", divide="ignore"):
        bend = before - 2 * here + after
        shift = (before - after) / (2 * bend) * (tried[1] - tried[0])
    told = (best == centre) & np.isfinite(shift) & (bend > 0)
    return np.where(told, found + shift.astype(np.float32), found)


def _halved(image: BoolArray) -> BoolArray:
    """Return which grid cells of two by two pixels have at least two pixels set."""
    height, width = (side // 2 * 2 for side in image.shape)
    pixels = image[:height, :width].view(np.uint8)
    count = pixels[::2, ::2] + pixels[::2, 1::2] + pixels[1::2, ::2] + pixels[1::2, 1::2]
    return np.asarray(count >= 2)


def _doubled(cells: BoolArray, shape: tuple[int, ...]) -> BoolArray:
    """Return an image of pixels from one of grid cells; a last odd row or column repeats the one before."""
    image = np.pad(cells, ((0, shape[0] % 2), (0, shape[1] % 2)), mode="edge")
    return image.repeat(2, axis=0).repeat(2, axis=1)[: shape[0], : shape[1]]
