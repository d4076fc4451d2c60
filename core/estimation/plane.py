"""The plane of some depth points, and the covariance of its errors, from the noise of both cameras.

Points are summed in square cells of the image, because the noise of neighbouring cells has a covariance in closed form.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from scipy.special import erf

from ..model.arrays import Float32Array, Float64Array, IndexArray
from ..model.intrinsics import Intrinsics
from ..preset import CameraNoise

#: Most cells along a side of the patch, and their smallest side, pixels.
_MAX_CELLS, _MIN_CELL_PX = 24, 4.0
#: Before the points are seen: standard deviation of the other coefficients over the patch, 1/m, and of dz/dx and dz/dy.
_ANY_PER_M, _ANY_SLOPE = 100.0, 3.0
#: Number of coefficients of a plane, and of the quadratic surface that contains it.
_PLANE, _QUADRATIC = 3, 6


#: Lower limit of the white noise of a camera: none is exact, metres.
_MIN_WHITE_M: Final = 1e-6


@dataclass(frozen=True)
class DepthNoise:
    """Errors of a camera's depth in pixels of the proximity image.

    Attributes
    ----------
    white_m, shared_m : float
        Standard deviations of the part that differs from pixel to pixel and of the part that neighbours share, at
        ``distance_m``.
    length_px : float
        Two pixels at a distance of d pixels share exp(-d^2 / (4 length_px^2)) of the second part.
    fixed_share : float
        Share of the second part's variance that stays from frame to frame.
    distance_m : float
    power : int
        Standard deviations grow with this power of the depth.
    """

    white_m: float
    shared_m: float
    length_px: float
    fixed_share: float
    distance_m: float
    power: int

    @classmethod
    def of(cls, noise: CameraNoise, pixels: float, power: int) -> DepthNoise:
        """Return the measured noise of a camera of which one pixel covers ``pixels`` pixels of the proximity image."""
        shared = noise.correlated_m**2
        changing = noise.changing_share * noise.total_m**2 - noise.white_m**2  # white noise changes
        fixed_share = 1.0 - min(max(changing / shared, 0.0), 1.0) if shared > 0 else 0.0
        return cls(
            max(noise.white_m, _MIN_WHITE_M) * pixels,
            noise.correlated_m,
            noise.length_px * pixels,
            fixed_share,
            noise.distance_m,
            power,
        )

    def power_m2(self, depth_m: Float64Array) -> Float64Array:
        """Return the variance of a mean over many pixels times their number, m^2."""
        growth = (depth_m / self.distance_m) ** (2 * self.power)
        return (self.white_m**2 + 4 * math.pi * (self.shared_m * self.length_px) ** 2) * growth


@dataclass(frozen=True)
class Cells:
    """Sums over square cells of the image; arrays have one entry for each cell with points, shape (K,).

    Attributes
    ----------
    rows, columns : int
        Size of the grid.
    size_px : float
        Side of a cell.
    place : int
        Flat number of each cell in the grid.
    count : float
        Number of points.
    x, y : float
        Means of x / z and y / z.
    inverse_m : float
        Mean of 1 / z.
    difference_m : float or None
        Mean difference of both depths.
    """

    rows: int
    columns: int
    size_px: float
    place: IndexArray
    count: Float64Array
    x: Float64Array
    y: Float64Array
    inverse_m: Float64Array
    difference_m: Float64Array | None

    @classmethod
    def of(cls, points: Float32Array, difference_m: Float32Array | None, lens: Intrinsics) -> Cells:
        """Sort points, shape (N, 3), N > 0, into cells; cells without any known difference are left out."""
        inverse = 1 / points[:, 2]
        x, y = points[:, 0] * inverse, points[:, 1] * inverse
        left, top = float(x.min()), float(y.min())
        width, height = lens.fx * (float(x.max()) - left), lens.fy * (float(y.max()) - top)
        # in steps of half a pixel, so that the tables of `shared_by_cells` serve again
        size = max(_MIN_CELL_PX, math.ceil(2 * max(width, height) / (_MAX_CELLS - 1)) / 2)
        rows, columns = int(height / size) + 2, int(width / size) + 2
        row, column = (y - top) * (lens.fy / size), (x - left) * (lens.fx / size)
        index = row.astype(np.intp) * columns + column.astype(np.intp)
        count = np.bincount(index, minlength=rows * columns)
        kept, difference = count > 0, None
        if difference_m is not None:
            known = np.isfinite(difference_m)
            seen = np.bincount(index, known, rows * columns)
            total = np.bincount(index, np.where(known, difference_m, 0.0), rows * columns)
            kept = seen > 0
            difference = total[kept] / seen[kept]
        place = np.flatnonzero(kept)
        number = count[place].astype(np.float64)
        x, y, inverse = (np.bincount(index, values, rows * columns)[place] / number for values in (x, y, inverse))
        return cls(rows, columns, size, place, number, x, y, inverse, difference)

    @property
    def depth_m(self) -> Float64Array:
        """Depth of each cell, metres."""
        return 1.0 / self.inverse_m


class Functionals:
    """Weighted least squares of the inverse depth as linear functionals of the cells.

    The first three are the plane 1 / z = a + b x / z + c y / z. The other five are the components of the field along
    orthonormal slopes and quadratic surfaces.

    Parameters
    ----------
    cells : Cells
    weights : float, shape (K,)
        Inverse variances of the cells' inverse depths, m^2.
    focal_px : float
    """

    def __init__(self, cells: Cells, weights: Float64Array, focal_px: float) -> None:
        self.cells = cells
        share = weights / weights.sum()
        (x, mean_x, scale_x), (y, mean_y, scale_y) = (
            _normalised(values, share, cells.size_px / focal_px) for values in (cells.x, cells.y)
        )
        root = np.sqrt(weights)
        basis = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y]) * root
        any_slope = _ANY_SLOPE * float(share @ cells.inverse_m)
        before = np.array([_ANY_PER_M, any_slope * scale_x, any_slope * scale_y, *[_ANY_PER_M] * (_QUADRATIC - _PLANE)])
        inverse = np.linalg.inv(np.linalg.cholesky(basis @ basis.T + np.diag(before**-2)))
        modes = inverse @ basis
        from_normalised = np.array(
            [[1.0, -mean_x / scale_x, -mean_y / scale_y], [0.0, 1.0 / scale_x, 0.0], [0.0, 0.0, 1.0 / scale_y]]
        )
        from_modes = from_normalised @ inverse[:_PLANE, :_PLANE].T
        #: Shape (8, K).
        self.matrix = np.vstack([from_modes @ modes[:_PLANE], modes[1:]]) * root
        lost = from_modes @ inverse[:_PLANE, :_PLANE] / before[:_PLANE]
        #: Covariance of the plane's coefficients from what the points do not tell, shape (3, 3).
        self.unknown = lost @ lost.T

    def covariance(self, noise: DepthNoise, averaged_frames: int) -> tuple[Float64Array, Float64Array]:
        """Return the covariance of the functionals, shape (8, 8), from the noise of one camera.

        Returns
        -------
        all, fixed : float, shape (8, 8)
            The whole, and the part of it that stays from frame to frame.
        """
        cells = self.cells
        scaled = self.matrix * (cells.inverse_m**2 * (cells.depth_m / noise.distance_m) ** noise.power)
        white = (scaled * (noise.white_m**2 / cells.count)) @ scaled.T
        grid = np.zeros((len(scaled), cells.rows, cells.columns))
        grid.reshape(len(scaled), -1)[:, cells.place] = scaled
        along, across = (shared_by_cells(noise.length_px, cells.size_px, n) for n in (cells.rows, cells.columns))
        shared = noise.shared_m**2 * np.einsum("aij,bij->ab", along @ grid @ across, grid)
        fixed = noise.fixed_share * shared
        return (white + shared - fixed) / averaged_frames + fixed, fixed


def _normalised(values: Float64Array, share: Float64Array, cell: float) -> tuple[Float64Array, float, float]:
    """Return values with mean 0 and deviation 1, their mean and their deviation; a cell has a width, too."""
    mean = float(share @ values)
    scale = math.sqrt(float(share @ (values - mean) ** 2) + cell**2 / 12)
    return (values - mean) / scale, mean, scale


@lru_cache(maxsize=256)
def shared_by_cells(length_px: float, size_px: float, count: int) -> Float64Array:
    """Return the covariances of the means over ``count`` intervals side by side, shape (count, count).

    The process has the covariance exp(-d^2 / (4 length_px^2)). Twice integrated, it gives the covariance of two means.
    """
    if length_px <= 0:
        return np.zeros((count, count))
    distance = np.arange(-1, count + 1) * (size_px / (2 * length_px))
    twice = math.sqrt(math.pi) / 2 * distance * erf(distance) + np.exp(-(distance**2)) / 2
    means = np.diff(twice, 2) * (2 * length_px / size_px) ** 2
    steps = np.arange(count)
    result: Float64Array = means[np.abs(steps[:, None] - steps)]
    return result
