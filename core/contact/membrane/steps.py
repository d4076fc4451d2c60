"""The steps of the membrane contact test, each on plain images: local means, bias, slope, edge of contact.

Images here are cut to where anything may touch; ``usable`` marks the pixels that have both depths, a
small difference between them, and no print that hides the object.
"""

from __future__ import annotations

import math
from copy import copy
from typing import TYPE_CHECKING

import numpy as np

from ...model.arrays import AnyArray, BoolArray, Float32Array
from ..kernels import membrane as kernels
from ..kernels.threads import scratch

if TYPE_CHECKING:
    from cv2.typing import MatLike


#: Fewer pixels tell no bias.
_FEWEST = 200
#: Bins of the histogram of differences, metres, and how far it is smoothed, bins.
_BIN_M, _SMOOTH_BINS = 1e-4, 3.0
#: The steepest slope for which the gap along the optical axis is turned into one along the normal.
_LEAST_FACING = np.float32(0.25)
#: How far the estimated distances to the edge are smoothed along it, sigma in pixels.
_ALONG_EDGE_PX = 2.0
#: How far beyond the pixels that may be contact an image must reach so that its own border changes nothing: as far
#: as gaps and distances are smoothed along the edge.
EDGE_MARGIN_PX = 12


class LocalMean:
    """Means over the usable pixels near each one, with Gaussian weights.

    Parameters
    ----------
    usable : bool, shape (H, W)
    sigma_px : float
        Of the weights, cut off at twice that; 0 takes each pixel by itself.

    Attributes
    ----------
    share : float32, shape (H, W)
        Which share of each pixel's surroundings is usable.
    """

    def __init__(self, usable: BoolArray, sigma_px: float) -> None:
        self.sigma_px = sigma_px
        self._size = (window_reach(sigma_px) * 2 + 1,) * 2
        self._weight = usable.view(np.uint8).astype(np.float32)
        self.share = self._blurred(self._weight)
        self._divisor = np.maximum(self.share, np.float32(1e-6))

    def of(self, image: Float32Array) -> Float32Array:
        """Return the means of an image, float32, shape (H, W), which is finite everywhere."""
        weighted = image * self._weight
        return weighted if self.sigma_px == 0 else np.divide(self._blurred(weighted), self._divisor)

    def cut(self, place: tuple[slice, slice]) -> LocalMean:
        """Return the same for a part of the image."""
        part = copy(self)
        part.share, part._weight, part._divisor = (
            np.ascontiguousarray(image[place]) for image in (self.share, self._weight, self._divisor)
        )
        return part

    def _blurred(self, image: Float32Array) -> Float32Array:
        import cv2  # here and below: what only loads the pipeline need not wait for it

        return image if self.sigma_px == 0 else np.asarray(cv2.GaussianBlur(image, self._size, self.sigma_px))


def window_reach(sigma_px: float) -> int:
    """Return how many pixels away a window's last weights lie."""
    return int(np.ceil(2 * sigma_px))


def print_bias_m(difference_m: Float32Array) -> float:
    """Return the bias between both sensors from where both see the membrane itself; 0 where too few pixels tell.

    Parameters
    ----------
    difference_m : float32, shape (N,)
        Proximity less tactile depth where opaque prints reflect infrared.
    """
    return float(np.median(difference_m)) if len(difference_m) >= _FEWEST else 0.0


def contact_bias_m(gap_m: Float32Array, known: BoolArray, limit_m: float) -> float:
    """Return the most frequent gap: an object in contact shows one, a membrane that leaves it all sizes.

    Parameters
    ----------
    gap_m : float32, shape (H, W)
        Local means, after the bias that prints tell.
    known : bool, shape (H, W)
        Where there is a gap at all.
    limit_m : float
        The largest bias believed.
    """
    import cv2

    edges = np.arange(-limit_m, limit_m + _BIN_M / 2, _BIN_M)
    if len(edges) < 2:
        return 0.0
    counts = np.zeros(len(edges) - 1, np.int64)
    if kernels.count_gaps(gap_m, known, np.float32(limit_m), edges, counts) < _FEWEST:
        return 0.0
    smooth = cv2.GaussianBlur(counts[None].astype(np.float32), (0, 0), _SMOOTH_BINS)[0]
    best = int(np.argmax(smooth))
    return float(edges[best] + edges[best + 1]) / 2


def turn_to_normal(
    gap_m: Float32Array,
    depth_m: Float32Array,
    rays: Float32Array,
    corner: tuple[int, int],
    focal_px: tuple[float, float],
) -> None:
    """Turn gaps along the optical axis into ones along the surface's normal, in place, where it is not too steep.

    With x = z (u - cx) / fx and y = z (v - cy) / fy the normal of z(u, v) is along
    (-fx z_u, -fy z_v, z + (u - cx) z_u + (v - cy) z_v).

    Parameters
    ----------
    gap_m, depth_m : float32, shape (H, W)
        The depth is smooth.
    rays : float32
        ``(x / z, y / z)`` of each pixel of the whole image.
    corner : tuple of int
        Row and column of the image at which the gaps begin.
    focal_px : tuple of float
        ``(fx, fy)``.
    """
    import cv2

    along_x, along_y = (
        cv2.Sobel(depth_m, cv2.CV_32F, *order, scale=focal / 8)
        for order, focal in zip(((1, 0), (0, 1)), focal_px, strict=True)
    )
    kernels.turn_to_normal(gap_m, depth_m, along_x, along_y, rays, *corner, _LEAST_FACING)


def erode_rim(
    near: BoolArray,
    wide: BoolArray,
    far: float,
    share: float,
    core: float,
    max_erosion_px: float,
) -> BoolArray:
    """Take away the rim where a membrane that leaves tangentially is still near the object.

    There the gap grows with the square of the way s from the edge of contact, so its root grows with s. Between the
    lines where the gap is g and ``far`` g lies a way w, so the edge is s = w / (sqrt(far) - 1) inside the first. Where
    the object ends both lines are one, and nothing is taken away.

    Parameters
    ----------
    near, wide : bool, shape (H, W)
        Gap below the limit, and below ``far`` times the limit.
    far : float
        Above 1.
    share : float
        Which share of s is taken.
    core : float
        Pixels that are at least this share as far from the border as the farthest one within 0.65 ``max_erosion_px``
        stay: noise bends the lines about narrow contacts.
    max_erosion_px : float
        The largest s.
    """
    import cv2

    padded, padded_wide = (
        cv2.copyMakeBorder(image.view(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0) for image in (near, wide)
    )
    factor = np.float32(1 / (math.sqrt(far) - 1))
    inside, labels = cv2.distanceTransformWithLabels(padded, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    between = cv2.distanceTransform(padded_wide, cv2.DIST_L2, 5)
    of_label, ways = scratch("ways", padded.size + 1, np.float32), np.empty(padded.shape, np.float32)
    kernels.spread_ways(padded, labels, between, factor, np.float32(max_erosion_px), of_label, ways)
    taken = cv2.GaussianBlur(ways, (0, 0), _ALONG_EDGE_PX)
    window = 2 * int(np.ceil(0.65 * max_erosion_px)) + 1
    middle = cv2.dilate(inside, np.ones((window, window), np.uint8))
    deep = (inside > np.float32(share) * taken) | (inside > np.float32(core) * middle)
    return np.asarray(near & _unpadded(deep))


def surroundings(marked: BoolArray, margin_px: int, vectors: int = 1) -> tuple[slice, slice] | None:
    """Return the rectangle of an image that holds all marked pixels and so many about them; None without any.

    With ``vectors`` it begins at a multiple of that column and ends so many later: OpenCV rounds the last columns of an
    image otherwise than those that it takes as vectors, and so marked pixels get the same bits as in the whole image.
    """
    rows, columns = (np.flatnonzero(marked.any(axis=axis)) for axis in (1, 0))
    if len(rows) == 0:
        return None
    height, width = marked.shape
    first = max(int(columns[0]) - margin_px, 0) // vectors * vectors
    return (
        slice(max(int(rows[0]) - margin_px, 0), min(int(rows[-1]) + 1 + margin_px, height)),
        slice(first, min(int(columns[-1]) + margin_px + vectors, width)),
    )


def _unpadded(image: AnyArray | MatLike) -> AnyArray:
    return np.asarray(image[1:-1, 1:-1])
