"""Toolbar and status bar are readable at every width of the window."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QLabel

from fakes import tiny_frame, tiny_rig
from tactune.app.window.status import FrameStatus
from tactune.app.window.toolbar import FrameNumber
from tactune.app.worker.playback import PlaybackState
from tactune.app.worker.processing import FrameProcessor
from tactune.app.worker.results import SourceInfo, SourceState, Wanted
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


def test_the_panel_names_the_times_of_the_stages_that_took_time(bar, result):
    QTest.keyClick(bar.state, Qt.Key.Key_Space)
    give(bar, result, {"fusion": 1.5, "outliers": 0.4, "clusters": 0.0}, dropped=3, unmatched=5)
    said = bar.details.label.text().splitlines()
    assert "Stages: fusion 1.5 + outliers 0.4 = 1.9 ms" in said
    assert {"Dropped: 3", "Unmatched: 5", "Skew, tactile minus proximity: 2.0 ms"} < set(said)


def test_the_state_is_said_in_a_word_or_two(bar):
    said = []
    for state in (
        PlaybackState(length=8, playing=True),
        PlaybackState(length=8),
        PlaybackState(playing=True),
        PlaybackState(playing=True, frozen=True),
    ):
        bar.show_playback(state)
        said.append(bar.state.text())
    assert said == ["Playing", "Paused", "Live", "Frozen"]
    bar.show_recording(True)
    bar.show_state(SourceState(stale=True))
    assert bar.state.text() == "Recording, no frames"


def test_no_number_is_cut_off(bar, result):
    bar.resize(900, 24)
    bar.show_findings(12)
    bar.show_recording(True)
    bar.show_playback(PlaybackState(length=8, playing=True))
    give(bar, result, playback=PlaybackState(length=8, playing=True), area_mm2=123456)
    bar.layout().activate()
    for label in bar.findChildren(QLabel):
        if label.text() and type(label) is QLabel:
            assert label.width() >= label.fontMetrics().horizontalAdvance(label.text())
            assert label.geometry().right() < bar.width()
    for button in (bar.state, bar.findings):
        assert button.width() >= button.sizeHint().width()


def test_a_change_of_playback_that_a_picture_has_overtaken_keeps_the_number_of_the_picture(window):
    """A result replaces an older one whose signal is on its way, and so arrives before what was said in between."""
    transport, late = window.transport, replace(window.transport.state, index=5)
    window.worker.playbackChanged.emit(late)
    assert transport.state.index == transport.slider.value() == window.result.playback.index == 3
    window.worker.playbackChanged.emit(replace(late, loop=not late.loop))
    assert transport.state.loop != late.loop


@pytest.fixture
def number(qtbot):
    made = FrameNumber()
    qtbot.addWidget(made)
    made.show()
    qtbot.waitExposed(made)
    made.show_frame(3, 8)
    made.setFocus()
    made.selectAll()
    return made


def test_enter_goes_to_the_typed_frame_also_to_the_one_before_the_newest(number):
    sought = []
    number.sought.connect(sought.append)
    number.show_frame(6, 8)  # played on while somebody types
    QTest.keyClicks(number, "4")
    QTest.keyClick(number, Qt.Key.Key_Return)
    assert sought == [3]
    number.selectAll()
    QTest.keyClicks(number, "7")
    QTest.keyClick(number, Qt.Key.Key_Return)
    assert sought == [3, 6]


def test_escape_brings_the_shown_frame_back_and_goes_nowhere(number):
    sought = []
    number.sought.connect(sought.append)
    QTest.keyClicks(number, "2")
    number.show_frame(5, 8)
    assert number.text() == "frame 2 of 8"
    QTest.keyClick(number, Qt.Key.Key_Escape)
    assert number.text() == "frame 6 of 8" and not number.hasFocus()
    number.show_frame(0, None)
    assert number.text() == "frame 1" and sought == []
