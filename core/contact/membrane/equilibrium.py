"""Contact as an obstacle problem: where a membrane in equilibrium of tension and pressure touches the object.

A free membrane of tension T under the pressure p has twice the mean curvature p / T (Young-Laplace). For an object of
curvature k, the gap g between membrane and object satisfies laplacian(g) = p / T - k on the surface. In contact g is
0, and g is never negative: an obstacle problem (Kinderlehrer and Stampacchia, "An Introduction to Variational
Inequalities and Their Applications", 1980, chapter 1). Both cameras measure the gap, with noise and a bias b. The gap
minimises, over a surface,

    |grad g|^2 / 2 + (p / T - k) g + (g - (measured - b))^2 / (2 L^2),    g >= 0,

where L is the length over which equilibrium is trusted more than the measured gap. Noise that is shorter than L is
averaged, and the edge of contact is where the membrane leaves the object, not where a threshold is passed.

The membrane does not end where the object ends. Beside the object, up to a few cells beyond its border, the gap is that
to the tangent plane of the nearest border cell, and it may be negative. If the membrane passes in front of that plane,
it pulls the gap open at the border; if it passes behind, it is bent around the border and touches up to it.

Assumed: the same tension in all directions, no friction, small slopes between membrane and object.

The gap is solved for on square cells of pixels. p / T is measured on the tactile depth alone, so a bias between the
cameras has no effect on it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Final, NamedTuple

import numpy as np

from ...model.alignment import AlignmentSection
from ...model.arrays import BoolArray, Float32Array
from ...model.clouds import ray_table
from ...model.frames import Rig, SensorFrame
from ...model.intrinsics import Intrinsics
from ..kernels import cells as cell_kernels
from ..kernels import equilibrium as kernels
from ..kernels import membrane as membrane_kernels
from ..kernels.cells import Differences, MembraneImage
from ..kernels.membrane import RayWindow
from ..kernels.quadric import CELL_PX as BLOCK_PX
from ..kernels.quadric import average_cells
from ..kernels.threads import in_parallel


def surroundings(marked: BoolArray, margin_px: int) -> tuple[slice, slice] | None:
    """Return the bounding box of the marked pixels, padded by ``margin_px``; None without any."""
    rows, columns = (np.flatnonzero(marked.any(axis=axis)) for axis in (1, 0))
    if len(rows) == 0:
        return None
    height, width = marked.shape
    return (
        slice(max(int(rows[0]) - margin_px, 0), min(int(rows[-1]) + 1 + margin_px, height)),
        slice(max(int(columns[0]) - margin_px, 0), min(int(columns[-1]) + 1 + margin_px, width)),
    )


#: Side of the cells, pixels.
CELL_PX: Final = 3
#: Share of a cell's window that must be usable for a gap; for the object's curvature, and for its slope.
_MIN_SHARE: Final = np.float32(0.4)
_MIN_SHARES_OF_SURFACE: Final = (np.float32(0.5), np.float32(0.05))
#: Excluded share from which a cell takes no part.
_MAX_EXCLUDED: Final = np.float32(0.5)
#: Sigma of the window over which the first guess of the gap is averaged, pixels.
GUESS_PX: Final = 2.5
#: How far the object's curvature is extrapolated, pixels.
_REACH_PX: Final = 16.0
#: Lower limit of p / T - k, 1/m; it holds where the object is hollow and curves more strongly than the free membrane.
_MIN_PUSH_PER_M: Final = np.float32(2.0)
#: For cells without a known gap: larger than any that counts, metres.
FAR_M: Final = np.float32(0.01)
#: Beside the object, a difference this far from the bias, in either direction, is a wrong depth, metres.
_WRONG_M: Final = np.float32(0.012)
#: How far the gap is solved for beside the object, pixels, and the resulting frame of the images, cells.
_BESIDE_PX: Final = 9
FRAME: Final = 1 + -(-_BESIDE_PX // CELL_PX)
INNER: Final = (slice(FRAME, -FRAME),) * 2


class Cells(NamedTuple):
    """Square cells of pixels for the obstacle problem; images are (H, W), with a `FRAME` of unknown cells."""

    #: Mean difference of both depths along the ray. Beside the object: that of its tangent plane and the membrane.
    difference_m: Float32Array
    share: Float32Array  # Share of the seen pixels that take part
    unseen: Float32Array  # Share of the pixels without one of both depths
    #: Of the difference in the obstacle problem: that share; beside the object 1 where the membrane is seen.
    weight: Float32Array
    near_share: Float32Array  # That share averaged over the window of the first guess, from `over_window`
    known: BoolArray  # Whether enough pixels near it take part
    linked: BoolArray  # Known, or beside known cells
    push_per_m: Float32Array  # p / T - k: twice the mean curvature of the free membrane less that of the object
    sides_m: Float32Array  # (2, H, W): Length along the surface to the right and down
    facing: Float32Array  # Ratio of a gap along the normal to the difference along the ray
    size_px: int

    @property
    def area_m2(self) -> Float32Array:
        """Usable area of each cell, (H, W)."""
        return np.asarray(self.share * self.sides_m[0] * self.sides_m[1])


def cells_of(
    differences: Differences,
    membrane: MembraneImage,
    size_px: int,
    shape_px: float,
    free_per_m: float,
    near_m: tuple[float, float],
    rig: Rig,
) -> Cells | None:
    """Average differences and the object's shape over cells; None if the image is smaller than three cells.

    Only differences near the bias take part: ``near_m`` is centre and limit. The object's shape is averaged over a
    window of sigma ``shape_px``; ``free_per_m`` is twice the mean curvature of the free membrane.
    """
    import cv2

    camera, (height, width) = rig.proximity.intrinsics, differences.usable.shape
    if min(height, width) < 3 * size_px:
        return None
    shape = -(-height // size_px) + 2 * FRAME, -(-width // size_px) + 2 * FRAME
    difference, excluded, unseen = np.zeros((3, *shape), np.float32)
    points = np.zeros((*shape, 4), np.float32)
    sums = difference, excluded, unseen, points
    rays = ray_table(camera)
    step = 2 if size_px % 4 == 0 else 1  # neighbours share noise, so every fourth pixel is enough for large cells
    average = partial(cell_kernels.average_cells, differences, near_m, size_px, step, rays, FRAME, sums)
    in_parallel(average, shape[0] - 2 * FRAME)
    share, known = points[..., 3].copy(), np.zeros(shape, np.bool_)
    known[INNER] = ((over_window(share, size_px) > _MIN_SHARE) & (excluded < _MAX_EXCLUDED))[INNER]
    share *= known

    smooth = cv2.GaussianBlur(points, (0, 0), max(shape_px / size_px, 0.3), borderType=cv2.BORDER_CONSTANT)
    (bulges, facing), sides = np.empty((2, *shape), np.float32), np.empty((2, *shape), np.float32)
    flat_m = size_px / camera.fx, size_px / camera.fy
    cell_kernels.measure_cells(smooth, _MIN_SHARES_OF_SURFACE, flat_m, bulges, sides, facing)
    queue, sources = np.empty((2, share.size), np.int32)
    cell_kernels.extrapolate(bulges, known, round(_REACH_PX / size_px), queue)
    push = np.float32(free_per_m) - bulges

    window = RayWindow(rays, *(start - FRAME * size_px for start in differences.corner))
    linked, weight, planes = known.copy(), share.copy(), np.empty((3, share.size), np.float32)
    surface, beside = (sides, facing), (linked, difference, weight, sources, queue, planes)
    reach = -(-_BESIDE_PX // size_px)
    limits = near_m[0], _WRONG_M
    cell_kernels.continue_beside(known, excluded, points, surface, window, size_px, membrane, limits, reach, beside)
    push[linked & ~known] = free_per_m
    near = over_window(share, size_px)
    return Cells(difference, share, unseen, weight, near, known, linked, push, sides, facing, size_px)


def over_window(image: Float32Array, size_px: int) -> Float32Array:
    """Average an image of cells of ``size_px`` over the Gaussian window of `GUESS_PX`."""
    import cv2

    return np.asarray(cv2.GaussianBlur(image, (0, 0), GUESS_PX / size_px, borderType=cv2.BORDER_CONSTANT))


def to_pixels(
    cells: Cells, image: Float32Array, shape: tuple[int, int], box: tuple[slice, slice] = (slice(None), slice(None))
) -> tuple[Float32Array, BoolArray]:
    """Interpolate an image of the cells, or of a part of them, to pixels; ``box`` does not count the frame.

    Return the pixels, far in unknown cells, and whether a cell near the pixel is unknown, both (H, W).
    """
    import cv2

    known, (height, width) = cells.known[INNER][box], shape
    size = known.shape[1] * cells.size_px, known.shape[0] * cells.size_px
    weight = known.view(np.uint8).astype(np.float32)
    inside = cv2.resize(weight, size, interpolation=cv2.INTER_NEAREST)[:height, :width] > 0
    total = cv2.resize(weight * image[INNER][box], size, interpolation=cv2.INTER_LINEAR)[:height, :width]
    share = cv2.resize(weight, size, interpolation=cv2.INTER_LINEAR)[:height, :width]
    pixels = np.where(inside, total / np.maximum(share, np.float32(1e-6)), FAR_M)
    return np.asarray(pixels, np.float32), np.asarray(inside & (share < 1))


#: The gap is solved for where the measured one is smaller, metres.
_MAX_GAP_M: Final = np.float32(0.005)
_FACTOR, _TOLERANCE_M, _MAX_SWEEPS = np.float32(1.7), np.float32(1e-5), 300


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """The solution: gaps along the normal in the cells, with their frame."""

    gap_m: Float32Array  # (H, W): 0 in contact; large where nothing is known
    guess_m: Float32Array  # (H, W): The local mean of the measured gap
    residual_m: Float32Array  # (H, W): The measured gap less the solution
    touching: BoolArray  # (H, W)


def settle(cells: Cells, bias_m: float, trust_m: float, start: Equilibrium | None = None) -> Equilibrium:
    """Solve the obstacle problem for a bias and the length L, starting from the solution for another bias if given."""
    measured = (cells.difference_m - np.float32(bias_m)) * cells.facing
    total = over_window(cells.share * measured, cells.size_px)
    guess, gap, inside = np.empty_like(total), np.empty_like(total), np.empty(total.shape, np.bool_)
    kernels.guess_gaps(measured, total, cells.near_share, cells.known, guess, gap)
    size = kernels.mark_inside(guess, cells.known, cells.linked, cells.weight, _MAX_GAP_M, inside)
    places, links = np.empty(size, np.int32), np.empty((6, size), np.float32)
    floors, loads = np.empty((2, size), np.float32)
    push = np.maximum(cells.push_per_m, _MIN_PUSH_PER_M)
    even = kernels.link_cells(inside, cells, measured, push, np.float32(trust_m), places, links, floors, loads)
    if start is not None:
        np.copyto(gap, start.gap_m, where=inside & cells.known)
    equations = places, links, floors, even
    kernels.settle(gap.reshape(-1), gap.shape[1], equations, loads, _FACTOR, _TOLERANCE_M, _MAX_SWEEPS)
    gap[~cells.known] = FAR_M
    return Equilibrium(gap, guess, measured - gap, inside & cells.known & (gap <= 0))


#: Sigma of the window over blocks of tactile pixels.
_WINDOW_BLOCKS: Final = 2.5
#: Share of a window that must have depth.
_MIN_DEPTH_SHARE: Final = np.float32(0.7)
#: With fewer blocks the usual curvature is assumed, 1/m; other values are limited.
_MIN_BLOCKS: Final = 100
USUAL_PER_M: Final = 10.0
LIMITS_PER_M: Final = (3.0, 40.0)


def usable_curvature_per_m(measured_per_m: float) -> float:
    """Return a measured curvature within limits; the usual one for nan."""
    return USUAL_PER_M if math.isnan(measured_per_m) else float(np.clip(measured_per_m, *LIMITS_PER_M))


def measured_curvature_per_m(frame: SensorFrame, alignment: AlignmentSection, rig: Rig) -> float:
    """Measure twice the mean curvature of the free membrane, 1/m; nan without enough tactile depth.

    It is the median over the tactile image: contact is flatter or dented, but covers less than half of what the camera
    sees, and noise has no mean.
    """
    import cv2

    camera = rig.tactile.intrinsics
    shape = camera.height // BLOCK_PX, camera.width // BLOCK_PX
    if min(shape) < 3:
        return math.nan
    unit_m, offset_m = rig.tactile.depth_unit_m * alignment.depth_scale, alignment.depth_offset_m
    # Points are averaged, not depths: at the image's border their mean is shifted, but lies on the surface.
    mean, share, bulge = np.empty((3, *shape), np.float32)
    sums = np.empty((2, shape[1] * BLOCK_PX), np.int32)
    average_cells(frame.tactile_depth, 0, 0, 4, sums, mean, share)  # every fourth row tells enough
    z = share * (mean * np.float32(unit_m) + np.float32(offset_m))
    points = np.dstack([_rays_of_blocks(camera) * z[..., None], z, share])
    membrane_kernels.bulges(
        cv2.GaussianBlur(points, (0, 0), _WINDOW_BLOCKS, borderType=cv2.BORDER_CONSTANT), _MIN_DEPTH_SHARE, bulge
    )
    bulge = bulge[~np.isnan(bulge)]
    if len(bulge) < _MIN_BLOCKS:
        return math.nan
    middle = len(bulge) // 2
    return float(np.partition(bulge, middle)[middle])


@lru_cache(maxsize=8)
def _rays_of_blocks(camera: Intrinsics) -> Float32Array:
    """Return ``(x / z, y / z)`` at the centre of each block, shape (h, w, 2)."""
    rays = ray_table(camera)[: camera.height // BLOCK_PX * BLOCK_PX, : camera.width // BLOCK_PX * BLOCK_PX]
    squares = rays.reshape(camera.height // BLOCK_PX, BLOCK_PX, camera.width // BLOCK_PX, BLOCK_PX, 2)
    return np.ascontiguousarray(squares.mean(axis=(1, 3)), np.float32)
