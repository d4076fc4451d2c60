"""Contact as an obstacle problem: where a membrane in equilibrium of tension and pressure touches the object.

A free membrane of tension T under the pressure p has twice the mean curvature p / T (Young-Laplace). For an object of
curvature k, the gap g between membrane and object satisfies laplacian(g) = p / T - k on the surface. In contact g is
0, and g is never negative: an obstacle problem (Kinderlehrer and Stampacchia, "An Introduction to Variational
Inequalities and Their Applications", 1980, chapter 1). Both cameras measure the gap, with noise and a bias b. The gap
minimises, over a surface,

    |grad g|^2 / 2 + (p / T - k) g + (g - (measured - b))^2 / (2 L^2),    g >= 0,

where L is the length over which equilibrium is trusted more than the measured gap. Noise that is shorter than L is
averaged, and the edge of contact is where the membrane leaves the object, not where a threshold is passed.

Assumed: the same tension in all directions, no friction, small slopes between membrane and object.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from ...model.arrays import BoolArray, Float32Array
from ...model.clouds import ray_table
from ...model.frames import Rig
from ..kernels import equilibrium as kernels
from ..kernels.membrane import RayWindow, bulges
from ..kernels.threads import by_rows
from .differences import Differences

#: Side of the cells, pixels.
CELL_PX: Final = 3
#: Share of a cell's window that must be usable for a gap, for the object's curvature, and for its slope.
_MIN_SHARE, _MIN_SHARE_OF_SHAPE, _MIN_SHARE_OF_SLOPE = np.float32(0.4), np.float32(0.5), np.float32(0.05)
#: Excluded share from which a cell takes no part.
_MAX_EXCLUDED: Final = np.float32(0.5)
#: Sigma of the window over which the first guess of the gap is averaged, pixels.
GUESS_PX: Final = 2.5
#: How far the object's curvature is extrapolated, pixels.
_REACH_PX: Final = 16.0
#: The gap is solved for where the measured one is below the first; at the border of what is seen, below the second.
_MAX_GAP_M, _MAX_GAP_AT_BORDER_M = np.float32(0.005), np.float32(0.0014)
#: Lower limit of p / T - k, 1/m; it holds where the object is hollow and curves more strongly than the free membrane.
_MIN_PUSH_PER_M: Final = np.float32(2.0)
#: A gap far above all others, for cells without a known gap, metres.
FAR_M: Final = np.float32(0.01)
_RELAXATION: Final = kernels.Relaxation(np.float32(1.7), np.float32(1e-5), 300)


@dataclass(frozen=True, eq=False)
class Cells:
    """Square cells of pixels with what the obstacle problem needs; images are (H, W), framed by one unknown cell.

    Attributes
    ----------
    difference_m : float32
        Mean difference of both depths along the ray.
    share : float32
        Share of pixels that take part.
    near_share : float32
        That share averaged over the window of the first guess, from `over_window`.
    known : bool
        Whether enough pixels near it take part.
    push_per_m : float32
        p / T - k: twice the mean curvature of the free membrane less that of the object.
    sides_m : float32, shape (2, H, W)
        Length along the surface to the right and down.
    facing : float32
        Ratio of a gap along the normal to the difference along the ray.
    size_px : int
    """

    difference_m: Float32Array
    share: Float32Array
    near_share: Float32Array
    known: BoolArray
    push_per_m: Float32Array
    sides_m: Float32Array
    facing: Float32Array
    size_px: int

    @property
    def area_m2(self) -> Float32Array:
        """Usable area of each cell, (H, W)."""
        return np.asarray(self.share * self.sides_m[0] * self.sides_m[1])


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """The solution: gaps along the normal in the cells, with the frame of unknown cells.

    Attributes
    ----------
    gap_m : float32, shape (H, W)
        0 in contact; large where nothing is known.
    guess_m : float32, shape (H, W)
        The local mean of the measured gap.
    residual_m : float32, shape (H, W)
        The measured gap less the solution.
    touching : bool, shape (H, W)
    """

    gap_m: Float32Array
    guess_m: Float32Array
    residual_m: Float32Array
    touching: BoolArray


def cells_of(
    differences: Differences, size_px: int, shape_px: float, free_per_m: float, near_m: tuple[float, float], rig: Rig
) -> Cells | None:
    """Average differences and the object's shape over cells; None if the image is smaller than three cells.

    Parameters
    ----------
    size_px : int
        Side of a cell.
    shape_px : float
        Sigma of the window over which the object's shape is averaged, pixels.
    free_per_m : float
        Twice the mean curvature of the free membrane.
    near_m : tuple of float
        Centre and limit: only differences nearer than the limit to the centre take part.
    """
    import cv2

    camera, (height, width) = rig.proximity.intrinsics, differences.usable.shape
    if min(height, width) < 3 * size_px:
        return None
    means = np.zeros((6, -(-height // size_px) + 2, -(-width // size_px) + 2), np.float32)
    window = kernels.DifferenceWindow(
        differences.difference_m, differences.usable, differences.excluded, differences.counts, differences.unit_m,
        np.float32(differences.bias_m), np.float32(near_m[0]), np.float32(near_m[1]),
    )  # fmt: skip
    rays, inner = RayWindow(ray_table(camera), *differences.corner), means[:, 1:-1, 1:-1]
    by_rows(lambda first, last: kernels.average_cells(window, size_px, rays, first, last, inner), inner.shape[1])
    difference, share, *_, excluded = means
    sigma = max(shape_px / size_px, 0.3)
    smooth = np.empty((4, *share.shape), np.float32)
    for part, out in zip(means[1:5], smooth, strict=True):
        cv2.GaussianBlur(part, (0, 0), sigma, out, borderType=cv2.BORDER_CONSTANT)
    weight, points = smooth[0], smooth[1:]
    points /= np.maximum(weight, np.float32(1e-6))
    bulge, sides, facing = np.empty_like(share), np.empty((2, *share.shape), np.float32), np.empty_like(share)
    bulges(points, weight, _MIN_SHARE_OF_SHAPE, bulge)
    kernels.measure_cells(
        points, weight, _MIN_SHARE_OF_SLOPE, (size_px / camera.fx, size_px / camera.fy), sides, facing
    )
    push = np.maximum(np.float32(free_per_m) - _extrapolated(bulge, _REACH_PX / size_px), _MIN_PUSH_PER_M)
    near = over_window(share, size_px)
    known = np.zeros(share.shape, np.bool_)
    known[1:-1, 1:-1] = ((near > _MIN_SHARE) & (excluded < _MAX_EXCLUDED))[1:-1, 1:-1]
    return Cells(difference, share, near, known, push, sides, facing, size_px)


def over_window(image: Float32Array, size_px: int) -> Float32Array:
    """Average an image of cells of ``size_px`` over the Gaussian window of `GUESS_PX`."""
    import cv2

    return np.asarray(cv2.GaussianBlur(image, (0, 0), GUESS_PX / size_px, borderType=cv2.BORDER_CONSTANT))


def settle(cells: Cells, bias_m: float, trust_m: float, start: Equilibrium | None = None) -> Equilibrium:
    """Solve the obstacle problem.

    Parameters
    ----------
    bias_m : float
        Subtracted from the differences.
    trust_m : float
        Length over which equilibrium is trusted more than the measured gap.
    start : Equilibrium, optional
        That of the same cells with another bias.
    """
    measured = (cells.difference_m - np.float32(bias_m)) * cells.facing
    total = over_window(cells.share * measured, cells.size_px)
    guess = np.asarray(total / np.maximum(cells.near_share, np.float32(1e-6)), np.float32)
    inside = np.empty(guess.shape, np.bool_)
    size = kernels.mark_inside(guess, cells.known, _MAX_GAP_M, _MAX_GAP_AT_BORDER_M, inside)
    places, links = np.empty(size, np.int32), np.empty((7, size), np.float32)
    even = kernels.link_cells(inside, cells.known, cells.sides_m, cells.share, np.float32(trust_m), places, links)
    loads = links[4] * measured.reshape(-1)[places] - links[5] * cells.push_per_m.reshape(-1)[places]
    gap = np.maximum(guess, np.float32(0))
    if start is not None:
        np.copyto(gap, start.gap_m, where=inside)
    kernels.settle(gap.reshape(-1), gap.shape[1], kernels.Equations(places, links, even), loads, _RELAXATION)
    gap[~cells.known] = FAR_M
    return Equilibrium(gap, guess, measured - gap, inside & (gap <= 0))


def to_pixels(
    cells: Cells, image: Float32Array, shape: tuple[int, int], box: tuple[slice, slice] = (slice(None), slice(None))
) -> tuple[Float32Array, BoolArray]:
    """Interpolate an image of the cells, or of a part of them, to pixels; ``box`` does not count the unknown frame.

    Returns
    -------
    pixels : float32, shape (H, W)
        Interpolated between known cells; far in the others.
    border : bool, shape (H, W)
        Whether a cell near the pixel is unknown.
    """
    import cv2

    known, (height, width) = cells.known[1:-1, 1:-1][box], shape
    size = known.shape[1] * cells.size_px, known.shape[0] * cells.size_px
    weight = known.view(np.uint8).astype(np.float32)
    inside = cv2.resize(weight, size, interpolation=cv2.INTER_NEAREST)[:height, :width] > 0
    total = cv2.resize(weight * image[1:-1, 1:-1][box], size, interpolation=cv2.INTER_LINEAR)[:height, :width]
    share = cv2.resize(weight, size, interpolation=cv2.INTER_LINEAR)[:height, :width]
    pixels = np.where(inside, total / np.maximum(share, np.float32(1e-6)), FAR_M)
    return np.asarray(pixels, np.float32), np.asarray(inside & (share < 1))


def _extrapolated(image: Float32Array, reach_cells: float) -> Float32Array:
    """Return an image whose nan cells have the value of the nearest other cell within reach, and 0 beyond."""
    import cv2

    unknown = np.isnan(image)
    way, labels = cv2.distanceTransformWithLabels(
        unknown.view(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    of_label = np.append(np.float32(0), image[~unknown])  # known cells are labelled in their order, from 1
    return np.where(way <= reach_cells, np.take(of_label, np.asarray(labels, np.int32)), np.float32(0))
