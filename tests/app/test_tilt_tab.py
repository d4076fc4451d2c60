"""The Tilt tab: angles of the shown frame, and over time."""

import math

import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest

from hands import show_source
from small_recordings import small_rig
from tactune.core.sources.registry import open_source


def opened(qtbot, window, source=None, index=3):
    """Show a frame in the tab, opened by its key."""
    show_source(qtbot, window, source or open_source("sim:cup?press=medium"), index)
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow)
    QTest.keyClick(window, Qt.Key.Key_F8, Qt.KeyboardModifier.ShiftModifier)
    analysis = window.analysis.window
    qtbot.waitExposed(analysis)
    tab = analysis.made["tilt"]
    qtbot.waitUntil(lambda: tab.shown is not None and tab.shown[0].frame.sequence == index)
    return tab


def go_to(qtbot, window, tab, index):
    window.worker.seek(index)
    qtbot.waitUntil(lambda: tab.shown is not None and tab.shown[0].frame.sequence == index)


def test_shows_the_angles(qtbot, window):
    tab = opened(qtbot, window)
    alone = tab.shown[1]
    assert f"{math.degrees(alone.roll_sigma_rad):.2f}" in tab.roll.text()
    assert abs(alone.roll_rad) < 0.2 and 0 < alone.roll_sigma_rad < 0.05
    assert [name for name, _ in tab.cloud.legend.entries] == ["patch", "fitted plane"]
    assert "noise" in tab.status.text()  # that of the rig was not measured


def test_a_preset_that_does_not_fit_leaves_no_angles_of_another_frame(qtbot, window):
    tab = opened(qtbot, window)
    assert tab.roll.text()
    assert window.document.edit("rig", small_rig(64).model_dump(mode="json"))
    qtbot.waitUntil(lambda: window.result.patch is None)
    qtbot.waitUntil(lambda: tab.shown is None)
    assert (tab.roll.text(), tab.axis.text()) == ("", "")
    assert tab.cloud.notice.text() == tab.status.text() == window.result.problem != ""


def test_the_angles_are_drawn_over_time(qtbot, window):
    tab = opened(qtbot, window)
    first = tab.shown[1]
    go_to(qtbot, window, tab, 4)
    times, roll = next(it for it in tab.plot.getPlotItem().listDataItems() if it.name() == "roll").getData()
    assert len(times) == 2 and times[0] < times[1]
    assert roll[0] == pytest.approx(math.degrees(first.roll_rad))
