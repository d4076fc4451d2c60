from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactune.core.contact.kernels.membrane import count_gaps
from tactune.core.contact.membrane.gaps import (
    LocalMean,
    contact_bias_m,
    erode_rim,
    print_bias_m,
    surroundings,
    turn_to_normal,
)
from tactune.core.model.clouds import ray_table
from tactune.core.model.intrinsics import Intrinsics


def test_the_mean_leaves_out_what_is_not_usable():
    usable = np.zeros((20, 20), bool)
    usable[:, :10] = True
    image = np.where(usable, 2.0, 1e6).astype(np.float32)
    means = LocalMean(usable, 2.0)
    mean, share = means.of(image), means.share
    np.testing.assert_allclose(mean[:, :11], 2.0, rtol=1e-5)
    assert share[10, 5] == pytest.approx(1.0)
    assert 0.5 < share[10, 9] < 0.7
    np.testing.assert_array_equal(LocalMean(usable, 0.0).of(image), image * usable)
    np.testing.assert_array_equal(means.cut(np.s_[3:9, 2:7]).share, share[3:9, 2:7])


def test_gaps_are_turned_to_the_normal_of_a_plane():
    camera = Intrinsics(width=320, height=240, fx=260.0, fy=250.0, cx=159.5, cy=119.5)
    part = np.s_[100:140, 140:180]
    for normal in ((0.0, 0.0, 1.0), (0.6, 0.0, 0.8), (0.3, -0.5, 0.812), (0.99, 0.0, 0.141)):
        depth = (0.3 / (camera.rays() @ np.array(normal[:2]) + normal[2])).astype(np.float32)[part]
        gaps = np.full(depth.shape, 0.002, np.float32)
        turn_to_normal(gaps, depth, ray_table(camera), (100, 140), (camera.fx, camera.fy))
        expected = 0.002 * max(normal[2], 0.25)
        np.testing.assert_allclose(gaps[1:-1, 1:-1], expected, atol=4e-6)


def test_biases():
    rng = np.random.default_rng(1)
    gaps = np.concatenate([rng.normal(0.0007, 0.0003, 5000), rng.uniform(0, 0.004, 2000)]).astype(np.float32)
    known = np.ones((70, 100), bool)
    assert contact_bias_m(gaps.reshape(70, 100), known, 0.002) == pytest.approx(0.0007, abs=1.5e-4)
    assert contact_bias_m(gaps.reshape(70, 100), known, 0.0) == 0.0
    two = np.concatenate([rng.normal(0.0015, 0.0002, 5000), rng.normal(0.0003, 0.0002, 2000)]).astype(np.float32)
    assert contact_bias_m(two.reshape(70, 100), known, 0.002) == pytest.approx(0.0015, abs=1e-4)
    assert contact_bias_m(two.reshape(70, 100), known, 0.001) == pytest.approx(0.0003, abs=1e-4), "beyond the limit"
    few = known & (np.arange(7000).reshape(70, 100) < 50)
    assert contact_bias_m(gaps.reshape(70, 100), few, 0.002) == 0.0
    assert print_bias_m(np.full(500, 0.0005, np.float32)) == pytest.approx(0.0005)
    assert print_bias_m(np.full(50, 0.0005, np.float32)) == 0.0


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([0.0003, 0.00049999, 0.001, 0.0012]))
def test_gaps_are_counted_as_numpy_counts_them(seed, limit):
    rng = np.random.default_rng(seed)
    edges = np.arange(-limit, limit + 5e-5, 1e-4)
    gaps = rng.choice([*edges.astype(np.float32), 0.0], (9, 40)).astype(np.float32)
    gaps = np.where(rng.random(gaps.shape) < 0.5, np.nextafter(gaps, rng.choice([-1, 1])), gaps).astype(np.float32)
    known = rng.random(gaps.shape) < 0.9
    counts = np.zeros(len(edges) - 1, np.int64)
    within = gaps[known & (np.abs(gaps) < np.float32(limit))]
    assert count_gaps(gaps, known, np.float32(limit), edges, counts) == len(within)
    np.testing.assert_array_equal(counts, np.histogram(within, edges)[0])


def test_the_surroundings_end_with_the_image():
    marked = np.zeros((40, 70), bool)
    assert surroundings(marked, 3) is None
    marked[5, 37] = marked[30, 50] = True
    assert surroundings(marked, 3) == np.s_[2:34, 34:54]
    assert surroundings(marked, 12) == np.s_[0:40, 25:63]
    assert surroundings(marked, 3, vectors=16) == np.s_[2:34, 32:69]
    assert surroundings(marked, 12, vectors=16) == np.s_[0:40, 16:70]


def test_a_tangential_rim_is_taken_away_and_an_end_is_not():
    """A strip that ends to the left, and from column 60 on leaves with the gap growing by the square."""
    u = np.arange(120, dtype=np.float32)
    gap = np.tile(np.where(u > 60, 2e-5 * (u - 60) ** 2 / 2, 0), (80, 1)).astype(np.float32)
    known = np.tile(u >= 20, (80, 1))
    near = known & (gap < 0.0018)
    left = erode_rim(near, known & (gap < 2.5 * 0.0018), 2.5, 1.0, 1.0, 20.0)[40]
    assert np.flatnonzero(near[40])[-1] == 73
    assert abs(int(np.flatnonzero(left)[-1]) - 60) <= 2
    assert np.flatnonzero(left)[0] == 20
