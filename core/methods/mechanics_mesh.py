"""A triangle mesh over the untouched membrane, made from what the tactile camera sees of it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial import Delaunay

from ..errors import TactuneError
from ..model.arrays import BoolArray, Float32Array, Float64Array, IndexArray, Uint16Array
from ..model.clouds import valid_depth
from ..model.intrinsics import Intrinsics

_FEWEST_NODES = 20
#: Depth that differs so much from its surroundings' mean is a false match, metres.
_FALSE_MATCH_M = 0.015
#: Nicks in the region's outline up to this width are closed.
_NICK_PX = 15


@dataclass(frozen=True, eq=False)
class MembraneMesh:
    """Nodes and triangles, counter-clockwise as seen from outside.

    Attributes
    ----------
    pixels : float64, shape (N, 2)
        ``(u, v)`` of the nodes in the tactile image.
    positions, normals : float64, shape (N, 3)
        Metres in the tactile frame; the unit normals point outward, away from the camera.
    triangles : int, shape (T, 3)
    rim : bool, shape (N,)
        Nodes on the outline.
    region : bool, shape (Ht, Wt)
        Tactile pixels that the mesh covers.
    spacing_px : float
        Distance of neighbouring nodes in the image.
    """

    pixels: Float64Array
    positions: Float64Array
    normals: Float64Array
    triangles: IndexArray
    rim: BoolArray
    region: BoolArray
    spacing_px: float

    @property
    def rays(self) -> Float64Array:
        """Unit vectors from the camera to the nodes, shape (N, 3)."""
        return np.asarray(self.positions / np.linalg.norm(self.positions, axis=1, keepdims=True))

    @property
    def facing(self) -> Float64Array:
        """Cosines between rays and normals, shape (N,)."""
        return np.asarray(np.einsum("ij,ij->i", self.rays, self.normals))


class DepthSampler:
    """Reads the depth round given pixels as the mean of the pixels in a square, false matches left out.

    Parameters
    ----------
    pixels : array_like, shape (N, 2)
        ``(u, v)``.
    width_px : int
        Side of the square, odd.
    spread_counts : float
        Pixels that differ so much from the mean of a square thrice as wide are false matches.
    """

    def __init__(self, pixels: Float64Array, width_px: int, spread_counts: float) -> None:
        self._u, self._v = (np.ascontiguousarray(pixels[:, i : i + 1], np.float32) for i in range(2))
        self._width_px, self._spread_counts = width_px, spread_counts

    def sample(self, counts: Uint16Array) -> Float64Array:
        """Return the mean counts at each pixel, shape (N,); nan where under half of the square has depth."""
        depth, valid = counts.astype(np.float32), valid_depth(counts)
        near = _box_mean(depth, valid, 3 * self._width_px, 0.0)
        with np.errstate(invalid="ignore"):
            valid &= np.abs(depth - near) < self._spread_counts
        mean = _box_mean(depth, valid, self._width_px, 0.5)
        looked_up = cv2.remap(
            mean, self._u, self._v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=np.nan
        )
        return np.asarray(looked_up[:, 0], np.float64)


def build_mesh(
    untouched: Uint16Array, camera: Intrinsics, factor_m: float, offset_m: float, nodes: int, crop_px: int
) -> MembraneMesh:
    """Cover the region where the untouched frame has depth with triangles of about equal size in the image.

    Parameters
    ----------
    untouched : uint16, shape (Ht, Wt)
        Tactile depth of the untouched membrane, raw counts.
    camera : Intrinsics
        The tactile camera's.
    factor_m, offset_m : float
        Metres are ``counts * factor_m + offset_m``.
    nodes : int
        About how many.
    crop_px : int
        Width of the rim that is left out.

    Raises
    ------
    TactuneError
        The untouched frame shows too little of a membrane.
    """
    whole = _membrane_region(untouched)
    spacing = np.sqrt(np.count_nonzero(whole) / (0.866 * nodes))
    for _ in range(6):
        region = _eroded(whole, crop_px + round(spacing / 4))
        if np.count_nonzero(region) < _FEWEST_NODES:
            raise TactuneError(
                f"the untouched frame shows the membrane in {np.count_nonzero(whole)} tactile pixels, too small "
                f"for a mesh with a rim of {crop_px} pixels left out; take a new untouched frame or leave out less"
            )
        outline, inner = _place_nodes(region, spacing)
        found = len(outline) + len(inner)
        if abs(found - nodes) <= 0.02 * nodes:
            break
        spacing *= np.sqrt(found / nodes)
    pixels = np.concatenate([outline, inner])
    depth = make_sampler(pixels, spacing, factor_m).sample(untouched) * factor_m + offset_m
    kept, rim = np.isfinite(depth), np.arange(len(pixels)) < len(outline)
    if np.count_nonzero(kept & ~rim) < _FEWEST_NODES:
        raise TactuneError(
            f"the untouched frame has depth at {np.count_nonzero(kept & ~rim)} nodes in the membrane's outline only, "
            f"but the mechanics needs {_FEWEST_NODES}; take a new untouched frame or ask for more nodes"
        )
    pixels, depth, rim = pixels[kept], depth[kept], rim[kept]
    positions = np.concatenate([camera.normalise(pixels), np.ones((len(pixels), 1))], axis=1) * depth[:, None]
    triangles = _triangulate(pixels, region)
    used = np.unique(triangles)
    renumbered = np.full(len(pixels), -1)
    renumbered[used] = np.arange(len(used))
    triangles = renumbered[triangles]
    return MembraneMesh(
        pixels[used], positions[used], _normals(positions[used], triangles), triangles, rim[used], region, spacing
    )


def make_sampler(pixels: Float64Array, spacing_px: float, factor_m: float) -> DepthSampler:
    """Return what reads the depth at nodes: squares of half their spacing."""
    return DepthSampler(pixels, 2 * max(1, round(spacing_px / 4)) + 1, _FALSE_MATCH_M / factor_m)


def interpolation(mesh: MembraneMesh) -> tuple[IndexArray, IndexArray, Float32Array]:
    """Return how node values are interpolated to pixels.

    Returns
    -------
    pixels : int, shape (M,)
        Flat numbers of the tactile pixels that the mesh covers.
    nodes : int, shape (M, 3)
        The corners of the triangle that each lies in.
    weights : float32, shape (M, 3)
        Their shares, which sum to 1.
    """
    owner = np.full(mesh.region.shape, -1, np.int32)
    corners = np.rint(mesh.pixels[mesh.triangles] * 16).astype(np.int32)
    for number, triangle in enumerate(corners):
        cv2.fillConvexPoly(owner, triangle, number, lineType=cv2.LINE_8, shift=4)
    pixels = np.flatnonzero(owner >= 0)
    nodes = mesh.triangles[owner.reshape(-1)[pixels]]
    a, b, c = np.moveaxis(mesh.pixels[nodes], 1, 0)
    v, u = np.divmod(pixels, mesh.region.shape[1])
    p = np.stack([u, v], axis=1)
    whole = _cross(b - a, c - a)
    second, third = _cross(p - a, c - a) / whole, _cross(b - a, p - a) / whole
    weights = np.clip(np.stack([1.0 - second - third, second, third], axis=1), 0.0, 1.0)
    weights /= weights.sum(axis=1, keepdims=True)
    return pixels, nodes, weights.astype(np.float32)


def _membrane_region(untouched: Uint16Array) -> BoolArray:
    """Return the largest part of the image with depth, its holes filled and its outline's nicks closed."""
    padded = cv2.copyMakeBorder(valid_depth(untouched).astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    valid = cv2.morphologyEx(padded, cv2.MORPH_CLOSE, np.ones((_NICK_PX, _NICK_PX), np.uint8))
    outlines, _ = cv2.findContours(valid, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    region = np.zeros_like(valid)
    if outlines:
        cv2.drawContours(region, [max(outlines, key=cv2.contourArea)], -1, 1, cv2.FILLED)
    return np.asarray(region[1:-1, 1:-1].astype(bool))


def _eroded(region: BoolArray, by_px: int) -> BoolArray:
    inside = cv2.copyMakeBorder(region.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    return np.asarray(cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1] > by_px)


def _place_nodes(region: BoolArray, spacing: float) -> tuple[Float64Array, Float64Array]:
    """Return nodes along a region's outline, and a hexagonal grid within it; ``(u, v)`` each."""
    outlines, _ = cv2.findContours(region.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    line = np.asarray(max(outlines, key=cv2.contourArea)[:, 0], np.float64)
    closed = np.concatenate([line, line[:1]])
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    stops = np.linspace(0.0, way[-1], max(3, round(way[-1] / spacing)), endpoint=False)
    rim = np.stack([np.interp(stops, way, closed[:, i]) for i in range(2)], axis=1)

    height, width = region.shape
    rows, columns = np.arange(0.0, height, spacing * np.sqrt(3) / 2), np.arange(0.0, width, spacing)
    u, v = np.meshgrid(columns, rows)
    u[1::2] += spacing / 2
    inner = np.stack([u.ravel(), v.ravel()], axis=1)
    far = _eroded(region, round(0.6 * spacing))
    column, row = np.minimum(np.rint(inner).astype(np.intp), (width - 1, height - 1)).T
    return rim, inner[far[row, column]]


def _triangulate(pixels: Float64Array, region: BoolArray) -> IndexArray:
    """Return the Delaunay triangles within a region, turned so that their normals point away from the camera."""
    triangles = Delaunay(pixels).simplices.astype(np.intp)
    a, b, c = np.moveaxis(pixels[triangles], 1, 0)
    column, row = np.rint((a + b + c) / 3).astype(np.intp).T
    area = _cross(b - a, c - a) / 2
    triangles[area < 0] = triangles[area < 0][:, ::-1]
    return np.asarray(triangles[region[row, column] & (np.abs(area) > 0.5)])


def _normals(positions: Float64Array, triangles: IndexArray) -> Float64Array:
    a, b, c = np.moveaxis(positions[triangles], 1, 0)
    sums = np.zeros_like(positions)
    np.add.at(sums, triangles.reshape(-1), np.repeat(np.cross(b - a, c - a), 3, axis=0))
    return np.asarray(sums / np.linalg.norm(sums, axis=1, keepdims=True))


def _cross(a: Float64Array, b: Float64Array) -> Float64Array:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _box_mean(depth: Float32Array, valid: BoolArray, width_px: int, least: float) -> Float32Array:
    """Return the mean of the valid pixels in squares; nan where their share is not above ``least``."""
    size = (width_px, width_px)
    share = cv2.boxFilter(valid.astype(np.float32), -1, size, borderType=cv2.BORDER_CONSTANT)
    total = cv2.boxFilter(np.where(valid, depth, np.float32(0)), -1, size, borderType=cv2.BORDER_CONSTANT)
    with np.errstate(all="ignore"):
        return np.where(share > least, total / share, np.float32(np.nan)).astype(np.float32)
