"""Local means of the gap between membrane and object: bias, slope, the edge of contact, small groups, points.

Images are cropped to where anything may touch. ``usable`` marks pixels that have both depths with a small difference
between them, and no print that hides the object.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from ...model.arrays import AnyArray, BoolArray, Float32Array
from ...model.clouds import ray_table
from ...model.frames import Rig
from ...model.patch import Candidates
from ...preset import MembraneSection
from ..finder import CandidateBuffers
from ..kernels import membrane as kernels
from ..kernels.simd import LANES
from ..kernels.threads import scratch
from ..outliers.clusters import in_large_cluster

if TYPE_CHECKING:
    from cv2.typing import MatLike

#: Share of a pixel's window that must be usable for a gap, and in contact for a point.
_MIN_SHARE, _MIN_SHARE_OF_POINT = np.float32(0.4), np.float32(0.05)
#: The edge is extrapolated from the isolines g and FAR * g of the gap. FAR * g must stay below this share of the
#: largest difference, beyond which gaps are unknown.
_FAR: Final = 2.5
_MAX_FAR_SHARE: Final = 0.9
#: Isolines that are closer than this ratio give no edge.
_MIN_FAR: Final = 1.3
#: Fewer pixels give no bias.
_MIN_BIAS_PIXELS: Final = 200
#: Bin width of the histogram of differences, metres, and sigma of its smoothing, bins.
_BIN_M, _SMOOTH_BINS = 1e-4, 3.0
#: The steepest slope, as cosine, for which a gap along the optical axis is converted to one along the normal.
_MIN_FACING = np.float32(0.25)
#: Sigma with which the estimated distances to the edge are smoothed along it, pixels.
_ALONG_EDGE_PX: Final = 2.0
#: Margin around the pixels that may be contact so that the crop's border changes nothing: the reach of the smoothing.
EDGE_MARGIN_PX: Final = 12


@dataclass(frozen=True, eq=False)
class Differences:
    """Both depths in the bounding box of the usable pixels, padded by their windows; images are (H, W).

    Attributes
    ----------
    place : tuple of slice
        Rows and columns of the rectangle.
    difference_m : float32
        Proximity less tactile depth; 0 where it is too large.
    depth_m : float32
        Proximity depth.
    usable : bool
        Has both depths, less than the largest difference between them, and not the bare membrane's colour.
    excluded : bool
        Outside the region or range.
    print_bias_m : float
        The bias between both cameras, measured on prints of that colour.
    """

    place: tuple[slice, slice]
    difference_m: Float32Array
    depth_m: Float32Array
    usable: BoolArray
    excluded: BoolArray
    print_bias_m: float

    @property
    def corner(self) -> tuple[int, int]:
        """Row and column at which the rectangle begins."""
        return self.place[0].start, self.place[1].start

    def cut(self, part: tuple[slice, slice]) -> Differences:
        """Return the differences of a part of the rectangle."""
        (top, left), (rows, columns) = self.corner, part
        return Differences(
            (slice(top + rows.start, top + rows.stop), slice(left + columns.start, left + columns.stop)),
            np.ascontiguousarray(self.difference_m[part]),
            np.ascontiguousarray(self.depth_m[part]),
            np.ascontiguousarray(self.usable[part]),
            np.ascontiguousarray(self.excluded[part]),
            self.print_bias_m,
        )


@dataclass(frozen=True, eq=False)
class Gaps:
    """Local means of the gap between membrane and object.

    Attributes
    ----------
    gap_m : float32, shape (H, W)
        Corrected for the bias between the cameras, along the surface normal.
    known : bool, shape (H, W)
        Where enough pixels are usable.
    bias_m : float
        What was subtracted from the differences before they were converted to the normal.
    differences : Differences
        The averaged differences, cropped to the surroundings of the known gaps.
    """

    gap_m: Float32Array
    known: BoolArray
    bias_m: float
    differences: Differences


class LocalMean:
    """Means over the usable pixels near each one, with Gaussian weights.

    Parameters
    ----------
    usable : bool, shape (H, W)
    sigma_px : float
        Of the weights, truncated at twice that; 0 averages nothing.

    Attributes
    ----------
    share : float32, shape (H, W)
        Usable share of each pixel's window.
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
        """Return the means of a part of the image."""
        part = copy(self)
        part.share, part._weight, part._divisor = (
            np.ascontiguousarray(image[place]) for image in (self.share, self._weight, self._divisor)
        )
        return part

    def _blurred(self, image: Float32Array) -> Float32Array:
        import cv2  # here and below: importing the pipeline must not wait for it

        return image if self.sigma_px == 0 else np.asarray(cv2.GaussianBlur(image, self._size, self.sigma_px))


def mean_gaps(everywhere: Differences, section: MembraneSection, rig: Rig) -> Gaps | None:
    """Return the local mean gaps, corrected for bias and slope; None if no window has enough usable pixels."""
    camera, margin_px = rig.proximity.intrinsics, window_reach(section.window_px) + EDGE_MARGIN_PX
    means = LocalMean(everywhere.usable, section.window_px)
    known = (means.share > _MIN_SHARE) & ~everywhere.excluded
    part = surroundings(known, margin_px, vectors=LANES)
    if part is None:
        return None
    differences, means, known = everywhere.cut(part), means.cut(part), np.ascontiguousarray(known[part])
    bias_m = differences.print_bias_m if section.bias_m > 0 else 0.0
    gap = means.of(differences.difference_m - np.float32(bias_m))
    if section.bias_m > 0:
        # half of it, because with little contact the most frequent gap is not that of contact
        contact_m = np.float32(contact_bias_m(gap, known, section.bias_m) / 2)
        gap -= contact_m
        bias_m += float(contact_m)
    if section.slope:
        smoothing = means if section.window_px >= 1 else LocalMean(differences.usable, 1.0)
        depth = smoothing.of(differences.depth_m)
        turn_to_normal(gap, depth, ray_table(camera), differences.corner, (camera.fx, camera.fy))
    return Gaps(gap, known, bias_m, differences)


def within_edge(gaps: Gaps, section: MembraneSection) -> BoolArray:
    """Return the pixels that are near the object, without the rim where the membrane leaves it."""
    near = near_pixels(gaps, section)
    far = min(_FAR, _MAX_FAR_SHARE * section.difference_m / section.gap_m) if section.gap_m > 0 else _FAR
    if section.erosion == 0 or far < _MIN_FAR:
        return near
    wide = gaps.known & (gaps.gap_m < np.float32(far * section.gap_m))
    return erode_rim(near, wide, far, section.erosion, section.core_share, section.max_erosion_px)


def near_pixels(gaps: Gaps, section: MembraneSection) -> BoolArray:
    """Return the pixels whose mean gap is below the preset's largest gap."""
    return gaps.known & (gaps.gap_m < np.float32(section.gap_m))


def large_contacts(contact: BoolArray, gaps: Gaps, section: MembraneSection, rig: Rig) -> BoolArray:
    """Return contact without connected groups that are smaller than the preset's smallest contact."""
    camera, (top, left), depth_m = rig.proximity.intrinsics, gaps.differences.corner, gaps.differences.depth_m
    rows, columns = np.nonzero(contact)
    pixels = (rows + top) * camera.width + columns + left
    large = in_large_cluster(depth_m[rows, columns], pixels, camera, section.min_area_mm2)
    if large.all():
        return contact
    kept = np.zeros_like(contact)
    kept[rows[large], columns[large]] = True
    return kept


def surface_points(
    contact: BoolArray, gaps: Gaps, section: MembraneSection, rig: Rig, buffers: CandidateBuffers
) -> Candidates:
    """Return contact pixels that have a depth, with smoothed points weighted from both cameras' depths."""
    differences = gaps.differences
    means = LocalMean(contact & differences.usable, section.smooth_px)
    depth = means.of(differences.depth_m - np.float32(section.tactile_weight) * differences.difference_m)
    count = kernels.collect_points(
        contact, depth, means.share, _MIN_SHARE_OF_POINT,
        kernels.RayWindow(ray_table(rig.proximity.intrinsics), *differences.corner), buffers.pixels, buffers.points,
    )  # fmt: skip
    return buffers.collect({0: count})


def window_reach(sigma_px: float) -> int:
    """Return the radius of a window in pixels."""
    return int(np.ceil(2 * sigma_px))


def print_bias_m(difference_m: Float32Array) -> float:
    """Return the bias between both cameras, measured where both see the membrane itself; 0 with too few pixels.

    Parameters
    ----------
    difference_m : float32, shape (N,)
        Proximity less tactile depth where opaque prints reflect infrared.
    """
    return float(np.median(difference_m)) if len(difference_m) >= _MIN_BIAS_PIXELS else 0.0


def contact_bias_m(gap_m: Float32Array, known: BoolArray, limit_m: float) -> float:
    """Return the most frequent gap: in contact all gaps are equal, where the membrane leaves they are spread.

    Parameters
    ----------
    gap_m : float32, shape (H, W)
        Local means, corrected for the bias measured on prints.
    known : bool, shape (H, W)
        Where there is a gap.
    limit_m : float
        Upper limit of the bias.
    """
    import cv2

    edges = np.arange(-limit_m, limit_m + _BIN_M / 2, _BIN_M)
    if len(edges) < 2:
        return 0.0
    counts = np.zeros(len(edges) - 1, np.int64)
    if kernels.count_gaps(gap_m, known, np.float32(limit_m), edges, counts) < _MIN_BIAS_PIXELS:
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
    """Convert gaps along the optical axis to gaps along the surface normal, in place; steep slopes are limited.

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
    kernels.turn_to_normal(gap_m, depth_m, along_x, along_y, kernels.RayWindow(rays, *corner), _MIN_FACING)


def erode_rim(
    near: BoolArray,
    wide: BoolArray,
    far: float,
    share: float,
    core_share: float,
    max_erosion_px: float,
) -> BoolArray:
    """Erode the rim where a membrane that leaves tangentially is near the object without touching it.

    There the gap grows with the square of the distance s from the edge of contact, so its root grows with s. Between
    the isolines g and ``far`` g lies a distance w, so the edge is s = w / (sqrt(far) - 1) inside the first. Where the
    object ends both isolines coincide, and nothing is eroded.

    Parameters
    ----------
    near, wide : bool, shape (H, W)
        Gap below the limit, and below ``far`` times the limit.
    far : float
        Above 1.
    share : float
        The share of s that is eroded.
    core_share : float
        Pixels stay if their distance to the border is at least this share of the largest such distance within
        0.65 ``max_erosion_px``, because noise bends the isolines around narrow contacts.
    max_erosion_px : float
        Upper limit of s.
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
    deepest = cv2.dilate(inside, np.ones((window, window), np.uint8))
    deep = (inside > np.float32(share) * taken) | (inside > np.float32(core_share) * deepest)
    return np.asarray(near & _unpadded(deep))


def surroundings(marked: BoolArray, margin_px: int, vectors: int = 1) -> tuple[slice, slice] | None:
    """Return the bounding box of the marked pixels, padded by ``margin_px``; None without any.

    The first column is a multiple of ``vectors``, and the box is extended by as many columns at the end: OpenCV rounds
    an image's last columns differently from those that it processes as vectors, and marked pixels must get the same
    bits as in the whole image.
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
