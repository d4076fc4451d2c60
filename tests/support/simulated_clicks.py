"""Clicks on a membrane of known shape with known noise, and the Cramer-Rao bound of the estimate.

The tests and ``scripts/measure_calibration.py`` compare the fits with this bound.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from tactune.core.calibration.geometry import Alignment, moved, proximity_pixels
from tactune.core.calibration.points import PointArrays
from tactune.core.model.alignment import PointPair
from tactune.core.model.arrays import BoolArray, Float64Array
from tactune.core.model.frames import Rig

#: Distances of the apex from the cameras at three inflation levels, metres.
LEVELS_M = (0.270, 0.292, 0.314)
_RIM_M = 0.254
_MIDDLE_M = (0.020, 0.0)
_HALF_SIZE_M = (0.1775, 0.1025)
#: Part of the membrane that is clicked, and over which alignment is judged.
_CLICKED_SHARE, _JUDGED_SHARE = 0.88, 0.92


@dataclass(frozen=True)
class ClickNoise:
    """Standard deviations of both clicks and of the tactile depth."""

    tactile_px: float = 0.7
    proximity_px: float = 0.7
    depth_m: float = 0.0005


@dataclass(frozen=True, eq=False)
class Clicks:
    """Noisy clicks beside the true ones."""

    noisy: PointArrays
    true: PointArrays

    def pairs(self) -> list[PointPair]:
        """Return the noisy clicks as pairs with ids from 1."""
        points = self.noisy
        return [
            PointPair(
                id=str(i + 1),
                proximity_u=float(points.proximity[i, 0]),
                proximity_v=float(points.proximity[i, 1]),
                tactile_u=float(points.tactile[i, 0]),
                tactile_v=float(points.tactile[i, 1]),
                tactile_depth_m=float(points.tactile_depth_m[i]),
                proximity_image="color" if points.in_color[i] else "depth",
            )
            for i in range(len(points.tactile))
        ]


def membrane_points(across_m: npt.ArrayLike, apex_m: npt.ArrayLike) -> Float64Array:
    """Return points (N, 3) of a cushion over a rectangle at x and y, (N, 2), metres in the proximity frame."""
    across = np.asarray(across_m, np.float64)
    x, y = ((across - _MIDDLE_M) / _HALF_SIZE_M).T
    height = np.clip(1 - x**2, 0, 1) * np.clip(1 - y**2, 0, 1)
    return np.column_stack([across, _RIM_M + (np.asarray(apex_m) - _RIM_M) * height])


def make_clicks(
    rig: Rig,
    count: int,
    seed: int,
    noise: ClickNoise | None = None,
    color_share: float = 0.0,
    wrong: float = 0.0,
) -> Clicks:
    """Click random places of the membrane at the three inflation levels in turn.

    Of the proximity clicks ``color_share`` are made in the colour image, and ``wrong`` lie anywhere.
    """
    noise = noise or ClickNoise()
    rng = np.random.default_rng(seed)
    reach = _CLICKED_SHARE * np.array(_HALF_SIZE_M)
    across = rng.uniform(-reach, reach, (count, 2))
    points = membrane_points(across + _MIDDLE_M, np.resize(LEVELS_M, count))
    in_color = rng.random(count) < color_share
    true = project_points(points, rig, in_color)
    proximity = true.proximity + noise.proximity_px * rng.standard_normal((count, 2))
    chosen = rng.choice(count, round(wrong * count), replace=False)
    height, width = rig.proximity.intrinsics.shape
    proximity[chosen] = rng.uniform((0, 0), (width - 1, height - 1), (len(chosen), 2))
    noisy = PointArrays(
        tactile=true.tactile + noise.tactile_px * rng.standard_normal((count, 2)),
        tactile_depth_m=true.tactile_depth_m + noise.depth_m * rng.standard_normal(count),
        proximity=proximity,
        in_color=in_color,
    )
    return Clicks(noisy, true)


def project_points(points_m: Float64Array, rig: Rig, in_color: BoolArray) -> PointArrays:
    """Return what both cameras see of points (N, 3) of the proximity frame."""
    of_tactile = moved(np.linalg.inv(np.asarray(rig.T_proximity_tactile)), points_m)
    return PointArrays(
        tactile=rig.tactile.intrinsics.project(of_tactile),
        tactile_depth_m=of_tactile[:, 2],
        proximity=proximity_pixels(rig, points_m, in_color),
        in_color=in_color,
    )


def judged_places(rig: Rig) -> tuple[Float64Array, Float64Array]:
    """Return places of the membrane at all levels (M, 3) and their true proximity depth pixels (M, 2)."""
    reach = _JUDGED_SHARE * np.array(_HALF_SIZE_M)
    x, y = np.meshgrid(np.linspace(-reach[0], reach[0], 13), np.linspace(-reach[1], reach[1], 9))
    across = np.stack([x.ravel(), y.ravel()], axis=1) + _MIDDLE_M
    points = np.concatenate([membrane_points(across, level) for level in LEVELS_M])
    seen = project_points(points, rig, np.zeros(len(points), bool))
    return seen.places, seen.proximity


def cramer_rao(true: PointArrays, rig: Rig, noise: ClickNoise) -> Float64Array:
    """Return the smallest covariance (6, 6) of any unbiased estimate of the pose.

    The Fisher information of the pose *and* of every point's true place, by numeric derivatives of the
    cameras themselves, is inverted as a whole; the pose's block of the inverse is the bound. Order:
    rotation vector (rad) about the proximity axes, translation (m).
    """
    count = len(true.tactile)
    start = np.concatenate([np.zeros(6), true.places.ravel()])
    steps = np.concatenate([np.full(6, 1e-6), np.tile([1e-3, 1e-3, 1e-6], count)])
    sigma = np.concatenate(
        [
            np.full(2 * count, noise.proximity_px),
            np.tile([noise.tactile_px, noise.tactile_px, noise.depth_m], count),
        ]
    )

    def measured(unknowns: Float64Array) -> Float64Array:
        places = unknowns[6:].reshape(-1, 3)
        return np.concatenate([_seen_from(unknowns[:6], places, true.in_color, rig).ravel(), unknowns[6:]])

    derivative = _numeric_derivative(measured, start, steps) / sigma[:, None]
    scale = steps / np.linalg.norm(derivative * steps, axis=0)
    scaled = derivative * scale
    covariance = np.linalg.inv(scaled.T @ scaled)[:6, :6]
    return np.asarray(covariance * scale[:6, None] * scale[:6])


def alignment_covariance(pose_covariance: Float64Array, places: Float64Array, rig: Rig) -> Float64Array:
    """Return the covariance (M, 2, 2) of predicted proximity pixels that a pose's covariance causes."""

    def predicted(pose: Float64Array) -> Float64Array:
        return _seen_from(pose, places, np.zeros(len(places), bool), rig).ravel()

    derivative = _numeric_derivative(predicted, np.zeros(6), np.full(6, 1e-6)).reshape(-1, 2, 6)
    return np.asarray(derivative @ pose_covariance @ derivative.transpose(0, 2, 1))


def expected_length(covariance: Float64Array) -> float:
    """Return the mean length of normal vectors with covariances (M, 2, 2), averaged over them."""
    values = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance), 0.0))
    angle = (np.arange(360) + 0.5) * np.pi / 360
    # E|(a x, b y)| = sqrt(pi / 2) * mean over directions of |(a cos, b sin)|, x and y standard normal
    lengths = np.hypot(values[:, :1] * np.cos(angle), values[:, 1:] * np.sin(angle))
    return float(np.sqrt(np.pi / 2) * lengths.mean())


def _seen_from(pose: Float64Array, places: Float64Array, in_color: BoolArray, rig: Rig) -> Float64Array:
    """Project tactile places by the true pose moved by a rotation vector and a translation."""
    T_p_t = np.asarray(rig.T_proximity_tactile)
    turned = Alignment(np.eye(4)).points_m(rig, places) @ T_p_t[:3, :3].T
    return proximity_pixels(rig, Rotation.from_rotvec(pose[:3]).apply(turned) + T_p_t[:3, 3] + pose[3:], in_color)


def _numeric_derivative(
    function: Callable[[Float64Array], Float64Array], at: Float64Array, steps: Float64Array
) -> Float64Array:
    columns = []
    for i, step in enumerate(steps):
        shift = np.zeros_like(at)
        shift[i] = step
        columns.append((function(at + shift) - function(at - shift)) / (2 * step))
    return np.stack(columns, axis=1)
