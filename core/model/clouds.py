"""Depth images to point clouds."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ..errors import SourceError
from .arrays import BoolArray, Float32Array, Float64Array, IndexArray, Int32Array, Uint16Array
from .frames import NO_DEPTH_COUNTS, DepthCamera, GroundTruth, Rig
from .intrinsics import Intrinsics

#: Largest share of an image's pixels that may see nothing.
_MAX_FOLDED = 0.9


@lru_cache(maxsize=8)
def ray_table(intrinsics: Intrinsics) -> Float32Array:
    """Return the rays ``(x / z, y / z)``, float32 (H, W, 2), made once; beyond the lens's fold those of its rim."""
    table = intrinsics.rays()
    folded = ~np.isfinite(table).all(axis=2)
    if folded.mean() > _MAX_FOLDED:
        raise SourceError(
            f"the lens coefficients {intrinsics.coefficients} leave {100 * folded.mean():.0f} % of the "
            f"{intrinsics.width} x {intrinsics.height} pixels without a ray; check them in the rig"
        )
    if folded.any():
        row, column = np.nonzero(folded)
        ahead = np.column_stack([(column - intrinsics.cx) / intrinsics.fx, (row - intrinsics.cy) / intrinsics.fy])
        ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
        table[folded] = ahead * np.linalg.norm(table[~folded], axis=1).max()
    table.flags.writeable = False
    return table


def valid_depth(counts: Uint16Array) -> BoolArray:
    """Return where raw counts are a depth: neither 0 nor 65535."""
    no_depth, saturated = NO_DEPTH_COUNTS
    return np.asarray((counts != no_depth) & (counts != saturated))


def deproject(counts: Uint16Array, camera: DepthCamera, pixels: IndexArray) -> Float32Array:
    """Return the points (N, 3), metres in the camera's frame, of flat pixels that have a depth."""
    depth = counts.ravel()[pixels].astype(np.float32) * np.float32(camera.depth_unit_m)
    points = np.empty((len(pixels), 3), np.float32)
    np.multiply(ray_table(camera.intrinsics).reshape(-1, 2)[pixels], depth[:, None], out=points[:, :2])
    points[:, 2] = depth
    return points


def deproject_image(counts: Uint16Array, camera: DepthCamera) -> Float32Array:
    """Return the point of every pixel (H, W, 3), with the bits of `deproject`; nan where a pixel has no depth."""
    depth = np.multiply(counts, np.float32(camera.depth_unit_m), dtype=np.float32)
    np.putmask(depth, ~valid_depth(counts), np.nan)
    points, rays = np.empty((*counts.shape, 3), np.float32), ray_table(camera.intrinsics)
    for axis in range(2):  # four times as fast as both at once
        np.multiply(rays[..., axis], depth, out=points[..., axis])
    points[..., 2] = depth
    return points


def nearest_pixels(points: Float64Array, camera: Intrinsics) -> tuple[IndexArray, IndexArray, BoolArray]:
    """Return row and column of the pixel in which a camera sees each point (N, 3), 0 if none, and whether it does."""
    with np.errstate(all="ignore"):
        uv = np.floor(camera.project(points) + 0.5)
    inside = (points[:, 2] > 0) & np.all((uv >= 0) & (uv < (camera.width, camera.height)), axis=1)
    column, row = np.where(inside[:, None], uv, 0).astype(np.intp).T
    return row, column, inside


def pixel_areas_m2(depth_m: Float32Array, intrinsics: Intrinsics) -> Float64Array:
    """Return the area that one pixel covers at each depth, projected across the optical axis, m^2."""
    return np.square(depth_m.astype(np.float64)) / (intrinsics.fx * intrinsics.fy)


def connected_groups(pixels: IndexArray, width: int) -> Int32Array:
    """Return the number of the 8-connected group of each flat pixel, from 0; the pixels ascend, and there are some."""
    import cv2  # on demand: importing the pipeline must not wait for it

    top, bottom = int(pixels[0]) // width, int(pixels[-1]) // width + 1
    image, places = np.zeros((bottom - top, width), np.uint8), pixels - top * width
    image.reshape(-1)[places] = 1
    return np.asarray(cv2.connectedComponents(image, connectivity=8)[1].reshape(-1)[places] - 1, np.int32)


def truth_points(truth: GroundTruth, rig: Rig) -> Float32Array:
    """Return the points (N, 3), metres, of the true depth at every contact pixel that has one."""
    if truth.depth_m is None:
        return np.empty((0, 3), np.float32)
    pixels = truth.contact & np.isfinite(truth.depth_m)
    depth = truth.depth_m[pixels][:, None]
    rays = ray_table(rig.proximity.intrinsics)[pixels]
    return np.concatenate([rays * depth, depth], axis=1).astype(np.float32)
