"""Strains that do not fit those of the frames before and after."""

from __future__ import annotations

import numpy as np
import pytest

from tactune.core.evaluation.strain.series import spikes


def press(count=40, depth_mm=40.0):
    """A press and its release: displacement, and a strain of 0.8 % per mm with a little noise."""
    moved = depth_mm * np.sin(np.linspace(0, np.pi, count))
    return moved, 0.8 * moved + np.random.default_rng(2).normal(0, 0.5, count)


@pytest.mark.parametrize("count", [3, 6, 12, 40])
def test_a_press_and_its_release_have_no_spike(count):
    assert not spikes(*press(count)).any()


@pytest.mark.parametrize("places", [[0], [7], [20], [39], [20, 21]])
def test_what_stands_out_is_found_alone(places):
    moved, strain = press()
    strain[places] += 27
    assert np.flatnonzero(spikes(moved, strain)).tolist() == places


def test_an_uncertain_strain_may_differ_more():
    moved, strain = press()
    strain[15] += 9
    sigma = np.zeros(40)
    assert spikes(moved, strain, sigma)[15]
    sigma[15] = 2.0
    assert not spikes(moved, strain, sigma)[15]


def test_two_measurements_are_not_judged():
    assert not spikes([0.0, 1.0], [0.0, 90.0]).any()
