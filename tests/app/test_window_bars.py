"""The status bar, the numbers of a frame, and the field of its number."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest

from fakes import tiny_frame, tiny_rig
from small_recordings import NoisyPress, small_rig
from tactune.app.window.status import FrameStatus, patch_readings
from tactune.app.window.toolbar import FrameNumber
from tactune.app.worker.playback import PlaybackState
from tactune.app.worker.processing import FrameProcessor
from tactune.app.worker.results import SourceInfo, SourceState, Wanted
from tactune.core.model.patch import Doubt
from tactune.core.preset import Preset

TIMES = {"average": 2.0, "fusion": 2.5, "equilibrium": 6.6, "edge": 0.4, "clusters": 0.8, "points": 0.5}


@pytest.fixture(scope="module")
def result():
    info = SourceInfo("tiny", tiny_rig(), 1, 30.0)
    return FrameProcessor().process(info, tiny_frame(3, info.rig), Preset(), Wanted(), PlaybackState())


@pytest.fixture
def bar(qtbot):
    made = FrameStatus()
    qtbot.addWidget(made)
    qtbot.addWidget(made.details)
    made.show()
    return made


def give(bar, result, times=TIMES, **changes):
    patch = SimpleNamespace(points=result.patch.points, averaged_frames=1, stage_ms=times)
    bar.show_result(replace(result, patch=patch, **changes))


def test_the_numbers_say_how_sure_the_patch_is_and_why(bar, result):
    doubtful = replace(result, area_mm2=300.0, doubt=Doubt(0.609, 2.34, ("no dent",)))
    values = [reading.value for reading in patch_readings(doubtful, 30.0)]
    assert values[:3] == ["300 mm²", "60 %", "±2.3 mm"]
    give(bar, doubtful)
    assert "Doubt: no dent" in bar.details.text()


def test_the_details_name_the_times_of_the_stages_that_took_time(bar, result):
    give(bar, result, {"fusion": 1.5, "outliers": 0.4, "clusters": 0.0}, dropped=3, unmatched=5)
    said = bar.details.text().splitlines()
    assert "Stages: fusion 1.5 + outliers 0.4 = 1.9 ms" in said
    assert {"Dropped: 3, unmatched: 5", "Skew, tactile minus proximity: 2.0 ms"} < set(said)


def test_the_state_is_said_in_a_word_or_two(bar):
    said = []
    for state in (
        PlaybackState(length=8, playing=True),
        PlaybackState(length=8),
        PlaybackState(playing=True),
    ):
        bar.show_playback(state)
        said.append(bar.state.text())
    assert said == ["Playing", "Paused", "Live"]
    bar.show_recording(True)
    bar.show_state(SourceState(stale=True))
    assert bar.state.text() == "Recording, no frames"


def test_enter_goes_to_the_typed_frame_and_escape_brings_the_shown_one_back(qtbot):
    number, sought = FrameNumber(), []
    number.valueChanged.connect(sought.append)
    qtbot.addWidget(number)
    number.show_frame(3, 8)
    number.show()
    number.activateWindow()  # the window of the module may be open
    qtbot.waitUntil(number.isActiveWindow)
    for typed, key, shown in (("5", Qt.Key.Key_Return, 5), ("2", Qt.Key.Key_Escape, 5), ("7", Qt.Key.Key_Return, 7)):
        number.setFocus()
        number.selectAll()
        QTest.keyClicks(number, typed)
        number.show_frame(5, 8)  # played on while somebody types
        assert number.text().startswith(typed)
        QTest.keyClick(number, key)
        assert number.text() == f"{shown} of 8" and not number.hasFocus()
    assert sought == [5, 7]


def test_a_first_contact_is_judged_at_once_while_frames_play():
    processor, rig = FrameProcessor(), small_rig(64)
    press = NoisyPress(0, rig, 3, with_truth=False)
    info = SourceInfo("press", rig, 3, 30.0)
    contact = press.next_frame()
    nothing = replace(contact, proximity_depth=np.zeros_like(contact.proximity_depth))
    playing = PlaybackState(length=3, playing=True)
    preset = Preset(contact_test="tolerance")
    judged = [processor.process(info, frame, preset, Wanted(), playing).doubt for frame in (nothing, contact, contact)]
    at_rest = processor.process(info, contact, preset, Wanted(), PlaybackState()).doubt
    first, second, third = (doubt.touch_probability for doubt in judged)
    assert first == 0.0 < second == third == at_rest.touch_probability
