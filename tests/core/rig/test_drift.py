"""Drift since the untouched frame: what is found, what is left alone, and when a warning is withdrawn."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from drifting import AVERAGED, Drift, drifted, untouched
from rigs import one_place_rig
from tactune.core.calibration.check import Drift as AlignmentDrift
from tactune.core.calibration.snapshots import take_snapshot
from tactune.core.errors import CalibrationError, FrameError
from tactune.core.model.frames import Rig, SensorFrame, Shot
from tactune.core.preset import Preset
from tactune.core.rig.drift import INTERVAL_S, RigCheck, Watch, compare_with_untouched
from tactune.core.sources.presets import load_preset
from tactune.core.sources.registry import open_source

PRESET = load_preset("simulator")
LATER = range(AVERAGED, AVERAGED + 8)


@cache
def at_rest(index):
    return drifted().read(index)


@pytest.fixture
def watch():
    return Watch(PRESET, drifted().rig, untouched())


def reports(watch, frames, start=0):
    """Return the reports with the number of the look that made each."""
    looks = ((look, watch.look(frame, (start + look) * INTERVAL_S)) for look, frame in enumerate(frames, 1))
    return [(look, report) for look, report in looks if report is not None]


@pytest.mark.parametrize(
    ("drift", "verdict", "what", "value_m", "said"),
    [
        (Drift(), "fine", "tactile", 0.0, "as in the untouched frame"),
        (Drift("tactile", (0.0006, 0, 0)), "camera", "tactile", 0.0006, "moved by 0.6 mm right in its image"),
        (Drift("proximity", (0, 0.001, 0)), "camera", "proximity", 0.001, "mm down in its image"),
        (Drift(apex_m=0.0076), "inflation", "inflation", 0.0070, "farther out"),
    ],
)
def test_a_change_is_found_with_its_size(drift, verdict, what, value_m, said):
    now = take_snapshot([drifted(drift).read(index) for index in LATER[:5]]).frame
    found = compare_with_untouched(PRESET, drifted().rig, now, untouched())
    assert found.verdict == verdict
    value = found.inflation_m if what == "inflation" else found.moved_m[what]
    assert value == pytest.approx(value_m, rel=0.25, abs=0.0002)
    assert said in found.sentence


def test_an_inflation_that_changed_is_no_touch_where_most_of_the_image_is_a_rim():
    rig = Rig.of_one_camera(one_place_rig(128, 96, 90.0).tactile)
    v, u = np.mgrid[:96, :128]
    bulge = np.sqrt(np.maximum(1 - ((v - 48) ** 2 + (u - 64) ** 2) / 26**2, 0))
    now, before = (
        SensorFrame.of_shots(rig, 0, None, Shot((1300 + 10 * apex_mm * bulge + noise).astype(np.uint16), None, 0.0))
        for apex_mm, noise in zip((40, 30), np.random.default_rng(0).normal(0, 1, (2, 96, 128)), strict=True)
    )
    found = compare_with_untouched(Preset(), rig, now, before)
    assert found.verdict == "inflation"
    assert found.inflation_m == pytest.approx(0.010, rel=0.1)


def test_a_dent_is_a_touch_and_no_drift():
    now = take_snapshot([drifted(press="medium").read(index) for index in range(5)]).frame
    found = compare_with_untouched(PRESET, drifted().rig, now, untouched())
    assert found.verdict == "touched"
    aligned = AlignmentDrift(0.1, False, "", np.zeros((1, 2)), np.zeros((1, 2)))
    assert RigCheck(aligned, found).state == RigCheck("no colour", found).state == "unknown"
    assert "remove it" in found.sentence


def test_a_change_is_told_once_and_withdrawn(watch):
    after = drifted(Drift(apex_m=0.0076))
    assert not reports(watch, map(at_rest, LATER[:3]))
    [(look, report)] = reports(watch, map(after.read, LATER[:5]), 3)
    assert look == 3
    assert (report.verdict, report.state) == (watch.told, "told")
    [(_, back)] = reports(watch, map(at_rest, LATER), 8)
    assert (back.verdict, back.state) == (report.verdict, "withdrawn")
    assert watch.told == "fine"


def test_a_single_odd_frame_is_not_told(watch):
    frames = [at_rest(index) for index in LATER]
    frames[6] = drifted(Drift("tactile", (0.005, 0, 0))).read(21)
    assert reports(watch, frames) == []


def test_ordinary_use_raises_no_alarm(watch):
    """Presses, releases, and an object that hovers, with the light dimmed for a while."""
    source = open_source("sim:cup")
    order = np.random.default_rng(3).integers(source.length, size=8)
    frames = [source.read(int(index)) for index in order]
    frames[3:6] = [replace(frame, tactile_color=frame.tactile_color // 2) for frame in frames[3:6]]
    assert reports(watch, frames) == []


def test_what_cannot_be_compared_is_refused(watch):
    with pytest.raises(CalibrationError, match="untouched frame"):
        Watch(Preset(), drifted().rig, None)
    frame = drifted().read(20)
    small = replace(frame, tactile_depth=frame.tactile_depth[::2, ::2].copy(), tactile_color=None)
    with pytest.raises(FrameError):
        watch.look(small, 0.0)
    blind = replace(frame, tactile_depth=np.zeros_like(frame.tactile_depth))
    with pytest.raises(CalibrationError, match="tactile camera"):
        compare_with_untouched(PRESET, drifted().rig, blind, untouched())
