"""The drift watchdog: what it finds, what it leaves alone, and when it takes a warning back."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from drifted import Drift
from drifting import AVERAGED, drifted, untouched
from tactune.core.errors import CalibrationError, FrameError
from tactune.core.model.frames import SensorFrame
from tactune.core.preset import Preset
from tactune.core.rig.watch import INTERVAL_S, Watchdog, WatchReport
from tactune.core.sources.presets import load_preset
from tactune.core.sources.registry import open_source

LATER = range(AVERAGED, AVERAGED + 8)


@cache
def at_rest(index: int) -> SensorFrame:
    return drifted().read(index)


@pytest.fixture(scope="module")
def reference() -> SensorFrame:
    return untouched()


@pytest.fixture
def watchdog(reference: SensorFrame) -> Watchdog:
    return Watchdog(load_preset("simulator"), drifted().rig, reference)


def reports(watchdog: Watchdog, frames: Iterable[SensorFrame], start: int = 0) -> list[tuple[int, WatchReport]]:
    """Return the reports with the number of the look that made each."""
    looks = ((look, watchdog.look(frame, (start + look) * INTERVAL_S)) for look, frame in enumerate(frames, 1))
    return [(look, report) for look, report in looks if report is not None]


@pytest.mark.parametrize(
    ("drift", "subject", "value", "said"),
    [
        (Drift("tactile", (0.0005, 0, 0)), "tactile", 0.0005, "The tactile camera has moved by 0.5 mm"),
        (Drift("tactile", (0, 0, 0.005)), "tactile", 0.005, "The tactile camera has moved by 5."),
        (Drift("proximity", (0, 0.001, 0)), "proximity", 0.001, "The proximity camera has moved by 1.0 mm"),
        (Drift("tactile", turn_deg=(0, 5, 0)), "tactile", 0.010, "The tactile camera has moved by 10 mm or more"),
        (Drift(apex_m=-0.0019), "pressure", -0.0018, "The pressure has fallen: the membrane's apex stands"),
        (Drift(apex_m=0.0076), "pressure", 0.0070, "The pressure has risen: the membrane's apex stands"),
        (Drift("tactile", blur_px=1.0), "tactile_lens", 0.14, "The lens of the tactile camera is dirty"),
        (Drift("tactile", smear=0.3), "tactile_lens", 0.16, "The lens of the tactile camera is dirty"),
        (Drift("proximity", blur_px=2.0), "proximity_lens", 0.9, "The lens of the proximity camera is dirty"),
    ],
)
def test_a_change_is_told_once_with_its_size_and_taken_back(
    watchdog: Watchdog, drift: Drift, subject: str, value: float, said: str
) -> None:
    after = drifted(drift)
    assert not reports(watchdog, map(at_rest, LATER[:3]))
    [(look, report)] = reports(watchdog, map(after.read, LATER[:5]), 3)
    assert 2 <= look <= 3
    assert (report.subject, report.state) == (subject, "told")
    assert report.value == pytest.approx(value, rel=0.2)
    assert report.sentence.startswith(said)
    assert watchdog.told == [subject]
    [(_, back)] = reports(watchdog, map(at_rest, LATER), 8)
    assert (back.subject, back.state) == (subject, "withdrawn")
    assert watchdog.told == []


def test_one_percent_of_pressure_is_told_within_four_minutes(watchdog: Watchdog) -> None:
    after = drifted(Drift(apex_m=-0.00038))
    [(look, report)] = reports(watchdog, (after.read(AVERAGED + look % 15) for look in range(24)))
    assert (report.subject, report.state) == ("pressure", "told") and look > 3
    assert report.value == pytest.approx(-0.0004, abs=0.00015)


def test_a_single_odd_frame_is_not_told(watchdog: Watchdog) -> None:
    frames = [at_rest(index) for index in LATER]
    frames[6] = drifted(Drift("tactile", (0.005, 0, 0))).read(21)
    assert reports(watchdog, frames) == []


def test_ordinary_use_raises_no_alarm(watchdog: Watchdog) -> None:
    """Presses, releases, and an object that hovers, with the light dimmed for a while."""
    bright, dim = open_source("sim:cup"), open_source("sim:cup?light=dim")
    order = np.random.default_rng(3).integers(bright.length, size=30)
    frames = ((dim if 10 <= look < 20 else bright).read(int(index)) for look, index in enumerate(order))
    assert reports(watchdog, frames) == []


def test_a_camera_that_moves_while_the_object_presses_is_found_by_both_colour_images(reference: SensorFrame) -> None:
    watchdog = Watchdog(load_preset("simulator"), drifted().rig, reference)
    pressed = drifted(Drift("tactile", (0.002, 0, 0)), "medium")
    assert not reports(watchdog, map(drifted(press="medium").read, range(15)))
    [(_, report)] = reports(watchdog, (pressed.read(index) for index in range(15)), 15)
    assert report.subject == "alignment"
    assert report.value == pytest.approx(0.002, rel=0.2)


def test_a_look_is_due_every_ten_seconds_and_after_the_clock_was_set_back(watchdog: Watchdog) -> None:
    assert watchdog.due(100.0)
    watchdog.look(drifted().read(20), 100.0)
    assert not watchdog.due(109.9)
    assert watchdog.due(110.0)
    assert watchdog.due(0.0)


def test_without_anything_to_compare_with_it_says_what_to_do(reference: SensorFrame) -> None:
    with pytest.raises(CalibrationError, match="capture an untouched frame, or calibrate"):
        Watchdog(Preset(), drifted().rig, None)


def test_frames_of_another_rig_are_refused(watchdog: Watchdog) -> None:
    frame = drifted().read(20)
    small = replace(frame, tactile_depth=frame.tactile_depth[::2, ::2].copy(), tactile_color=None)
    with pytest.raises(FrameError):
        watchdog.look(small, 0.0)
