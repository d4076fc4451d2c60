"""Clicked pixels as rays, the way the pipeline sees them, with the noise of the click."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..model.arrays import Float64Array
from ..model.frames import Rig
from ..model.intrinsics import Intrinsics

_NEWTON_STEPS = 8
_DIFFERENCE_PX = 0.5


def ray_seen(intrinsics: Intrinsics, pixels: npt.ArrayLike) -> Float64Array:
    """Return ``(x / z, y / z)`` of the rays that `Intrinsics.project` takes to these pixels.

    The pipeline *projects* into the tactile and the colour camera, so a click there is the inverse of
    that projection, also for lens models whose deprojection librealsense leaves out.

    Parameters
    ----------
    pixels : array_like, shape (N, 2)

    Returns
    -------
    float64, shape (N, 2)
    """
    pixels = np.asarray(pixels, np.float64)
    rays = intrinsics.normalise(pixels)
    if not intrinsics.has_distortion:
        return rays
    focal = np.array([intrinsics.fx, intrinsics.fy])
    for _ in range(_NEWTON_STEPS):
        rays = rays + (pixels - _project_rays(intrinsics, rays)) / focal
    return rays


def ray_covariance(intrinsics: Intrinsics, pixels: Float64Array, sigma_px: float) -> Float64Array:
    """Return the covariance (N, 2, 2) of rays whose pixels have isotropic noise."""
    columns = []
    for axis in range(2):
        step = np.zeros(2)
        step[axis] = _DIFFERENCE_PX
        difference = ray_seen(intrinsics, pixels + step) - ray_seen(intrinsics, pixels - step)
        columns.append(difference / (2 * _DIFFERENCE_PX))
    by_pixel = np.stack(columns, axis=2)
    return np.asarray(sigma_px**2 * by_pixel @ by_pixel.transpose(0, 2, 1))


def color_pose(rig: Rig) -> Float64Array:
    """Return ``T_color_depth`` of the proximity camera; the identity where colour is aligned to depth."""
    return np.eye(4) if rig.proximity_color is None else np.asarray(rig.proximity_color.T_color_depth)


def color_lens(rig: Rig) -> Intrinsics:
    """Return the lens of the proximity colour image."""
    return rig.proximity.intrinsics if rig.proximity_color is None else rig.proximity_color.intrinsics


def color_to_depth_pixels(rig: Rig, pixels: npt.ArrayLike, depth_m: npt.ArrayLike) -> Float64Array:
    """Take pixels of the proximity colour image to proximity depth pixels.

    The colour camera's ray is followed up to the given distance and chained by the factory extrinsic.
    The proximity depth image is not asked: it looks through the membrane that was clicked.

    Parameters
    ----------
    pixels : array_like, shape (N, 2)
    depth_m : array_like, shape (N,)
        Distance of the membrane from the colour camera along its z axis, metres.
    """
    rays, depth = ray_seen(color_lens(rig), pixels), np.asarray(depth_m, np.float64)[:, None]
    T_depth_color = np.linalg.inv(color_pose(rig))
    points = np.column_stack([rays * depth, depth]) @ T_depth_color[:3, :3].T + T_depth_color[:3, 3]
    return rig.proximity.intrinsics.project(points)


def _project_rays(intrinsics: Intrinsics, rays: Float64Array) -> Float64Array:
    return intrinsics.project(np.column_stack([rays, np.ones(len(rays))]))
