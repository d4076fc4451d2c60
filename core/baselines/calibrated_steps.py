"""The steps of calibrated fusion, each on plain images: local means, sensor bias, slope, edge of contact.

Images here are cut to where anything may touch; ``usable`` marks the pixels that have both depths, a
small difference between them, and no print that hides the object.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

Float32Array = npt.NDArray[np.float32]
BoolArray = npt.NDArray[np.bool_]

#: Fewer pixels tell no bias.
_FEWEST = 200
#: Bins of the histogram of differences, metres, and how far it is smoothed, bins.
_BIN_M, _SMOOTH_BINS = 1e-4, 3.0
#: The steepest slope for which the gap along the optical axis is turned into one along the normal.
_LEAST_FACING = 0.25
#: The flattest gradient of the gap, metres a pixel.
_LEAST_GRADIENT_M = 8e-5
#: How far the estimated distances to the edge are smoothed along it, sigma in pixels.
_ALONG_EDGE_PX = 2.0


def local_mean(image: Float32Array, usable: BoolArray, sigma_px: float) -> tuple[Float32Array, Float32Array]:
    """Return the mean over the usable pixels near each one, and which share of its surroundings is usable.

    Parameters
    ----------
    image : float32, shape (H, W)
        Finite everywhere.
    usable : bool, shape (H, W)
    sigma_px : float
        Of the Gaussian weights, cut off at twice that; 0 takes each pixel by itself.
    """
    weight = usable.astype(np.float32)
    if sigma_px == 0:
        return image * weight, weight
    size = (2 * int(np.ceil(2 * sigma_px)) + 1,) * 2
    share = cv2.GaussianBlur(weight, size, sigma_px)
    total = cv2.GaussianBlur(image * weight, size, sigma_px)
    return np.asarray(total / np.maximum(share, 1e-6)), np.asarray(share)


def print_bias_m(difference_m: Float32Array) -> float:
    """Return the bias between both sensors from where both see the membrane itself; 0 where too few pixels tell.

    Parameters
    ----------
    difference_m : float32, shape (N,)
        Proximity less tactile depth where opaque prints reflect infrared.
    """
    return float(np.median(difference_m)) if len(difference_m) >= _FEWEST else 0.0


def contact_bias_m(gap_m: Float32Array, limit_m: float) -> float:
    """Return the most frequent gap: an object in contact shows one, a membrane that leaves it all sizes.

    Parameters
    ----------
    gap_m : float32, shape (N,)
        Local means, after the bias that prints tell.
    limit_m : float
        The largest bias believed.
    """
    edges = np.arange(-limit_m, limit_m + _BIN_M / 2, _BIN_M)
    near = gap_m[np.abs(gap_m) < limit_m]
    if len(near) < _FEWEST or len(edges) < 2:
        return 0.0
    counts = np.histogram(near, edges)[0].astype(np.float32)
    smooth = cv2.GaussianBlur(counts[None], (0, 0), _SMOOTH_BINS)[0]
    best = int(np.argmax(smooth))
    return float(edges[best] + edges[best + 1]) / 2


def facing(depth_m: Float32Array, rays: Float32Array, focal_px: tuple[float, float]) -> Float32Array:
    """Return the cosine between the optical axis and a surface's normal, at least a quarter.

    With x = z (u - cx) / fx and y = z (v - cy) / fy the normal of z(u, v) is along
    (-fx z_u, -fy z_v, z + (u - cx) z_u + (v - cy) z_v).

    Parameters
    ----------
    depth_m : float32, shape (H, W)
        Smooth depth.
    rays : float32, shape (H, W, 2)
        ``(x / z, y / z)`` of each pixel.
    focal_px : tuple of float
        ``(fx, fy)``.
    """
    x, y = (
        cv2.Sobel(depth_m, cv2.CV_32F, *order, scale=focal / 8)
        for order, focal in zip(((1, 0), (0, 1)), focal_px, strict=True)
    )
    z = depth_m + rays[..., 0] * x + rays[..., 1] * y
    cosine = np.abs(z) / np.maximum(np.sqrt(x * x + y * y + z * z), 1e-9)
    return np.asarray(np.clip(cosine, _LEAST_FACING, 1.0), np.float32)


def retreat(
    near: BoolArray,
    known: BoolArray,
    gap_m: Float32Array,
    gap_limit_m: float,
    share: float,
    core: float,
    most_px: float,
) -> BoolArray:
    """Take away the rim where a membrane that leaves tangentially is still near the object.

    There the gap grows with the square of the way s from the edge of contact, g = k s^2 / 2, so where it is
    g with the gradient g', the edge lies s = 2 g / g' further in. That many pixels are taken away from where the
    gap reaches its limit; nothing is where the object ends or the image does.

    Parameters
    ----------
    near : bool, shape (H, W)
        Gap below the limit.
    known : bool, shape (H, W)
        Where there is a gap at all.
    gap_m : float32, shape (H, W)
        Smooth.
    gap_limit_m : float
    share : float
        Which share of s is taken.
    core : float
        Pixels that are at least this share as far from the border as the farthest one within 0.65 ``most_px``
        stay: noise makes the gap of narrow contacts look flat.
    most_px : float
        The largest s.
    """
    padded = cv2.copyMakeBorder(near.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    inside, labels = cv2.distanceTransformWithLabels(padded, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    gradient = cv2.magnitude(*(cv2.Sobel(gap_m, cv2.CV_32F, *order, scale=1 / 8) for order in ((1, 0), (0, 1))))
    way = np.minimum(2 * gap_limit_m / np.maximum(gradient, _LEAST_GRADIENT_M), most_px)
    way = cv2.copyMakeBorder(np.where(known, way, 0).astype(np.float32), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    outside = padded.reshape(-1) == 0
    of_label = np.zeros(int(labels.max()) + 1, np.float32)
    of_label[labels.reshape(-1)[outside]] = way.reshape(-1)[outside]
    taken = share * cv2.GaussianBlur(of_label[labels], (0, 0), _ALONG_EDGE_PX)
    window = 2 * int(np.ceil(0.65 * most_px)) + 1
    middle = cv2.dilate(inside, np.ones((window, window), np.uint8))
    return np.asarray((_unpadded(inside) > _unpadded(taken)) | (near & (_unpadded(inside) > core * _unpadded(middle))))


def drop_small(mask: BoolArray, depth_m: Float32Array, area_per_depth: float, least_mm2: float) -> BoolArray:
    """Return the mask without 8-connected groups of less area across the optical axis.

    Parameters
    ----------
    mask : bool, shape (H, W)
    depth_m : float32, shape (H, W)
    area_per_depth : float
        Area of a pixel at one metre, m^2.
    least_mm2 : float
    """
    count, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    area_m2 = area_per_depth * np.square(depth_m[mask], dtype=np.float64)
    area_mm2 = 1e6 * np.bincount(labels[mask], weights=area_m2, minlength=count)
    large = area_mm2 >= least_mm2
    large[0] = False
    return np.asarray(large[labels])


def _unpadded(image: npt.NDArray[Any] | cv2.typing.MatLike) -> npt.NDArray[Any]:
    return np.asarray(image[1:-1, 1:-1])
