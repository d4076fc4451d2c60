"""Depths of dots with what the proximity camera adds, on a surface that is known and whose noise is drawn."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tactune.core.model.frames import DepthCamera, Rig, SensorFrame
from tactune.core.model.intrinsics import Intrinsics
from tactune.core.strain.dot_proximity import TouchedPlaces

TACTILE = Intrinsics(width=320, height=240, fx=193.0, fy=194.0, cx=159.5, cy=119.5)
PROXIMITY = Intrinsics(width=320, height=240, fx=230.0, fy=231.0, cx=162.0, cy=118.0)
POSE = np.eye(4)
POSE[:3, :3] = Rotation.from_euler("xyz", (0.5, -1.3, 0.4), degrees=True).as_matrix()
POSE[:3, 3] = 0.0400, 0.0006, -0.0012
RIG = Rig(
    proximity=DepthCamera(intrinsics=PROXIMITY, depth_unit_m=1e-5),
    tactile=DepthCamera(intrinsics=TACTILE, depth_unit_m=1e-5),
    T_proximity_tactile=POSE,
)
#: Of one over the tactile depth in blocks of 8 x 8 pixels, 1/m; of the proximity depth and of dots, metres.
TACTILE_NOISE, PROXIMITY_NOISE_M, DOT_NOISE_M = 0.006, 0.0004, 0.0006
_BLOCK_PX = 8


def surface(x, y):
    """Return the depth of a bulge with waves on it, in the tactile camera."""
    return 0.30 - x**2 - y**2 + 0.004 * np.sin(x / 0.015) * np.cos(y / 0.02)


def plane(x, y):
    return 0.30 + 0.3 * x - 0.2 * y


def met(shape, directions, origin=(0.0, 0.0, 0.0)):
    """Return how far along directions, (N, 3), in the tactile camera the surface is."""
    reach = np.full(len(directions), 0.3)
    for _ in range(60):
        x, y, z = (origin + reach[:, None] * directions).T
        reach += 0.8 * (shape(x, y) - z) / directions[:, 2]
    x, y, z = (origin + reach[:, None] * directions).T
    assert np.abs(shape(x, y) - z).max() < 1e-7
    return reach


def rays(lens, pixels):
    return np.column_stack([lens.normalise(pixels), np.ones(len(pixels))])


def depth_image(shape, lens, tactile_from_camera):
    v, u = np.indices(lens.shape)
    directions = rays(lens, np.column_stack([u.ravel(), v.ravel()])) @ tactile_from_camera[:3, :3].T
    return met(shape, directions, tactile_from_camera[:3, 3]).reshape(lens.shape)


@pytest.fixture(scope="module")
def clean():
    """Return both cameras' depths of both shapes."""
    return {
        shape: (depth_image(shape, TACTILE, np.eye(4)), depth_image(shape, PROXIMITY, np.linalg.inv(POSE)))
        for shape in (surface, plane)
    }


class Dots:
    """Dots on a shape with noise of their own, and the images of both cameras."""

    def __init__(self, clean, seed=0, shape=surface, tactile_noise=TACTILE_NOISE, change=None):
        rng = np.random.default_rng(seed)
        tactile, proximity = clean[shape]
        blocks = rng.normal(size=[size // _BLOCK_PX for size in tactile.shape])
        noisy = 1.0 / (1.0 / tactile + tactile_noise * np.kron(blocks, np.ones((_BLOCK_PX, _BLOCK_PX))))
        seen = proximity + rng.normal(0.0, PROXIMITY_NOISE_M, proximity.shape)
        if change is not None:
            seen = change(seen, rng)
        counts = [np.rint(depth / 1e-5).astype(np.uint16) for depth in (seen, noisy)]
        self.frame = SensorFrame(0, *counts, np.zeros((*proximity.shape, 3), np.uint8))
        self.depth_m, self.tactile_noise = counts[1] * 1e-5, tactile_noise
        self.pixels = np.mgrid[60:260:14, 40:200:14].reshape(2, -1).T + rng.uniform(-0.5, 0.5, (180, 2))
        directions = rays(TACTILE, self.pixels)
        self.true = directions * met(shape, directions)[:, None]
        self.points = self.true + directions * rng.normal(0.0, DOT_NOISE_M, len(directions))[:, None]
        self.sigma = np.full(len(directions), DOT_NOISE_M)

    def places(self, rig=RIG):
        return TouchedPlaces.of(self.frame, rig, self.depth_m, self.tactile_noise)

    def sharpened(self, rig=RIG):
        """Return errors of the depth after, and the standard deviations told."""
        points, sigma = self.places(rig).sharpen(self.pixels, self.points, self.sigma, TACTILE)
        assert np.abs(TACTILE.project(points) - self.pixels).max() < 1e-9  # on the rays of their pixels
        return points[:, 2] - self.true[:, 2], sigma


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize("shape", [surface, plane])
@pytest.mark.parametrize("tactile_noise", [0.002, TACTILE_NOISE])
def test_depths_are_sharper_and_it_is_told_how_much(shape, tactile_noise, clean):
    runs = [Dots(clean, seed, shape, tactile_noise) for seed in range(2)]
    error, sigma = (np.concatenate(each) for each in zip(*(dots.sharpened() for dots in runs), strict=True))
    before = np.concatenate([(dots.points - dots.true)[:, 2] for dots in runs])
    assert rms(before) == pytest.approx(DOT_NOISE_M, rel=0.1)
    assert rms(error) < 0.4 * rms(before)
    assert 0.5 < rms(error / sigma) < 2.0
    assert (sigma <= DOT_NOISE_M).all() and np.mean(sigma < DOT_NOISE_M) > 0.95


@pytest.mark.parametrize("offset_m", [0.0005, -0.0005])
def test_a_proximity_camera_that_is_off_by_a_constant_pulls_nothing(offset_m, clean):
    error, sigma = Dots(clean, change=lambda depth, _: depth + offset_m).sharpened()
    assert abs(error.mean()) < 0.1 * abs(offset_m)
    assert rms(error) < 0.4 * DOT_NOISE_M
    assert 0.5 < rms(error / sigma) < 2.0


def test_a_pose_that_is_slightly_off_pulls_little(clean):
    dots, pose = Dots(clean, shape=plane), POSE.copy()
    pose[:3, :3] = pose[:3, :3] @ Rotation.from_euler("xyz", (0.1, 0.2, 0.1), degrees=True).as_matrix()
    error, _ = dots.sharpened(RIG.model_copy(update={"T_proximity_tactile": pose}))
    assert rms(error) < 0.5 * DOT_NOISE_M


def test_the_weights_are_those_of_the_noise(clean):
    """A dot that is known well stays, one that is not known goes where the proximity camera says."""
    dots = Dots(clean)
    dots.sigma[::3], dots.sigma[1::3] = 1e-6, 0.1
    error, sigma = dots.sharpened()
    before = (dots.points - dots.true)[:, 2]
    assert np.abs((error - before)[::3]).max() < 1e-6
    assert (sigma[::3] < 1e-6 + 1e-9).all()
    assert rms(error[1::3]) < 0.4 * DOT_NOISE_M
    assert np.abs(np.corrcoef(error[1::3], before[1::3])[0, 1]) < 0.35
    assert 0.5 < rms(error[1::3] / sigma[1::3]) < 2.0


def test_nothing_is_said_without_a_pose_or_where_hardly_a_place_is_common(clean):
    dots = Dots(clean)
    assert dots.places(RIG.model_copy(update={"T_proximity_tactile": None})) is None
    for change in (
        lambda depth, _: depth + 0.020,  # an object behind, everywhere
        lambda depth, _: np.where(np.arange(depth.size).reshape(depth.shape) % 1000 == 0, depth, 0.0),
        lambda depth, _: np.zeros_like(depth),
    ):
        assert Dots(clean, change=change).places() is None


def test_dots_where_the_proximity_camera_sees_something_else_stay_as_they_are(clean):
    """An object 20 mm behind on the right half of its image, and nothing in a corner."""

    def change(depth, _):
        seen = depth.copy()
        seen[:, 170:] += 0.020
        seen[:80, :170] = 0.0
        return seen

    dots = Dots(clean, change=change)
    points, sigma = dots.places().sharpen(dots.pixels, dots.points, dots.sigma, TACTILE)
    there = PROXIMITY.project(dots.true @ POSE[:3, :3].T + POSE[:3, 3])
    away = np.maximum(there[:, 0] - 170, np.minimum(80 - there[:, 1], 170 - there[:, 0]))
    other, same = away > 6, away < -6
    assert other.sum() > 40 and same.sum() > 40
    assert (points[other] == dots.points[other]).all() and (sigma[other] == DOT_NOISE_M).all()
    assert (sigma[same] < DOT_NOISE_M).all() and rms((points - dots.true)[same, 2]) < 0.5 * DOT_NOISE_M
    # and where no dot has a place around it, all are as they were
    points, sigma = dots.places().sharpen(dots.pixels[other], dots.points[other], dots.sigma[other], TACTILE)
    assert (points == dots.points[other]).all() and (sigma == DOT_NOISE_M).all()


def stray(sides):
    """Return a change that moves a tenth of the places by 1.5 mm, which is still near enough for the same surface."""
    return lambda depth, rng: depth + 0.0015 * rng.choice(sides, depth.shape) * (rng.random(depth.shape) < 0.1)


def test_outliers_among_the_places_are_left_out(clean):
    plain, strayed = (
        np.concatenate([Dots(clean, seed, tactile_noise=0.002, change=change).sharpened()[0] for seed in range(3)])
        for change in (None, stray((-1, 1)))
    )
    assert rms(strayed) < 1.35 * rms(plain)


@pytest.mark.parametrize("side", [-1, 1])
def test_outliers_to_one_side_pull_nothing(side, clean):
    """As where an edge of the object behind smears the proximity camera's depth."""
    error, _ = Dots(clean, tactile_noise=0.002, change=stray((side,))).sharpened()
    assert abs(error.mean()) < 0.0001


def test_a_dot_without_depth_stays_without(clean):
    dots = Dots(clean)
    dots.points[[3, 50]], dots.sigma[3] = np.nan, np.nan
    given = dots.points.copy(), dots.sigma.copy()
    points, sigma = dots.places().sharpen(dots.pixels, dots.points, dots.sigma, TACTILE)
    assert np.flatnonzero(np.isnan(points).any(axis=1)).tolist() == [3, 50]
    assert np.flatnonzero(np.isnan(sigma)).tolist() == [3] and sigma[50] == DOT_NOISE_M
    assert np.array_equal(given[0], dots.points, equal_nan=True)  # what was handed in is left alone
    assert np.array_equal(given[1], dots.sigma, equal_nan=True)
