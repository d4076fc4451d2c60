"""Dots seen by two cameras, against OpenCV and against the simulator without noise."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tactune.core.model.frames import ColorCamera, DepthCamera, Rig, SensorFrame
from tactune.core.model.intrinsics import Distortion, Intrinsics
from tactune.core.sources.registry import open_source
from tactune.core.strain import dot_triangulation
from tactune.core.strain.dot_edges import SeenSurface
from tactune.core.strain.dot_surface import dot_points
from tactune.core.strain.dot_triangulation import EDGE_SIGMA_PX, MIDDLE_SIGMA_PX, PlacedDots, SecondCamera, SecondView
from tactune.core.strain.dots import Spots, find_dots
from tactune.core.strain.strain import measure_strain

SCENE = "sim:cup?press=medium&grid=dots&seed=0"
DEPTH_NOISE_M = 0.0005


def triangulate(dots, frame, rig, surface, find):
    view = SecondView.of(dots, frame, rig, surface, find)
    return dots if view is None else view.sharpen(dots)


def triangulate_few(*words):
    """The same by the pose as it is, which few dots do not tell."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(dot_triangulation, "_FEWEST_FOR_POSE", 0)
        patched.setattr(dot_triangulation, "_adjusted", lambda camera, *_: camera)
        return triangulate(*words)


def pose(degrees, translation_m):
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("xyz", degrees, degrees=True).as_matrix()
    matrix[:3, 3] = translation_m
    return matrix


TACTILE = Intrinsics(width=320, height=240, fx=193.0, fy=194.0, cx=158.5, cy=121.5)
PROXIMITY = Intrinsics(width=320, height=240, fx=230.0, fy=231.0, cx=162.0, cy=118.0)
COLOUR = Intrinsics(width=400, height=300, fx=282.0, fy=283.0, cx=202.0, cy=148.0)
BENT = {"distortion": Distortion.BROWN_CONRADY, "coefficients": (0.08, -0.05, 0.002, -0.003, 0.01)}
PROXIMITY_TACTILE = pose((0.5, -1.3, 0.4), (0.0400, 0.0006, -0.0012))
COLOUR_DEPTH = pose((0.35, -0.28, 0.12), (0.0004, 0.0139, -0.0017))
ALIGNED = Rig(
    proximity=DepthCamera(intrinsics=PROXIMITY, depth_unit_m=1e-4),
    tactile=DepthCamera(intrinsics=TACTILE, depth_unit_m=1e-4),
    T_proximity_tactile=PROXIMITY_TACTILE,
)
RIG = ALIGNED.model_copy(update={"proximity_color": ColorCamera(intrinsics=COLOUR, T_color_depth=COLOUR_DEPTH)})


def bent(rig):
    """Return a rig whose second camera has lens distortion."""
    if rig.proximity_color is None:
        camera = rig.proximity.model_copy(update={"intrinsics": PROXIMITY.model_copy(update=BENT)})
        return rig.model_copy(update={"proximity": camera})
    camera = rig.proximity_color.model_copy(update={"intrinsics": COLOUR.model_copy(update=BENT)})
    return rig.model_copy(update={"proximity_color": camera})


RIGS = pytest.mark.parametrize(
    "rig", [RIG, ALIGNED, bent(RIG), bent(ALIGNED)], ids=["two", "one", "two-bent", "one-bent"]
)


def opencv_camera(rig):
    """Return what OpenCV needs of the second camera: pose, K and coefficients."""
    second = rig.proximity_color
    lens = rig.proximity.intrinsics if second is None else second.intrinsics
    moved = np.asarray(rig.T_proximity_tactile)
    if second is not None:
        moved = np.asarray(second.T_color_depth) @ moved
    return moved, lens.camera_matrix(), np.array(lens.coefficients)


def opencv_sees(rig, points):
    moved, matrix, coefficients = opencv_camera(rig)
    return cv2.projectPoints(points, cv2.Rodrigues(moved[:3, :3])[0], moved[:3, 3], matrix, coefficients)[0][:, 0]


def some_points(count, seed=0):
    return np.random.default_rng(seed).uniform((-0.1, -0.07, 0.2), (0.1, 0.07, 0.4), (count, 3))


@RIGS
def test_the_second_camera_sees_points_where_opencv_does(rig):
    points = some_points(50)
    assert np.abs(SecondCamera.of(rig).sees(points) - opencv_sees(rig, points)).max() < 1e-8


def test_there_is_no_second_camera_without_a_pose():
    assert SecondCamera.of(RIG.model_copy(update={"T_proximity_tactile": None})) is None


@pytest.mark.parametrize("rig", [RIG, ALIGNED])
def test_pixels_move_with_points_as_the_slopes_say(rig):
    camera, points, step = SecondCamera.of(rig), some_points(20), 1e-6
    steps = [(camera.sees(points + step * axis) - camera.sees(points - step * axis)) / (2 * step) for axis in np.eye(3)]
    assert np.allclose(camera.slopes(points), np.stack(steps, axis=2), rtol=1e-6, atol=1e-4)


def test_a_turn_and_a_movement_are_made_after_the_pose():
    change = np.array([0.01, -0.02, 0.015, 0.001, -0.002, 0.003])
    points, camera = some_points(20), SecondCamera.of(ALIGNED)
    both = np.asarray(PROXIMITY_TACTILE).copy()
    both[:3, :3] = cv2.Rodrigues(change[:3])[0] @ both[:3, :3]
    both[:3, 3] += change[3:]
    rig = ALIGNED.model_copy(update={"T_proximity_tactile": both})
    assert np.abs(camera.turned(change).sees(points) - opencv_sees(rig, points)).max() < 1e-8


# A sheet that is known, and spots in the second image that are where they are told to be.

SHEET_M = 0.30


def flat(depth_m=SHEET_M):
    return np.full(TACTILE.shape, depth_m)


def frame_of(rig, colour=120):
    shape = (*rig.proximity_color_shape, 3)
    counts = np.full(rig.proximity.intrinsics.shape, 3000, np.uint16)
    return SensorFrame(0, counts, np.full(TACTILE.shape, 3000, np.uint16), np.full(shape, colour, np.uint8))


def spots_at(pixels):
    return Spots(pixels, np.full(len(pixels), 1e-6), np.zeros(len(pixels), bool))


def on_sheet(rig, seen):
    """Return the tactile pixels of the flat sheet that the second camera sees at ``seen``, by OpenCV."""
    moved, matrix, coefficients = opencv_camera(rig)
    rays = cv2.undistortPoints(seen[:, None], matrix, coefficients, criteria=(3, 200, 1e-13))[:, 0]
    inverse = np.linalg.inv(moved)
    directions = np.column_stack([rays, np.ones(len(rays))]) @ inverse[:3, :3].T
    points = inverse[:3, 3] + directions * ((SHEET_M - inverse[2, 3]) / directions[:, 2])[:, None]
    return TACTILE.project(points)


def at_depth(pixels, depth_m):
    return np.column_stack([TACTILE.normalise(pixels), np.ones(len(pixels))]) * np.reshape(depth_m, (-1, 1))


def grid(columns, rows, step=14.0, at=(70.0, 50.0)):
    row, column = np.mgrid[:rows, :columns]
    return np.column_stack([column.ravel(), row.ravel()]) * step + at


def placed(pixels, points, sigma_m, surface=None):
    return PlacedDots.of(surface or SeenSurface.of(flat(), TACTILE), pixels, points, np.full(len(pixels), sigma_m))


@RIGS
def test_without_known_depth_dots_are_where_opencv_triangulates_them(rig):
    """Of few dots, so that the pose is not adjusted."""
    rng = np.random.default_rng(1)
    points = at_depth(grid(6, 4, 30.0), SHEET_M + rng.uniform(-0.0015, 0.0015, 24))
    pixels = TACTILE.project(points) + rng.normal(0.0, 0.05, (24, 2))
    seen = opencv_sees(rig, points) + rng.normal(0.0, 0.05, (24, 2))
    guess = at_depth(pixels, points[:, 2] + rng.choice([-0.001, 0.001], 24))
    dots = placed(pixels, guess, 0.05)
    surface = SeenSurface.of(flat(), TACTILE)
    after = triangulate_few(dots, frame_of(rig), rig, surface, lambda _: spots_at(on_sheet(rig, seen)))

    moved, matrix, coefficients = opencv_camera(rig)
    rays = cv2.undistortPoints(seen[:, None], matrix, coefficients, criteria=(3, 200, 1e-13))[:, 0]
    same = cv2.triangulatePoints(np.eye(3, 4), moved[:3], TACTILE.normalise(pixels).T, rays.T)
    opencv = (same[:3] / same[3]).T
    assert np.sqrt(np.mean((guess - opencv)[:, 2] ** 2)) > 0.0009
    assert np.sqrt(np.mean((after.points_m - opencv)[:, 2] ** 2)) < 0.0002
    assert np.abs(after.points_m - opencv)[:, :2].max() < 0.0002
    assert (after.pixels == pixels).all()


def test_depth_that_is_known_well_stays():
    pixels = grid(6, 4, 30.0)
    seen = opencv_sees(RIG, at_depth(pixels, SHEET_M + 0.0004))
    dots = placed(pixels, at_depth(pixels, SHEET_M), 1e-6)
    surface = SeenSurface.of(flat(), TACTILE)
    after = triangulate_few(dots, frame_of(RIG), RIG, surface, lambda _: spots_at(on_sheet(RIG, seen)))
    assert (after.points_m != dots.points_m).any(axis=1).all()
    assert np.abs(after.points_m - dots.points_m)[:, 2].max() < 1e-6


def test_how_well_dots_are_known_is_what_errors_of_middle_and_depth_make(clean_plane):
    """Against drawn errors, on a plane seen at a low angle."""
    surface, depth_at = clean_plane
    pixels = np.array([(100.0, 80.0), (220.0, 180.0), (160.0, 120.0)])
    points = at_depth(pixels, depth_at(pixels))
    told = PlacedDots.of(surface, pixels, points, np.array([0.0005, 0.0, 0.0002]))
    rng = np.random.default_rng(2)
    for number, sigma_m in enumerate((0.0005, 0.0, 0.0002)):
        drawn = pixels[number] + rng.normal(0.0, MIDDLE_SIGMA_PX, (20000, 2))
        places = (
            at_depth(drawn, depth_at(drawn)) + rng.normal(0.0, sigma_m, (20000, 1)) * points[number] / points[number, 2]
        )
        known = np.cov(places.T)
        assert np.abs(told.covariance_m2[number] - known).max() < 0.05 * known.max()


@pytest.fixture
def clean_plane():
    """Return a plane and its depth at pixels, z = 0.3 + 1.2 x - 0.5 y."""

    def depth_at(pixels):
        return 0.3 / (1.0 - TACTILE.normalise(pixels) @ (1.2, -0.5))

    v, u = np.indices(TACTILE.shape)
    depth = depth_at(np.column_stack([u.ravel(), v.ravel()])).reshape(u.shape)
    return SeenSurface.of(depth, TACTILE), depth_at


def cliff(right):
    """Return a sheet of which the right part, from column 160 on, lies so far behind, metres, or before."""
    return np.where(np.arange(TACTILE.width) < 160, SHEET_M, SHEET_M + right) * np.ones(TACTILE.shape)


def deviations(dots):
    return np.sqrt(np.trace(dots.covariance_m2, axis1=1, axis2=2))


def told_by_second_camera(surface, pixels, depth_m):
    """Return how much better dots with little known of their depth are known after it has seen them on a surface."""
    even = SeenSurface.of(flat(depth_m), TACTILE)
    dots = placed(pixels, at_depth(pixels, depth_m), 0.003, even)
    after = triangulate_few(dots, frame_of(RIG), RIG, surface, lambda _: spots_at(pixels))
    return deviations(dots) / deviations(after)


@pytest.mark.parametrize("right", [0.03, -0.03])
def test_at_a_step_middles_are_known_less_well_in_both_images(right):
    surface, pixels = SeenSurface.of(cliff(right), TACTILE), np.array([(157.0, 121.5), (120.0, 121.5)])
    dots = placed(pixels, at_depth(pixels, SHEET_M), 0.0005, surface)
    across = np.sqrt(dots.covariance_m2[:, 1, 1])
    assert across[0] / across[1] == pytest.approx(EDGE_SIGMA_PX / MIDDLE_SIGMA_PX, rel=0.1)
    near, far = told_by_second_camera(surface, pixels, SHEET_M)
    assert 1.0 < near < 0.7 * far


def test_where_the_second_camera_sees_the_surface_edge_on_it_says_less():
    """It looks from the left at what falls away to the right, where the tactile camera still sees the surface."""
    columns = np.arange(TACTILE.width)
    profile = 0.2 * np.exp(5.8 * (columns.clip(200, 212) - 200) / TACTILE.fx)
    surface = SeenSurface.of(profile * np.ones(TACTILE.shape), TACTILE)
    assert not surface.near_step(0).any()
    near, far = told_by_second_camera(surface, np.array([(198.0, 121.5), (100.0, 121.5)]), 0.2)
    assert 1.0 < near < 0.7 * far


def test_other_spots_in_the_second_image_move_nothing():
    """One too far from where it must be, none at all, one of no dot, and one of a dot without depth."""
    rng, pixels, noise_m = np.random.default_rng(4), grid(14, 10), 0.0015
    points = at_depth(pixels, SHEET_M + rng.normal(0.0, noise_m, len(pixels)))
    points[7] = np.nan
    dots = placed(pixels, points, noise_m)
    found = pixels.copy()
    found[20] += (1.5, 2.5)
    found = np.concatenate([np.delete(found, 30, axis=0), pixels[:1] - (5.0, 0.0)])
    given = dots.points_m.copy(), dots.covariance_m2.copy()
    surface = SeenSurface.of(flat(), TACTILE)
    after = triangulate_few(dots, frame_of(RIG), RIG, surface, lambda _: spots_at(found))
    same = (after.points_m == dots.points_m).all(axis=1) | np.isnan(after.points_m).all(axis=1)
    known = ~np.isfinite(points).all(axis=1) | (after.covariance_m2 == dots.covariance_m2).all(axis=(1, 2))
    assert np.flatnonzero(same).tolist() == np.flatnonzero(known).tolist() == [7, 20, 30]
    moved = ~same
    error = np.abs(after.points_m - at_depth(pixels, SHEET_M))[moved, 2]
    assert np.sqrt(np.mean(error**2)) < 0.6 * noise_m
    for before, now in zip(given, (dots.points_m, dots.covariance_m2), strict=True):
        assert np.array_equal(before, now, equal_nan=True)  # what was handed in is left alone


def test_a_spot_belongs_to_the_nearest_dot_alone():
    """Though the other's depth is known so little that it might be there."""
    pixels, surface = np.array([(100.0, 121.5), (103.0, 121.5)]), SeenSurface.of(flat(), TACTILE)
    dots = placed(pixels, at_depth(pixels, SHEET_M), 0.05)
    after = triangulate_few(dots, frame_of(ALIGNED), ALIGNED, surface, lambda _: spots_at(np.array([(100.5, 121.5)])))
    assert changed(dots, after).tolist() == [True, False]


@pytest.mark.parametrize("count", [0, 1, 5])
def test_few_dots_are_no_mistake(count):
    pixels = grid(5, 1)[:count]
    dots = placed(pixels, at_depth(pixels, np.full(count, SHEET_M)), DEPTH_NOISE_M)
    surface = SeenSurface.of(flat(), TACTILE)
    after = triangulate_few(dots, frame_of(RIG), RIG, surface, lambda _: spots_at(pixels))
    assert after.points_m.shape == (count, 3)
    assert np.abs(after.points_m - dots.points_m).max(initial=0.0) < 2e-4


# What the simulator's cameras see.


class Simulated:
    """A frame with noise, and its dots where they are without noise and with noise of depth added."""

    def __init__(self):
        with open_source(SCENE) as source, open_source(f"{SCENE}&noise=0") as quiet:
            self.frame, self.rig, clean = source.next_frame(), source.rig, quiet.next_frame()
        camera = self.rig.tactile
        depth = np.where(clean.tactile_depth > 0, clean.tactile_depth * camera.depth_unit_m, np.nan)
        self.surface = SeenSurface.of(depth, camera.intrinsics)
        self.find = partial(find_dots, width_px=11, surface=self.surface)
        pixels = self.find(self.frame.tactile_color).pixels
        self.true = dot_points(clean.tactile_depth, camera, pixels)[0]
        noise = np.random.default_rng(0).normal(0.0, DEPTH_NOISE_M, len(pixels))
        points = self.true * (1.0 + noise / self.true[:, 2])[:, None]
        self.dots = PlacedDots.of(self.surface, pixels, points, np.full(len(pixels), DEPTH_NOISE_M))

    def triangulated(self, rig=None, frame=None):
        return triangulate(self.dots, frame or self.frame, rig or self.rig, self.surface, self.find)


@pytest.fixture(scope="module")
def simulated():
    return Simulated()


@pytest.fixture(scope="module")
def right(simulated):
    return simulated.triangulated()


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def changed(dots, after):
    return (dots.points_m != after.points_m).any(axis=1)


def test_noise_of_the_depth_is_reduced_and_it_is_told_how_much(simulated, right):
    before, error = ((dots.points_m - simulated.true)[:, 2] for dots in (simulated.dots, right))
    assert len(error) > 600 and changed(simulated.dots, right).mean() > 0.95
    assert rms(before) == pytest.approx(DEPTH_NOISE_M, rel=0.05)
    assert rms(error) < 0.55 * rms(before)
    assert abs(error.mean()) < 0.1 * DEPTH_NOISE_M
    assert 0.5 < rms(error / np.sqrt(right.covariance_m2[:, 2, 2])) < 2.0
    assert (right.pixels == simulated.dots.pixels).all()
    aside = simulated.rig.tactile.intrinsics.project(right.points_m) - right.pixels
    assert np.percentile(np.abs(aside), 99) < 4 * MIDDLE_SIGMA_PX  # where the tactile camera saw them


def test_what_is_known_never_becomes_less(simulated, right):
    before, after = simulated.dots.covariance_m2, right.covariance_m2
    less = np.linalg.eigvalsh(before - after)
    assert less.min() > -1e-6 * before.max()
    assert np.linalg.eigvalsh(after).min() > 0.0
    assert np.abs(after - after.transpose(0, 2, 1)).max() < 1e-9 * before.max()
    moved = changed(simulated.dots, right)
    assert (less[moved].max(axis=1) > 0.3 * DEPTH_NOISE_M**2).mean() > 0.95
    assert (after[~moved] == before[~moved]).all()


@pytest.mark.parametrize(
    "degrees, millimetres",
    [
        ((0, 0, 0), (1, 0, 0)),
        ((0, 0, 0), (0, -1, 0)),
        ((0, 0, 0), (0, 0, 1)),
        ((-0.3, 0, 0), (0, 0, 0)),
        ((0, 0.3, 0), (0, 0, 0)),
        ((0, 0, 0.3), (0, 0, 0)),
        ((0.2, -0.2, 0.1), (1, -1, 1)),
    ],
)
def test_a_pose_that_is_a_little_off_moves_no_dot(degrees, millimetres, simulated, right):
    moved = np.asarray(simulated.rig.T_proximity_tactile).copy()
    moved[:3, :3] = pose(degrees, (0, 0, 0))[:3, :3] @ moved[:3, :3]
    moved[:3, 3] += 1e-3 * np.array(millimetres)
    rig = simulated.rig.model_copy(update={"T_proximity_tactile": moved})
    expected, pixels = (SecondCamera.of(one).sees(simulated.true) for one in (simulated.rig, rig))
    assert np.hypot(*(pixels - expected).T).max() > 1.2
    after = simulated.triangulated(rig)
    assert (changed(simulated.dots, after) == changed(simulated.dots, right)).mean() > 0.97
    apart = np.linalg.norm(after.points_m - right.points_m, axis=1)
    assert np.median(apart) < 1e-4
    assert np.percentile(apart, 90) < 2e-4
    assert rms((after.points_m - simulated.true)[:, 2]) < 0.55 * DEPTH_NOISE_M


def test_dots_behind_something_stay_as_they_are(simulated, right):
    """Something gray covers the right half of the second image."""
    colour = simulated.frame.proximity_color.copy()
    colour[:, 330:] = 128
    after = simulated.triangulated(frame=replace(simulated.frame, proximity_color=colour))
    hidden = SecondCamera.of(simulated.rig).sees(simulated.true)[:, 0]
    assert not changed(simulated.dots, after)[hidden > 336].any() and (hidden > 336).sum() > 100
    seen = hidden < 320
    assert seen.sum() > 100 and changed(simulated.dots, after)[seen].mean() > 0.95
    assert rms((after.points_m - right.points_m)[seen]) < 0.2 * DEPTH_NOISE_M


@pytest.mark.parametrize("level", [0, 128])
def test_a_second_image_that_shows_nothing_leaves_dots_alone(level, simulated):
    nothing = np.full_like(simulated.frame.proximity_color, level)
    assert simulated.triangulated(frame=replace(simulated.frame, proximity_color=nothing)) is simulated.dots


def test_without_a_pose_dots_are_left_alone(simulated):
    assert simulated.triangulated(simulated.rig.model_copy(update={"T_proximity_tactile": None})) is simulated.dots


def test_strain_is_nearly_the_same_without_the_second_camera(simulated):
    """With no pose in the rig, or no picture, strain has a little more noise, and nothing else."""
    frame, rig, truth = simulated.frame, simulated.rig, simulated.frame.truth.strain
    both = measure_strain(frame, rig)
    black = replace(frame, proximity_color=np.zeros_like(frame.proximity_color))
    no_pose = rig.model_copy(update={"T_proximity_tactile": None})
    for measured in (measure_strain(black, rig), measure_strain(frame, no_pose)):
        assert measured.dots == both.dots == 665
        assert (measured.points_m != both.points_m).any()
        for axis, other, known in (
            (measured.length, both.length, truth.length_seen),
            (measured.width, both.width, truth.width_seen),
        ):
            assert axis.largest == pytest.approx(other.largest, abs=0.02)
            assert axis.largest == pytest.approx(known, abs=0.03)
            ours, theirs = (dict(zip(map(tuple, it.pairs), it.strain, strict=True)) for it in (axis, other))
            common = ours.keys() & theirs.keys()
            assert len(common) > 0.95 * len(theirs)
            assert rms([ours[pair] - theirs[pair] for pair in common]) < 0.01
        assert np.mean(measured.length.sigma) >= np.mean(both.length.sigma)


@pytest.mark.parametrize(
    ("moved_m", "turned_degrees"),
    [((0.0, 0.0, 0.002), (0, 0, 0)), ((0.0, 0.005, 0.0), (0, 0, 0)), ((0, 0, 0), (0, 0, 2)), ((0, 0, 0), (1, 0, 0))],
)
def test_a_wrong_pose_makes_strain_no_worse_than_without_the_proximity_camera(moved_m, turned_degrees):
    """It is adjusted, or so far off that no dots are found, and then nothing of the proximity camera is used."""
    with open_source("sim:cup?press=high&grid=dots") as source:
        frame, rig = source.next_frame(), source.rig
    wrong = np.eye(4)
    wrong[:3, :3], wrong[:3, 3] = Rotation.from_euler("xyz", turned_degrees, degrees=True).as_matrix(), moved_m
    blind = measure_strain(frame, rig.model_copy(update={"T_proximity_tactile": None}))
    right = measure_strain(frame, rig)
    off = measure_strain(frame, rig, T_proximity_tactile=wrong @ np.array(rig.T_proximity_tactile))
    for axis in ("length", "width"):
        found = getattr(off, axis).largest
        assert min(abs(found - getattr(known, axis).largest) for known in (blind, right)) < 0.003
