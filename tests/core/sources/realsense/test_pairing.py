"""Pairing by time, and the cameras' clocks, on plain numbers."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactune.core.sources.cameras.camera import Image
from tactune.core.sources.cameras.pairing import ODD_STAMPS, Assembler, Pairer, Timed

PERIOD_S = 1 / 30
START_S = 1.7e9

phases = st.floats(-0.5, 0.5).map(lambda share: share * PERIOD_S)
jitters = st.lists(st.floats(-0.02, 0.02), min_size=2, max_size=40)


def play(first: list[float], second: list[float], delays: list[float], patience_s: float = 1.0) -> list[tuple]:
    """Let images arrive at their times plus a delay each; return the pairs' times and those who found nobody."""
    pairer: Pairer[float, float] = Pairer(PERIOD_S, patience_s)
    waits = itertools.cycle(delays)
    arrivals = []
    for stream, add in ((first, pairer.add_first), (second, pairer.add_second)):
        latest = 0.0
        for time_s in stream:
            latest = max(latest, time_s + next(waits))  # a stream arrives in order
            arrivals.append((latest, time_s, add))
    found = []
    for arrival_s, time_s, add in sorted(arrivals, key=lambda each: each[0]):
        add(Timed(time_s, arrival_s, time_s))
        found += pairer.take(arrival_s)
    end_s = max(arrival for arrival, _, _ in arrivals) + 2 * patience_s
    found += pairer.take(end_s)
    assert 2 * len(found) + pairer.unmatched == len(first) + len(second)
    return [(one.item, other.item) for one, other in found]


def nearest(time_s: float, stream: list[float]) -> float:
    return min(stream, key=lambda each: abs(each - time_s))


@given(phase_s=phases, first=jitters, second=jitters, delays=st.lists(st.floats(0, 0.01), min_size=1, max_size=5))
def test_partners_are_near_and_in_order(phase_s, first, second, delays):
    ones = [START_S + (index + 10 * share) * PERIOD_S for index, share in enumerate(first)]
    others = [START_S + phase_s + (index + 10 * share) * PERIOD_S for index, share in enumerate(second)]
    pairs = play(ones, others, delays)
    assert pairs == sorted(pairs)
    assert len({other for _, other in pairs}) == len(pairs)
    assert all(abs(one - other) <= 0.5001 * PERIOD_S for one, other in pairs)


@given(
    phase=st.floats(-0.45, 0.45),
    first=jitters,
    second=jitters,
    delays=st.lists(st.floats(0, 0.01), min_size=1, max_size=5),
)
def test_everybody_gets_the_nearest(phase, first, second, delays):
    ones = [START_S + (index + share) * PERIOD_S for index, share in enumerate(first)]
    others = [START_S + (index + phase + share) * PERIOD_S for index, share in enumerate(second)]
    pairs = play(ones, others, delays)
    near = [(one, other) for one in ones for other in others if abs(one - other) <= 0.5 * PERIOD_S]
    assert pairs == [
        (one, other) for one, other in near if nearest(one, others) == other and nearest(other, ones) == one
    ]


@given(
    kept=st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=60),
    skew=st.floats(-0.24, 0.24),
    delays=st.lists(st.floats(0, 0.9), min_size=1, max_size=7),
)
def test_whatever_was_lost_the_rest_is_paired_rightly_and_completely(kept, skew, delays):
    """Also while one camera delivers late: the other's images wait for it."""
    ones = [START_S + index * PERIOD_S for index, (one, _) in enumerate(kept) if one]
    others = [START_S + (index + skew) * PERIOD_S for index, (_, other) in enumerate(kept) if other]
    if not ones or not others:
        return
    pairs = play(ones, others, delays)
    assert pairs == [
        (START_S + index * PERIOD_S, START_S + (index + skew) * PERIOD_S)
        for index, (one, other) in enumerate(kept)
        if one and other
    ]


def test_an_image_of_an_optional_stream_is_not_waited_for_long():
    pairer: Pairer[str, str] = Pairer(PERIOD_S, patience_s=0.2, second_is_optional=True)
    pairer.add_first(Timed(START_S, START_S, "depth"))
    assert pairer.take(START_S + 0.1) == []
    ((depth, color),) = pairer.take(START_S + 0.3)
    assert (depth.item, color, pairer.unmatched) == ("depth", None, 0)


def paired(stamps: list[tuple[float, float]], *, on_host_clock: bool = True) -> tuple[list[tuple[float, float]], int]:
    """Give depth images of both cameras with these stamps to an assembler; they arrive 30 ms after their moment.

    Return the times of the pairs, and how often images were said to be timed by their arrival.
    """
    assembler = Assembler(PERIOD_S, 0.0, ("proximity", "tactile"))
    times, told = [], 0
    for number, pair in enumerate(stamps):
        arrival_s = START_S + number * PERIOD_S + 0.03
        for role, stamp_s in zip(("proximity", "tactile"), pair, strict=True):
            image = Image("depth", number, np.zeros((1, 1), np.uint16), stamp_s, on_host_clock or role == "proximity")
            told += assembler.add(role, image, arrival_s)
        while (found := assembler.take()) is not None:
            times.append((found.proximity_time_s, found.tactile_time_s))
    return times, told


def test_stamps_on_the_computers_clock_are_taken_as_they_are():
    stamps = [(START_S + n * PERIOD_S, START_S + n * PERIOD_S + 0.002) for n in range(20)]
    assert paired(stamps) == (stamps, 0)


def test_a_camera_with_a_clock_of_its_own_lets_both_count_by_arrival():
    times, told = paired([(START_S + n * PERIOD_S, 5.0 + n * PERIOD_S) for n in range(20)], on_host_clock=False)
    assert (len(times) >= 19, told) == (True, 1)
    assert all(one == other for one, other in times)


@pytest.mark.parametrize("jump_s", [7.0, -7.0])
def test_a_clock_that_jumps_counts_no_more(jump_s):
    moments = [START_S + n * PERIOD_S for n in range(200)]
    times, told = paired([(each, each + (jump_s if n >= 50 else 0.0)) for n, each in enumerate(moments)])
    assert told == 1
    assert len(times) >= 200 - ODD_STAMPS - 2
    assert all(abs(one - other) < PERIOD_S / 2 for one, other in times)
    assert times == sorted(times)
