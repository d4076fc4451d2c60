"""Pairing by time, and the cameras' clocks, on plain numbers."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactune.core.sources.cameras.assembler import SETTLING, Pairer, StreamClock, Timed

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


lateness = st.lists(st.floats(0, 0.5), min_size=40, max_size=80)


def arrivals(stamps: list[float], late: list[float]) -> list[float]:
    return list(itertools.accumulate((stamp + wait for stamp, wait in zip(stamps, late, strict=False)), max))


@given(late=lateness, lost=st.sets(st.integers(1, 79)), jitter=st.lists(st.floats(-0.2, 0.2), min_size=80, max_size=80))
def test_stamps_on_the_computers_clock_are_taken_as_they_are_however_late_images_are(late, lost, jitter):
    clock = StreamClock(PERIOD_S)
    numbers = [number for number in range(len(late)) if number not in lost]
    stamps = [START_S + (number + jitter[number]) * PERIOD_S for number in numbers]
    for number, stamp, arrival in zip(numbers, stamps, arrivals(stamps, late), strict=True):
        assert clock.place(number, stamp, arrival, on_host_clock=True) == stamp
        assert not clock.settling


@given(
    jump=st.floats(0.7, 60.0).flatmap(lambda periods: st.sampled_from([periods, -periods])),
    late=st.lists(st.floats(0, 0.004), min_size=200, max_size=200),
    at=st.integers(1, 60),
)
def test_after_a_jump_images_are_placed_where_they_were_taken(jump, late, at):
    clock = StreamClock(PERIOD_S)
    truths = [START_S + number * PERIOD_S for number in range(200)]
    for number, (truth, arrival) in enumerate(zip(truths, arrivals(truths, late), strict=True)):
        stamp = truth + (jump * PERIOD_S if at <= number < 120 else 0.0)
        placed = clock.place(number, stamp, arrival + 0.03, on_host_clock=True)
        assert abs(placed - truth) < 0.25 * PERIOD_S
        if number == at:
            assert clock.settling
            assert clock.jumped_by_s == pytest.approx(jump * PERIOD_S, abs=0.005)
        if number >= 120 + SETTLING:  # jumped back
            assert placed == stamp


def test_a_camera_that_pauses_has_not_jumped():
    clock = StreamClock(PERIOD_S)
    for number, pause_s in enumerate([0.0] * 20 + [1.0] * 20):
        stamp = START_S + number * PERIOD_S + pause_s
        assert clock.place(number, stamp, stamp + 0.03, on_host_clock=True) == stamp
        assert not clock.settling


def test_a_clock_of_its_own_is_followed_by_the_arrivals_even_if_it_drifts():
    clock = StreamClock(PERIOD_S)
    for number in range(3000):
        truth = START_S + number * PERIOD_S
        placed = clock.place(number, 5.0 + number * PERIOD_S * 1.0005, truth + 0.03, on_host_clock=False)
        assert placed - truth == pytest.approx(0.03, abs=0.002)
    assert not clock.is_shared
    assert clock.usual_delay_s == 0.0
    misled = StreamClock(PERIOD_S)
    misled.place(0, 5.0, START_S, on_host_clock=True)  # the driver says so, but the stamps do not bear it out
    assert not misled.is_shared
