"""The Tilt tab: angles of the shown frame, over time, copied and exported."""

from __future__ import annotations

import csv
import math

import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication

from hands import press, show_source
from small_recordings import GrowingPress, small_rig
from tactune.core.errors import counted
from tactune.core.sources.registry import open_source


def opened(qtbot, window, source=None, index=3):
    """Show a frame in the tab, opened by its key."""
    show_source(qtbot, window, source or open_source("sim:cube?press=medium"), index)
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow)
    QTest.keyClick(window, Qt.Key.Key_F8, Qt.KeyboardModifier.ShiftModifier)
    analysis = window.analysis.window
    qtbot.waitExposed(analysis)
    tab = analysis.made["tilt"]
    qtbot.waitUntil(lambda: tab.tilt is not None and tab.tilt.sequence == index)
    return tab


def go_to(qtbot, window, tab, index):
    window.worker.seek(index)
    qtbot.waitUntil(lambda: tab.tilt is not None and tab.tilt.sequence == index)


def test_shows_the_angles_of_the_frame_and_its_plane(qtbot, window):
    tab = opened(qtbot, window)
    angle, sigma = tab.roll.value()
    assert tab.roll.text() == f"Roll {math.degrees(angle):.2f}° ± {math.degrees(sigma):.2f}°".replace("-", "−")
    assert tab.roll.accessibleDescription() == tab.roll.text()
    assert abs(angle) < 0.2 and 0 < sigma < 0.05
    assert [name for name, _ in tab.cloud.legend()] == ["patch", "fitted plane"]
    assert "usual noise assumed" in tab.status.text()


def test_switches_method_and_filter_and_remembers_both(qtbot, window):
    tab = opened(qtbot, window)
    by_noise = tab.roll.value()
    tab.method.setFocus()
    QTest.keyClick(tab.method, Qt.Key.Key_Down)
    assert tab.tilt.method == "pca"
    assert tab.roll.value() != by_noise
    for index in (4, 5, 6):
        go_to(qtbot, window, tab, index)
    raw = tab.roll.value()
    tab.filtered.setFocus()
    QTest.keyClick(tab.filtered, Qt.Key.Key_Space)
    assert tab.roll.value()[1] < raw[1]
    assert tab.tilt.roll_rate_rad_s is not None
    other = type(tab)(window.context)
    assert (other.method.currentText(), other.filtered.isChecked()) == ("Principal components", True)
    other.shut_down()


def test_a_frame_without_contact_says_what_to_do(qtbot, window):
    tab = opened(qtbot, window, GrowingPress(small_rig(64), 4, False), 0)
    assert tab.cloud.message().startswith("No contact yet: press the object")
    assert tab.roll.text() == "Roll not determined"
    assert tab.axis.text() == "Long axis not determined"


def test_copies_the_angles(qtbot, window):
    tab = opened(qtbot, window)
    QTest.mouseClick(tab.copy, Qt.MouseButton.LeftButton)
    copied = QApplication.clipboard().text()
    assert copied == f"{tab.roll.text()}, {tab.pitch.text()}, {tab.axis.text()} (frame 3, noise)"


def test_exports_what_was_shown_and_brings_a_removed_curve_back(qtbot, window, tmp_path):
    tab = opened(qtbot, window)
    go_to(qtbot, window, tab, 4)
    before = dict(tab.rows)
    QTest.mouseClick(tab.reset, Qt.MouseButton.LeftButton)
    assert not tab.rows and not tab.export.isEnabled()
    assert tab.curve.empty.isVisible() and not tab.curve.plot.isVisible()
    press(tab.messages.message("reset"), "Bring it back")
    assert tab.rows == before
    assert tab.curve.plot.isVisible() and not tab.curve.empty.isVisible()
    tab.save_to(tmp_path / "tilt.csv")
    qtbot.waitUntil(lambda: any("written" in sentence for sentence in tab.messages.sentences()))
    with (tmp_path / "tilt.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["frame"] for row in rows] == ["3", "4"]
    assert float(rows[1]["roll_deg"]) == pytest.approx(math.degrees(before[4].raw.roll_rad), abs=1e-3)
    assert float(rows[1]["filtered_roll_sigma_deg"]) == pytest.approx(
        math.degrees(before[4].filtered.roll_sigma_rad), abs=1e-3
    )


def test_offers_the_tilts_of_the_former_source(qtbot, window):
    tab = opened(qtbot, window)
    former = tab.rows
    show_source(qtbot, window, open_source("sim:cube?press=low"), 0)
    qtbot.waitUntil(lambda: tab.rows is not former)
    assert f"The tilts of sim:cube?press=medium ({counted(len(former), 'frame')}) ended" in " ".join(
        tab.messages.sentences()
    )
