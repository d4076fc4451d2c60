"""The part *Balance* of the Tilt tab: a simulated tray that a controller levels."""

from __future__ import annotations

import math

import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest

from hands import type_into


def click(button):
    QTest.mouseClick(button, Qt.MouseButton.LeftButton)


@pytest.fixture
def panel(qtbot, window):
    """The unfolded section of the tab."""
    window.analysis.open("tilt")
    qtbot.waitExposed(window.analysis.window)
    panel = window.analysis.window.made["tilt"].balance
    assert panel.collapsed
    click(panel.button)
    qtbot.waitUntil(panel.start.isVisible)
    return panel


def test_gains_act_while_the_tray_is_balanced(qtbot, panel):
    type_into(panel.p_gain, "0")
    type_into(panel.d_gain, "0")
    click(panel.start)
    assert "Stop" in panel.start.text() and not panel.method.isEnabled()
    qtbot.waitUntil(lambda: bool(panel.steps) and panel.steps[-1].time_s > 3.4, timeout=60_000)
    assert {step.sensor_rad for step in panel.steps} == {0.0}  # nothing levels it
    assert math.degrees(abs(panel.steps[-1].roll_rad)) > 2.0
    click(panel.defaults)
    qtbot.waitUntil(lambda: math.degrees(abs(panel.steps[-1].roll_rad)) < 1.0, timeout=30_000)
    assert math.degrees(abs(panel.steps[-1].sensor_rad)) > 1.0
    click(panel.start)
    qtbot.waitUntil(lambda: "Start" in panel.start.text(), timeout=10_000)
    assert panel.status.text().startswith("Level after ")
    assert "proximity alone" in panel.status.text()
    assert len(panel.curves.plot.listDataItems()) == 3


def test_gains_and_method_are_remembered(qtbot, window, panel):
    type_into(panel.p_gain, "7.5")
    panel.method.setFocus()
    QTest.keyClick(panel.method, Qt.Key.Key_Down)
    other = type(panel)(window.context)
    assert (other.p_gain.value(), other.method.currentText()) == (7.5, "Proximity camera alone")
