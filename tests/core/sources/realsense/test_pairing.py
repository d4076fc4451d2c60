"""Pairing by time, on plain numbers."""

import itertools

from hypothesis import given
from hypothesis import strategies as st

from tactune.core.sources.cameras.pairing import Pairer, Timed

PERIOD_S = 1 / 30
START_S = 1.7e9

phases = st.floats(-0.5, 0.5).map(lambda share: share * PERIOD_S)
jitters = st.lists(st.floats(-0.02, 0.02), min_size=2, max_size=40)


def play(first, second, delays, patience_s=1.0):
    """Let images arrive at their times plus a delay each; return the pairs' times and those who found nobody."""
    pairer = Pairer(PERIOD_S, patience_s)
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


def nearest(time_s, stream):
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
