"""The closed loop that levels a tray by the angle of the contact patch."""

from __future__ import annotations

import numpy as np
import pytest

from tactune.core.errors import SourceError
from tactune.core.estimation.balance import BalanceLoop, summarise
from tactune.core.sources.presets import load_preset
from tactune.core.sources.simulator.source import SimulatorSource
from tactune.core.sources.simulator.tray import BOOKS, Tray


@pytest.fixture(scope="module")
def tray():
    return SimulatorSource("tray")


def run(source, seconds, **options):
    loop = BalanceLoop(source, load_preset("simulator"), **options)
    return [loop.step() for _ in range(round(seconds * source.frame_rate_hz))]


def test_books_are_levelled_by_the_patch(tray):
    steps = run(tray, 12.0)
    summary = summarise(steps)
    assert summary.frames == 360 and len(summary.settle_s) == len(BOOKS) == 3
    assert all(settle is not None and 0.0 < settle < 1.5 for settle in summary.settle_s)
    assert summary.patch.rms_deg < 0.6 and summary.patch.missing == 0
    assert max(abs(np.degrees(step.roll_rad)) for step in steps) > 2.0  # the books do roll the tray
    assert abs(np.degrees(steps[-1].sensor_rad)) > 2.0  # the sensor has turned below it
    assert summary.rms_factor == pytest.approx(summary.proximity.rms_deg / summary.patch.rms_deg)
    for step in steps[::60]:
        assert step.measured_rad == pytest.approx(step.patch.roll_rad + step.sensor_rad)
        assert step.true_rad == pytest.approx(step.roll_rad - step.sensor_rad)


def test_the_proximity_camera_alone_can_control(tray):
    steps = run(tray, 0.1, method="proximity")
    assert summarise(steps).settle_s == []  # no book yet
    step = steps[-1]
    assert step.measured_rad == pytest.approx(step.proximity.roll_rad + step.sensor_rad)
    assert step.measured_rad != pytest.approx(step.patch.roll_rad + step.sensor_rad)


def test_the_actuator_is_late_and_has_a_largest_rate(tray):
    level = Tray(tray.solved_facts(), books=())
    level.command(np.radians(1000.0))
    level.advance(0.045)
    assert level.sensor_rad == 0.0
    level.advance(0.25)
    assert np.degrees(level.sensor_rad) == pytest.approx(4.0, abs=0.1)
    assert level.roll_rad == pytest.approx(level.sensor_rad, abs=np.radians(0.5))  # the membrane takes the tray along


def test_other_scenes_are_refused():
    with pytest.raises(SourceError, match="no tray to balance; open sim:tray"):
        BalanceLoop(SimulatorSource("tray").with_object_away(), load_preset("simulator"))
