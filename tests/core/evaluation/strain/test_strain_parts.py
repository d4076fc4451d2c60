"""Parts of the strain measurement: accepted neighbours, squares of the map, averaged frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from rigs import one_place_rig
from tactune.core.errors import FrameError
from tactune.core.evaluation.strain.average import average_still
from tactune.core.evaluation.strain.lattice import DotLattice, order_dots
from tactune.core.evaluation.strain.strain import AxisStrain, StrainMeasurement, axis_strain, crossed, grid_cells
from tactune.core.evaluation.strain.surface import surface_area
from tactune.core.model.frames import SensorFrame

RIG = one_place_rig(160, 128, 100.0, 1e-4)
CAMERA, LENS = RIG.tactile, RIG.tactile.intrinsics


def grid(columns, rows, spacing=1.0):
    j, i = np.mgrid[:rows, :columns]
    return np.column_stack([i.ravel(), j.ravel()]) * spacing, np.column_stack([j.ravel(), i.ravel()])


def pairs_of(cells):
    lattice = DotLattice(np.asarray(cells, np.int64), np.zeros(len(cells), np.int64))
    return lattice.neighbours(1), lattice.neighbours(0)


def test_sides_of_squares_are_believed_and_diagonals_are_not():
    places, cells = grid(5, 4)
    points = np.column_stack([1.5 * places[:, 0], places[:, 1], np.full(len(places), 30.0)])
    along, across = pairs_of(cells)
    assert crossed(along, across, points).all()
    assert crossed(across, along, points).all()
    sheared = np.column_stack([cells[:, 0] + cells[:, 1], cells[:, 1]])  # each column one row further
    along, across = pairs_of(sheared)
    assert len(along) and not crossed(along, across, points).any()


def test_a_pair_that_nothing_crosses_is_not_believed():
    points = np.column_stack([np.arange(4.0), np.zeros(4), np.full(4, 30.0)])
    assert not crossed(np.array([[0, 1], [1, 2]]), np.empty((0, 2), np.int64), points).any()


def test_a_length_is_confirmed_only_by_lengths_that_are_confirmed():
    """Three pairs beside each other leave out a dot. Both outer ones are refused, so nothing confirms the middle."""
    places, cells = grid(9, 6, 0.01)
    points = np.column_stack([places, np.full(len(places), 0.3)])
    middle = np.abs(cells[:, 1] - 4) <= 1
    points[middle & (cells[:, 0] <= 2), 1] -= 0.01
    across = pairs_of(cells)[1]
    row = cells[across[:, 0], 0]
    across = across[~(middle[across[:, 0]] & ((row == 1) | (row == 3)))]
    where = np.column_stack([np.zeros(len(cells), np.int64), cells])
    samples = points[:, :, None] + np.random.default_rng(0).normal(0, 1e-8, (*points.shape, 32))
    axis = axis_strain(across, points, samples, 0.01, where)
    assert axis.largest == pytest.approx(0.0, abs=1e-6)
    assert len(axis.pairs) > len(across) / 2


def test_a_pixel_that_sees_a_slope_shows_more_of_it_and_an_edge_is_no_slope():
    u = np.arange(160.0)
    depth = np.where(u < 80, 0.2, 0.3) * np.ones((128, 1))
    flat = surface_area(depth, LENS)[64]
    expected = (depth[64] / 100.0) ** 2
    assert flat == pytest.approx(expected, rel=1e-6)
    ray = (u - LENS.cx) / 100.0
    wall = np.broadcast_to(0.3 / (1 - ray), (128, 160))  # the plane z = 0.3 + x, at 45 degrees
    near = np.abs(u - 60) < 20
    side = wall[64] / 100.0
    tilted = side**2 * np.sqrt(2.0) / (1 - ray)
    assert surface_area(wall, LENS)[64, near] == pytest.approx(tilted[near], rel=0.03)


def test_few_dots_on_top_of_an_object_are_a_piece_of_their_own():
    """Ten dots farther apart than the others; two corners are hidden, so that no 3 x 3 is among them."""
    places, _ = grid(25, 15, 10.0)
    hole = (np.abs(places[:, 0] - 120) < 55) & (np.abs(places[:, 1] - 70) < 45)
    top, cells = (both[1:-1] for both in grid(4, 3, 26.0))
    top += (82, 44)
    pixels = np.concatenate([places[~hole], top])
    lattice = order_dots(pixels)
    on_top = lattice.piece[-len(top) :]
    assert (on_top == 1).all()
    assert (lattice.piece[: -len(top)] == 0).all()
    found = lattice.cells[-len(top) :]
    assert (found - found.min(axis=0) == cells).all()


def test_a_square_of_the_map_needs_all_four_sides():
    places, cells = grid(3, 3)
    along, across = pairs_of(cells)

    def axis(pairs, strain):
        return AxisStrain(pairs, strain, np.zeros(len(pairs)), strain, float(strain.max()), 0.0)

    length = np.where((cells[along[:, 0]] == (0, 0)).all(axis=1), 0.4, 0.2)
    lattice = DotLattice(cells, np.zeros(9, np.int64))
    both = StrainMeasurement(places, places, lattice, axis(along, length), axis(across, np.full(6, 0.1)))
    squares = grid_cells(both)
    assert len(squares.corners) == 4
    first = (squares.corners == 0).any(axis=1)
    assert squares.length[first] == pytest.approx([0.3])
    assert squares.largest[~first] == pytest.approx([0.2] * 3)
    assert squares.width == pytest.approx([0.1] * 4)
    corners = places[squares.corners]
    (ax, ay), (bx, by) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 1]).T
    area = ax * by - ay * bx
    assert np.abs(area) == pytest.approx([1.0] * 4)  # once around, not crosswise
    assert len(grid_cells(replace(both, length=axis(along[1:], length[1:]))).corners) == 3


def still(sequence, depth_m=0.3, bump_m=0.0, seed=0):
    rng = np.random.default_rng(seed)
    depth = np.full((128, 160), depth_m) + rng.normal(0, 0.0006, (128, 160))
    depth[32:96, 32:96] -= bump_m
    counts = np.rint(depth / 1e-4).astype(np.uint16)
    color = rng.integers(90, 110, (128, 160, 3), dtype=np.uint8)
    return SensorFrame(sequence, counts, counts, color, color, proximity_time_s=sequence / 30)


def test_frames_at_rest_are_averaged_up_to_the_newest_movement():
    frames = [still(n, seed=n) for n in range(3)] + [still(n, bump_m=0.004, seed=n) for n in range(3, 10)]
    frame, count = average_still(frames, RIG)
    assert (count, frame.sequence, frame.proximity_time_s) == (7, 9, frames[-1].proximity_time_s)
    noise = frame.tactile_depth[:32].std() / frames[-1].tactile_depth[:32].std()
    assert noise < 0.6
    assert frame.tactile_color.std() < 0.7 * frames[-1].tactile_color.std()


@pytest.mark.parametrize("length_px, moved_m, count", [(0.0, 0.0, 9), (5.0, 0.0, 9), (8.0, 0.0, 9), (5.0, 0.003, 4)])
def test_noise_that_neighbours_share_is_no_movement(length_px, moved_m, count):
    rng = np.random.default_rng(1)
    v, u = np.indices((480, 640))
    bump = np.exp(-((v - 240) ** 2 + (u - 320) ** 2) / (2 * 80.0**2))
    rig, frames = one_place_rig(640, 480, 400.0, 1e-4), []
    for number in range(9):
        noise = gaussian_filter(rng.normal(size=bump.shape), length_px)
        depth = 0.3 - moved_m * (number > 4) * bump + 0.0012 / noise.std() * noise
        counts = np.rint(depth / 1e-4).astype(np.uint16)
        color = np.zeros((480, 640, 3), np.uint8)
        frames.append(SensorFrame(number, counts, counts, color, color))
    assert average_still(frames, rig)[1] == count


def test_a_single_frame_stays_what_it_is():
    frame = still(4)
    assert average_still([frame], RIG) == (frame, 1)
    moved = still(5, bump_m=0.004)
    assert average_still([frame, moved], RIG) == (moved, 1)


def test_frames_of_another_rig_are_refused():
    small = np.zeros((40, 40), np.uint16)
    other = SensorFrame(0, small, small, np.zeros((40, 40, 3), np.uint8))
    with pytest.raises(FrameError):
        average_still([other, still(1)], RIG)
