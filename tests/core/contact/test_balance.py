"""The edge of contact from the membrane's equilibrium: against analytic solutions, another solver, and scenes."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from tactune.core.contact.kernels import balance as balance_kernels
from tactune.core.contact.kernels.membrane import RayWindow
from tactune.core.contact.membrane import balance
from tactune.core.contact.membrane.balance import Cells, balanced_contact, left_cells, lowest
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.model.provenance import Provenance
from tactune.core.preset import MembraneSection
from tactune.core.sources.presets import load_preset
from tactune.core.sources.simulator.scenes import Variant
from tactune.core.sources.simulator.source import SimulatorSource

SIDE_M, CELLS = 0.001, 61
SECTION = MembraneSection()
MEMBRANE = load_preset("simulator").with_values({"contact_test": "membrane", "alignment.model": "rigid"})


def disc(radius_m: float, push_per_m: float, bias_m: float = 0.0, noise_m: float = 0.0, seed: int = 0) -> Cells:
    """A round object that touches within a radius, beyond which the gap is f / 4 (r^2 - a^2 - 2 a^2 ln(r / a)).

    That is the solution of g'' + g' / r = f with g = g' = 0 at r = a.
    """
    v, u = np.indices((CELLS, CELLS)) - CELLS // 2
    r = np.maximum(np.hypot(u, v) * SIDE_M, radius_m)
    gap = push_per_m / 4 * (r**2 - radius_m**2 - 2 * radius_m**2 * np.log(r / radius_m))
    noise = np.random.default_rng(seed).normal(0, noise_m, gap.shape) if noise_m else 0.0
    measured = (gap + bias_m + noise).astype(np.float32)
    return Cells(
        measured_m=measured,
        smooth_m=(gap + bias_m).astype(np.float32),
        weight=np.ones_like(measured),
        known=gap < 0.006,
        push_per_m=np.full_like(measured, push_per_m),
        sides_m=np.full((2, CELLS, CELLS), SIDE_M, np.float32),
        facing=np.ones_like(measured),
    )


def contact_of(cells: Cells, section: MembraneSection = SECTION) -> np.ndarray:
    """Cells of the firm ones, which reach 3 cells farther than contact, that the membrane has not left."""
    firm = cells.known & (cells.smooth_m < section.gap_m)
    return firm & ~left_cells(cells, firm, section)


def radius_of(contact: np.ndarray) -> float:
    return float(np.sqrt(contact.sum() / np.pi)) * SIDE_M


@pytest.mark.parametrize(("push_per_m", "most_m"), [(40.0, 0.003), (100.0, 0.0018), (250.0, 0.0011)])
@pytest.mark.parametrize("radius_m", [0.003, 0.006, 0.010])
@pytest.mark.parametrize("bias_m", [0.0, 0.0005, -0.0004])
def test_a_disc_s_contact_ends_near_its_radius_whatever_the_bias(radius_m, push_per_m, most_m, bias_m):
    """The less the membrane is pushed, the farther it stays within the gap that still counts as none."""
    cells = disc(radius_m, push_per_m, bias_m)
    near = cells.smooth_m < SECTION.gap_m
    found = radius_of(contact_of(cells))
    assert radius_m - SIDE_M / 2 < found < radius_m + most_m
    assert found - radius_m < 0.5 * (radius_of(near) - radius_m)


@pytest.mark.parametrize("radius_m", [0.003, 0.010])
def test_a_bias_changes_nothing_that_is_believed(radius_m):
    without = contact_of(disc(radius_m, 120.0), MembraneSection(gap_m=0.003))
    for bias_m in (-0.0009, -0.0003, 0.0006, 0.0009):
        cells = disc(radius_m, 120.0, bias_m)
        section = MembraneSection(gap_m=0.003, bias_m=0.0012 if bias_m != -0.0003 else 0.02)
        firm = cells.smooth_m < 0.003 + bias_m
        kept = firm & ~left_cells(cells, firm, section)
        assert np.count_nonzero(kept ^ without) <= 8


def cut(cells: Cells, columns: slice) -> Cells:
    return Cells(*(np.ascontiguousarray(getattr(cells, part.name)[..., columns]) for part in fields(cells)))


@pytest.mark.parametrize("last", [33, 34, 36])
def test_where_the_image_ends_contact_ends_as_in_a_larger_one(last):
    """Half of the disc is seen, and the edge of contact runs into the border."""
    whole = disc(0.008, 120.0, 0.0003, 0.0001)
    expected, found = contact_of(whole)[:, :last], contact_of(cut(whole, np.s_[:last]))
    assert expected[:, -1].sum() > 10
    assert abs(int(found[:, -1].sum()) - int(expected[:, -1].sum())) <= 2
    assert np.count_nonzero(found ^ expected) < 0.06 * expected.sum()


def test_a_group_of_which_no_bias_is_told_stays_beside_one_of_which_one_is():
    """The second group is measured far before what it should touch: with no believed bias is it in contact."""
    cells = disc(0.006, 120.0)
    far = replace(cells, measured_m=cells.measured_m + np.float32(0.01))
    both = Cells(*(np.concatenate([getattr(c, f.name) for c in (cells, far)], axis=-1) for f in fields(cells)))
    firm = np.tile(cells.smooth_m < SECTION.gap_m, (1, 2))
    left = left_cells(both, firm, SECTION)
    assert left[:, :CELLS][firm[:, :CELLS]].sum() > 50
    assert not left[:, CELLS:].any()


def test_noise_of_the_sensors_moves_the_edge_by_less_than_two_cells():
    radii = [radius_of(contact_of(disc(0.006, 120.0, 0.0004, 0.0004, seed))) for seed in range(8)]
    assert np.mean(radii) == pytest.approx(0.006, abs=0.001)
    assert np.ptp(radii) < 0.003


def test_no_larger_bias_is_sought_than_is_believed():
    cells = disc(0.006, 120.0, 0.0008)
    radii = [radius_of(contact_of(cells, MembraneSection(bias_m=most_m))) for most_m in (0.0, 0.0004, 0.0012)]
    assert radii[0] < radii[1] < radii[2]
    assert radii[2] == pytest.approx(0.006, abs=0.001)


def test_groups_that_are_not_firm_contact_are_left_alone():
    cells = disc(0.006, 120.0)
    assert not left_cells(cells, np.zeros((CELLS, CELLS), bool), SECTION).any()


@pytest.mark.parametrize("seed", range(3))
def test_the_gap_is_that_of_another_solver(seed):
    rng = np.random.default_rng(seed)
    size = 14
    inside = np.zeros((size, size), bool)
    inside[1:-1, 1:-1] = rng.random((size - 2, size - 2)) > 0.1
    known = inside | (rng.random((size, size)) > 0.5)
    sides = rng.uniform(0.0008, 0.0015, (2, size, size)).astype(np.float32)
    weight = rng.choice([0.0, 0.5, 1.0], (size, size)).astype(np.float32)
    count = int(inside.sum())
    places, links = np.empty(count, np.int32), np.empty((7, count), np.float32)
    even = balance_kernels.link_cells(inside, known, sides, weight, np.float32(0.004), places, links)
    assert sorted(places) == sorted(np.flatnonzero(inside))
    assert ((places[:even] // size + places[:even] % size) % 2).max() == 0
    gaps = rng.uniform(0, 0.003, (size, size)).astype(np.float32)
    measured, push = rng.normal(0, 0.001, count), rng.uniform(50, 900, count)
    loads = (links[4] * measured - links[5] * push).astype(np.float32)
    index = {int(place): i for i, place in enumerate(places)}
    matrix, right = np.diag(links[:5].sum(axis=0)).astype(np.float64), loads.astype(np.float64)
    for i, place in enumerate(places):
        for link, step in zip(links[:4, i], (-1, 1, -size, size), strict=True):
            if (neighbour := index.get(int(place) + step)) is None:
                right[i] += link * gaps.reshape(-1)[place + step]
            else:
                matrix[i, neighbour] -= link
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-6)
    root = np.linalg.cholesky(matrix).T
    expected = lsq_linear(root, np.linalg.solve(root.T, right), (0, np.inf), tol=1e-14).x
    relaxation = balance_kernels.Relaxation(np.float32(1.5), np.float32(1e-8), 5000)
    balance_kernels.settle(gaps.reshape(-1), size, balance_kernels.Equations(places, links, even), loads, relaxation)
    found = gaps.reshape(-1)[places]
    assert 0 < (expected > 1e-6).sum() < count
    np.testing.assert_allclose(found, expected, atol=2e-6)


@given(st.floats(-0.9, 0.9), st.floats(0.1, 100.0), st.floats(0.0, 10.0), st.integers(5, 15), st.booleans())
def test_the_lowest_point_of_a_parabola_is_found(middle, bend, least, count, falling):
    tried = np.linspace(-1, 1, count)[:: -1 if falling else 1].astype(np.float32)
    misfits = np.stack([bend * (tried.astype(float) - middle) ** 2 + least, np.full(count, np.inf)], axis=1)
    found = lowest(tried, misfits)
    step = 2 / (count - 1)
    assert found[0] == pytest.approx(middle, abs=step / 2 + 1e-6 if abs(middle) > 1 - step else 1e-4)
    assert np.isnan(found[1])


def test_one_bias_alone_is_the_lowest():
    assert lowest(np.zeros(1, np.float32), np.array([[3.0, np.inf]])) == pytest.approx([0.0, np.nan], nan_ok=True)


def test_images_of_pixels_become_cells_and_back():
    image = np.zeros((5, 7), bool)
    image[0, 0] = image[1, 1] = image[2, 4] = image[3, 6] = image[4, 6] = True
    cells = balance._halved(image)
    np.testing.assert_array_equal(cells, [[True, False, False], [False, False, False]])
    back = balance._doubled(np.array([[True, False, False], [False, False, True]]), (5, 7))
    expected = np.zeros((5, 7), bool)
    expected[:2, :2] = expected[2:, 4:] = True
    np.testing.assert_array_equal(back, expected)


def test_a_cell_is_the_mean_of_what_is_usable_and_known():
    rng = np.random.default_rng(1)
    differences, depth, gaps = (rng.uniform(0.1, 0.3, (5, 7)).astype(np.float32) for _ in range(3))
    usable, known = rng.random((5, 7)) > 0.4, rng.random((5, 7)) > 0.4
    rays = rng.uniform(-0.5, 0.5, (9, 12, 2)).astype(np.float32)
    out = np.empty((7, 2, 3), np.float32)
    images = balance_kernels.GapImages(differences, depth, usable, gaps, known)
    balance_kernels.average_cells(images, RayWindow(rays, 3, 4), out)
    for row, column in np.ndindex(2, 3):
        box = np.s_[2 * row : 2 * row + 2, 2 * column : 2 * column + 2]
        seen, ray, z = usable[box], rays[3:8, 4:11][box], depth[box]
        expected = [
            differences[box][seen].mean() if seen.any() else 0,
            seen.mean(),
            (ray[..., 0] * z * seen).mean(),
            (ray[..., 1] * z * seen).mean(),
            (z * seen).mean(),
            gaps[box][known[box]].mean() if known[box].any() else 0,
            known[box].sum(),
        ]
        np.testing.assert_allclose(out[:, row, column], expected, rtol=1e-5)


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.4, -0.2, 1.0), (-0.5, 0.5, 1.0)])
def test_cells_of_a_tilted_plane_are_as_long_as_its_points_are_apart(normal):
    rays = np.stack(np.meshgrid(np.linspace(-0.5, 0.5, 101), np.linspace(-0.4, 0.4, 81)))
    z = 0.3 / (normal[0] * rays[0] + normal[1] * rays[1] + normal[2])
    points = np.stack([rays[0] * z, rays[1] * z, z]).astype(np.float32)
    sides, facing = np.empty((2, 81, 101), np.float32), np.empty((81, 101), np.float32)
    shares = np.ones((81, 101), np.float32)
    balance_kernels.measure_cells(points, shares, np.float32(0.5), (0.01, 0.01), True, sides, facing)
    inner = np.s_[..., 1:-1, 1:-1]
    right, down = points[:, 1:-1, 2:] - points[:, 1:-1, :-2], points[:, 2:, 1:-1] - points[:, :-2, 1:-1]
    lengths = np.stack([np.linalg.norm(steps, axis=0) / 2 for steps in (right, down)])
    np.testing.assert_allclose(sides[inner], lengths, rtol=0.01)
    along = np.abs(np.tensordot(normal, points / points[2], 1)) / np.linalg.norm(normal)
    np.testing.assert_allclose(facing[inner], np.minimum(along, 1)[inner], rtol=0.01)
    balance_kernels.measure_cells(points, shares, np.float32(0.5), (0.01, 0.01), False, sides, facing)
    assert (facing == 1).all()
    np.testing.assert_allclose(sides[inner], lengths, rtol=0.01)
    balance_kernels.measure_cells(points, 0 * shares, np.float32(0.5), (0.01, 0.01), True, sides, facing)
    assert (sides == np.float32(0.001)).all()


@pytest.fixture(scope="module")
def light_press() -> SimulatorSource:
    return SimulatorSource("cup", seed=3, variant=Variant(press="low"))


def test_a_light_press_is_narrowed_to_where_it_touches(light_press):
    frame = light_press.read(0)
    truth, seen = frame.truth.contact, replace(frame, truth=None)
    with_it = ContactPipeline(MEMBRANE, light_press.rig).process(seen)
    without = ContactPipeline(MEMBRANE.with_value("membrane.balance", False), light_press.rig).process(seen)
    assert not (with_it.mask & ~without.mask).any()
    falsely, missed = np.count_nonzero(with_it.mask & ~truth), np.count_nonzero(truth & ~with_it.mask)
    assert falsely < 0.8 * np.count_nonzero(without.mask & ~truth)
    assert missed < 0.15 * np.count_nonzero(truth)
    taken = without.mask & ~with_it.mask
    assert np.count_nonzero(with_it.provenance[taken] == Provenance.RIM) > 0.9 * taken.sum()


def test_the_balance_does_without_the_test_of_the_curvature(light_press):
    unasked = MEMBRANE.with_value("membrane.curvature", 0.0)
    frame = replace(light_press.read(0), truth=None)
    with_it = ContactPipeline(unasked, light_press.rig).process(frame).mask
    without = ContactPipeline(unasked.with_value("membrane.balance", False), light_press.rig).process(frame).mask
    assert 0 < with_it.sum() < 0.9 * without.sum()


def test_specks_of_which_nothing_is_left_go_and_larger_groups_stay(monkeypatch, light_press):
    seen: dict[str, tuple] = {}

    def remember(*arguments: object) -> np.ndarray:
        seen["arguments"] = arguments
        return balanced_contact(*arguments)

    monkeypatch.setattr("tactune.core.contact.membrane.finder.balanced_contact", remember)
    ContactPipeline(MEMBRANE, light_press.rig).process(light_press.read(0))
    pressed, *rest = seen["arguments"]
    shape = pressed.contact.shape
    kept, speck, large = (np.zeros(shape, bool) for _ in range(3))
    kept[2:12, 2:12] = speck[2:10, 20:30] = large[2:12, 40:50] = True
    everything = replace(pressed, contact=kept | speck | large)
    gone = np.zeros((shape[0] // 2, shape[1] // 2), bool)
    gone[:, 9:] = True
    monkeypatch.setattr(balance, "left_cells", lambda *_: gone)
    np.testing.assert_array_equal(balanced_contact(everything, *rest), kept | large)
    monkeypatch.setattr(balance, "left_cells", lambda *_: np.ones_like(gone))
    np.testing.assert_array_equal(balanced_contact(everything, *rest), everything.contact)
