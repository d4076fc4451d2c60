"""Assignment of devices to roles, and pairing by time, on plain numbers."""

import itertools
from unittest.mock import Mock

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tactune.core import errors
from tactune.core.errors import MissingExtraError, SourceError
from tactune.core.preset import CameraSection, CamerasSection
from tactune.core.sources.cameras import realsense as driver
from tactune.core.sources.cameras.camera import DeviceInfo
from tactune.core.sources.cameras.drivers import choose
from tactune.core.sources.cameras.pairing import Pairer, Timed

L515, L515_TOO = DeviceInfo("L515", "f1", "proximity"), DeviceInfo("L515", "f2", "proximity")
D405, D405_TOO = DeviceInfo("D405", "d1", "tactile"), DeviceInfo("D405", "d2", "tactile")
D435 = DeviceInfo("D435I", "d3")


def named(proximity="", tactile=""):
    return CamerasSection(proximity=CameraSection(serial=proximity), tactile=CameraSection(serial=tactile))


@pytest.mark.parametrize(
    ("connected", "cameras", "expected"),
    [
        ([D405, L515], named(), (L515, D405)),
        ([D435, L515, D405], named(), (L515, D405)),
        ([D435, L515, D405], named(tactile="d3"), (L515, D435)),
        ([L515, L515_TOO, D405, D405_TOO], named("f2", "d1"), (L515_TOO, D405)),
        ([D405, D405_TOO], named("d1", "d2"), (D405, D405_TOO)),
        ([D405, D435, L515], named("d1", "d3"), (D405, D435)),
        ([L515, L515_TOO, D405], named(tactile="f1"), (L515_TOO, L515)),
    ],
)
def test_cameras_are_found_by_serial_or_by_model(connected, cameras, expected):
    chosen = choose(connected, cameras)
    assert (chosen["proximity"], chosen["tactile"]) == expected


@pytest.mark.parametrize(
    ("connected", "cameras", "words"),
    [
        ([], named(), "finds no camera; plug both"),
        ([L515], named(), r"a tactile camera is not connected, only L515 \(serial f1\); plug a D405"),
        ([D405], named(), r"a proximity camera is not connected, only D405 \(serial d1\); plug an L515"),
        ([D435, L515], named(), r"a tactile camera is not connected, only D435I .*or name both serials"),
        ([L515, D405, D405_TOO], named(), r"D405 \(serial d1\) and D405 \(serial d2\) may each be the tactile camera"),
        ([L515, D405], named("f9"), r"proximity camera with the serial f9 is not connected, only L515 .*d1\); plug it"),
        ([L515, D405], named("f1", "f1"), "both cameras have the serial f1"),
    ],
)
def test_what_is_missing_or_open_is_said_with_the_remedy(connected, cameras, words):
    with pytest.raises(SourceError, match=f"^cameras: .*{words}"):
        choose(connected, cameras)


@pytest.mark.parametrize("connected", [[], [D405]])
def test_a_driver_without_the_l515_is_blamed_and_the_right_one_named(connected, monkeypatch):
    monkeypatch.setattr(driver, "driver_version", lambda: "2.59.1.11053")
    hint = driver.RealSenseDriver().hint()
    with pytest.raises(SourceError, match=r"2\.59\.1\.11053 no longer supports the L515.*pyrealsense2==2\.54\.2"):
        choose(connected, named(), hint)


def test_which_drivers_know_the_l515():
    versions = ("2.50.0", "2.54.2.5684", "2.55.1", "2.59.1.11053")
    assert [bool(driver.no_l515_sentence(version)) for version in versions] == [False, False, True, True]


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (ModuleNotFoundError("No module named 'pyrealsense2'"), "needs pyrealsense2 .*: pip install"),
        (ImportError("undefined symbol: x\n"), "symbol: x.* system library .*pip install --force-reinstall"),
    ],
)
def test_a_driver_that_cannot_be_loaded_is_one_sentence(error, words, monkeypatch):
    monkeypatch.setattr(errors, "import_module", Mock(side_effect=error))
    with pytest.raises(MissingExtraError, match=rf"{words} 'tactune\[realsense\]'$"):
        driver.load_driver()


PERIOD_S = 1 / 30
START_S = 1.7e9


jitters = st.lists(st.floats(-0.02, 0.02), min_size=2, max_size=40)


def play(first, second, delays, patience_s=1.0):
    """Let images arrive at their times plus a delay each; return the pairs' times and those who found nobody."""
    pairer = Pairer(PERIOD_S, patience_s)
    waits = itertools.cycle(delays)
    arrivals = []
    for stream, is_second in ((first, False), (second, True)):
        latest = 0.0
        for time_s in stream:
            latest = max(latest, time_s + next(waits))  # a stream arrives in order
            arrivals.append((latest, time_s, is_second))
    found = []
    for arrival_s, time_s, is_second in sorted(arrivals, key=lambda each: each[0]):
        pairer.add(Timed(time_s, arrival_s, time_s), second=is_second)
        found += pairer.take(arrival_s)
    end_s = max(arrival for arrival, _, _ in arrivals) + 2 * patience_s
    found += pairer.take(end_s)
    assert 2 * len(found) + pairer.unmatched == len(first) + len(second)
    return [(one.item, other.item) for one, other in found]


def nearest(time_s, stream):
    return min(stream, key=lambda each: abs(each - time_s))


@given(
    phase=st.floats(-0.45, 0.45),
    first=jitters,
    second=jitters,
    delays=st.lists(st.floats(0, 0.01), min_size=1, max_size=5),
)
@example(phase=0.45, first=[0.0, -0.3], second=[0.0], delays=[0.0])  # the nearer one comes later
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
