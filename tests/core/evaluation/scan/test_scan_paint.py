"""Contact by colour: the clean-up, and points on the contact."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tactune.core.errors import TactuneError
from tactune.core.evaluation.scan.paint import PaintSettings, contact_points, painted_contact
from tactune.core.evaluation.scan.scan import Scan

PINK, PURPLE = (235, 110, 170), (90, 50, 140)
SIDE_M = 0.001


def plate(pink, count=101):
    """A flat mesh of 1 mm squares, pink where the function of x and y (millimetres) says so."""
    y, x = np.mgrid[:count, :count].astype(float)
    number = np.arange(count * count).reshape(count, count)
    a, b, c, d = (part.ravel() for part in (number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]))
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(count * count)], 1) * SIDE_M
    colors = np.where(pink(x, y).ravel()[:, None], PINK, PURPLE).astype(np.uint8)
    return Scan(vertices, triangles, colors)


def disc(x0, y0, radius):
    return lambda x, y: np.hypot(x - x0, y - y0) < radius


def spots(x, y):
    """Three spots of 707, 314 and 28 mm2, the first with a hole of 28 mm2."""
    large = disc(30, 30, 15)(x, y) & ~disc(30, 30, 3)(x, y)
    return large | disc(70, 70, 10)(x, y) | disc(10, 80, 3)(x, y)


def area_mm2(scan, contact):
    return contact.sum() * SIDE_M**2 * 1e6


@pytest.mark.parametrize(
    "least, largest, expected",
    [
        (0, 0, 707 - 28 + 314 + 28),
        (40, 0, 707 + 314),  # the hole is filled, the small spot dropped
        (40, 1, 707),
        (400, 0, 707),
        (0, 2, 707 - 28 + 314),
        (0, 1, 707 - 28),
        (800, 0, 0),
    ],
)
def test_small_spots_and_holes_go_and_the_largest_stay(least, largest, expected):
    scan = plate(spots)
    contact = painted_contact(scan, PaintSettings(least_area_mm2=least, largest=largest))
    assert area_mm2(scan, contact) == pytest.approx(expected, abs=30)


def test_noise_and_specks_are_cleaned_up():
    clean, random = plate(disc(50, 50, 25)), np.random.default_rng(3)
    specks = random.random(len(clean.colors)) < 0.03
    other = np.where((clean.colors == PINK).all(axis=1)[:, None], PURPLE, PINK)
    colors = np.where(specks[:, None], other, clean.colors) + random.normal(0, 12, clean.colors.shape)
    noisy = Scan(clean.vertices_m, clean.triangles, np.clip(np.round(colors), 0, 255).astype(np.uint8))
    settings = PaintSettings(least_area_mm2=20)
    differs = painted_contact(noisy, settings) != painted_contact(clean, settings)
    assert differs.sum() < 0.01 * len(differs)
    rim = np.abs(np.hypot(*(clean.vertices_m[:, :2].T * 1e3 - 50)) - 25) < 2
    assert not differs[~rim].any()


def test_a_hue_range_may_wrap_through_red():
    scan = plate(lambda x, y: x < 50)
    scan.colors[scan.vertices_m[:, 0] < 0.05] = (230, 60, 50)  # hue 2
    assert not painted_contact(scan, PaintSettings()).any()
    assert painted_contact(scan, PaintSettings(hue=(170, 10))).sum() == 50 * 101


@pytest.mark.parametrize(
    "values, words",
    [
        ({"hue": (0, 300)}, "hue"),
        ({"value": (200, 100)}, "value has its low end 200"),
        ({"least_area_mm2": float("nan")}, "least area"),
        ({"largest": -1}, "-1 spots"),
    ],
)
def test_settings_that_cannot_be_are_refused(values, words):
    with pytest.raises(TactuneError, match=words):
        PaintSettings(**values)


def test_points_cover_the_contact_evenly_by_area():
    scan = plate(disc(50, 50, 30))
    contact = painted_contact(scan, PaintSettings())
    points = contact_points(scan, contact, 0.0005)
    assert points.dtype == np.float32
    assert len(points) * 0.25 == pytest.approx(np.pi * 900, rel=0.01)
    np.testing.assert_array_equal(points, contact_points(scan, contact, 0.0005))
    inside = np.stack(np.meshgrid(*[np.arange(31, 70, 0.37)] * 2), -1).reshape(-1, 2)
    inside = inside[np.hypot(*(inside - 50).T) < 28]
    gaps, _ = cKDTree(points[:, :2] * 1e3).query(inside)
    assert gaps.max() < 1.1 and np.sqrt(np.mean(gaps**2)) < 0.32
    quarter = (points[:, 0] < 0.05) & (points[:, 1] < 0.05)
    assert quarter.mean() == pytest.approx(0.25, abs=0.01)


def test_points_do_not_depend_on_how_fine_the_mesh_is_elsewhere():
    """A fine half has many more triangles than a coarse one, and as many points."""
    vertices = [[0, 0, 0], [0.04, 0, 0], [0.04, 0.04, 0], [0, 0.04, 0]]
    fine = plate(lambda x, y: x >= 0, 41)
    both = Scan(
        np.concatenate([np.array(vertices) - [0.1, 0, 0], fine.vertices_m]),
        np.concatenate([[[0, 1, 2], [0, 2, 3]], fine.triangles + 4]).astype(np.int32),
        np.concatenate([[PINK] * 4, fine.colors]).astype(np.uint8),
    )
    points = contact_points(both, painted_contact(both, PaintSettings()), 0.0005)
    assert (points[:, 0] < -0.01).mean() == pytest.approx(0.5, abs=0.002)
    coarse = points[points[:, 0] < -0.01]
    counts, _, _ = np.histogram2d(coarse[:, 0], coarse[:, 1], bins=8, range=[[-0.1, -0.06], [0, 0.04]])
    assert counts.min() > 90 and counts.max() < 110


def test_contact_ends_between_vertices():
    """One of a triangle's corners in contact gives a quarter of it, two give three quarters."""
    vertices = np.array([[0, 0, 0], [0.02, 0, 0], [0, 0.02, 0]], float)
    triangle = Scan(vertices, np.array([[0, 1, 2]], np.int32), np.zeros((3, 3), np.uint8))
    for corners, share in (([1, 0, 0], 0.25), ([1, 1, 0], 0.75), ([1, 1, 1], 1.0), ([0, 0, 0], 0.0)):
        points = contact_points(triangle, np.array(corners, bool), 0.0001)
        assert len(points) * 1e-8 == pytest.approx(share * 2e-4, rel=0.01, abs=1e-9)


def test_arguments_that_do_not_fit_are_refused():
    scan = plate(disc(50, 50, 20))
    with pytest.raises(TactuneError, match="compute it from this scan"):
        contact_points(scan, np.ones(7, bool))
    everywhere = np.ones(len(scan.vertices_m), bool)
    for spacing in (0.0, -1.0, np.nan):
        with pytest.raises(TactuneError, match="the spacing is"):
            contact_points(scan, everywhere, spacing)
    with pytest.raises(TactuneError, match=r"the painted contact is .* cm2 .* check the scan's unit"):
        contact_points(replace(scan, vertices_m=100 * scan.vertices_m), everywhere)
