"""Square cells of pixels: the measured gap, the object's surface, and the membrane beside the object."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np

from ...model.arrays import BoolArray, Float32Array
from ...model.clouds import ray_table
from ...model.frames import Rig
from ..kernels import cells as kernels
from ..kernels.cells import MembraneImage
from ..kernels.membrane import RayWindow
from ..kernels.threads import in_parallel
from .differences import Differences

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


@dataclass(frozen=True, eq=False)
class Cells:
    """Square cells of pixels for the obstacle problem; images are (H, W), with a `FRAME` of unknown cells."""

    #: Mean difference of both depths along the ray. Beside the object: that of its tangent plane and the membrane.
    difference_m: Float32Array
    share: Float32Array  # Share of pixels that take part
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
    sums = kernels.CellSums(np.zeros(shape, np.float32), np.zeros(shape, np.float32), np.zeros((*shape, 4), np.float32))
    window = kernels.DifferenceWindow(
        differences.difference_m, differences.usable, differences.excluded, differences.counts, differences.unit_m,
        np.float32(differences.bias_m), np.float32(near_m[0]), np.float32(near_m[1]),
    )  # fmt: skip
    rays = RayWindow(ray_table(camera), *differences.corner)
    step = 2 if size_px % 4 == 0 else 1  # neighbours share noise, so every fourth pixel is enough for large cells
    in_parallel(partial(kernels.average_cells, window, size_px, step, rays, FRAME, sums), shape[0] - 2 * FRAME)
    difference, excluded, points = sums
    share, known = points[..., 3].copy(), np.zeros(shape, np.bool_)
    known[INNER] = ((over_window(share, size_px) > _MIN_SHARE) & (excluded < _MAX_EXCLUDED))[INNER]
    share *= known

    smooth = cv2.GaussianBlur(points, (0, 0), max(shape_px / size_px, 0.3), borderType=cv2.BORDER_CONSTANT)
    surface = kernels.Surface(
        np.empty(shape, np.float32), np.empty((2, *shape), np.float32), np.empty(shape, np.float32)
    )
    kernels.measure_cells(smooth, _MIN_SHARES_OF_SURFACE, (size_px / camera.fx, size_px / camera.fy), surface)
    queue, sources = np.empty((2, share.size), np.int32)
    kernels.extrapolate(surface.bulges, known, round(_REACH_PX / size_px), queue)
    push = np.maximum(np.float32(free_per_m) - surface.bulges, _MIN_PUSH_PER_M)

    top, left = (start - FRAME * size_px for start in differences.corner)
    grid = kernels.CellGrid(rays.rays, top, left, size_px)
    linked, weight, planes = known.copy(), share.copy(), np.empty((3, share.size), np.float32)
    beside = kernels.BesideCells(linked, difference, weight, sources, queue, planes)
    reach = -(-_BESIDE_PX // size_px)
    limits = near_m[0], _WRONG_M
    kernels.continue_beside(known, excluded, points, surface, grid, membrane, limits, reach, beside)
    push[linked & ~known] = free_per_m
    near = over_window(share, size_px)
    return Cells(difference, share, weight, near, known, linked, push, surface.sides, surface.facing, size_px)


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
