"""Dots where the surface turns away from the camera or is hidden."""

from __future__ import annotations

import numpy as np
import pytest

from tactune.core.evaluation.strain.dots import find_dots
from tactune.core.evaluation.strain.lattice import DotLattice
from tactune.core.evaluation.strain.surface import SeenSurface, whole_dots
from tactune.core.model.intrinsics import Intrinsics

LENS = Intrinsics(width=160, height=128, fx=386.0, fy=386.0, cx=79.5, cy=63.5)
RADIUS_M, FAR_M, NEAR_M = 0.010, 0.30, 0.22
DOT_M = 0.004


def lip(angle):
    """Return depth and image of a lip: a half cylinder along u, 10 mm in radius, before a wall, with a dot on it.

    The dot's centre lies at ``angle`` (degrees) from the nearest line of the lip; its pixel is returned as well.
    """
    v, u = np.mgrid[:128, :160].astype(float)
    x, y = (u - LENS.cx) / LENS.fx, (v - LENS.cy) / LENS.fy
    # (y z)^2 + (z - middle)^2 = RADIUS_M^2: a quadratic in z
    middle = NEAR_M + RADIUS_M
    a, b, c = 1 + y**2, -2 * middle, middle**2 - RADIUS_M**2
    square = b**2 - 4 * a * c
    on_lip = square >= 0
    z = np.where(on_lip, (-b - np.sqrt(np.maximum(square, 0))) / (2 * a), FAR_M)
    arc = RADIUS_M * np.arctan2(y * z, middle - z)
    inside = on_lip & (np.hypot(x * z, arc - RADIUS_M * np.radians(angle)) < DOT_M)
    at_y, at_z = RADIUS_M * np.sin(np.radians(angle)), middle - RADIUS_M * np.cos(np.radians(angle))
    image = np.where(inside, 60, 180).astype(np.uint8)
    return z, image, (LENS.cx, LENS.cy + LENS.fy * at_y / at_z), inside


@pytest.mark.parametrize("angle", [0, 40, 50, -50, 60])
def test_the_centroid_of_a_dot_on_a_bent_surface_is_the_one_on_the_surface(angle):
    depth, image, (u, v), inside = lip(angle)
    spots = find_dots(image, 21, SeenSurface.of(depth, LENS))
    assert len(spots) == 1
    assert spots.pixels[0] == pytest.approx((u, v), abs=0.18)
    if angle:
        assert abs(np.nonzero(inside)[0].mean() - v) > 0.7  # where the dot's pixels are on the mean


def test_a_spot_ends_where_another_surface_begins():
    """A dot on the wall touches one on the lip in the image."""
    depth, image, _, inside = lip(62)
    rows, columns = np.nonzero(inside)
    image[rows.max() + 1 : rows.max() + 4, columns.min() : columns.min() + 6] = 60
    depth[rows.max() + 1 :] = FAR_M
    surface = SeenSurface.of(depth, LENS)
    alone, both = (find_dots(picture, 21, surface) for picture in (np.where(inside, 60, 180).astype(np.uint8), image))
    assert (len(alone), len(both)) == (1, 2)
    assert both.at_step.all()
    near = np.argmin(both.pixels[:, 1])
    assert both.pixels[near] == pytest.approx(alone.pixels[0], abs=0.3)
    flat = SeenSurface.of(np.full_like(depth, FAR_M), LENS)
    assert len(find_dots(image, 21, flat)) == 1


def test_a_dot_at_an_edge_is_whole_where_its_area_is_what_the_grid_around_it_says():
    row, column = np.mgrid[:4, :5]
    cells = np.column_stack([row.ravel(), column.ravel()])
    lattice = DotLattice(cells, np.zeros(len(cells), np.int64))
    points = np.column_stack(
        [0.02 * cells[:, 1], 0.015 * cells[:, 0], np.full(len(cells), 0.3)]
    )  # stretched, all alike
    area = np.full(len(cells), 9e-6)
    area[[0, 7, 8, 9]] *= 0.55, 0.55, 2.2, 1.1
    at_step = np.isin(np.arange(len(cells)), (7, 8, 9, 10))
    assert np.flatnonzero(~whole_dots(lattice, points, area, at_step)).tolist() == [7, 8]
