"""The Help menu."""

from __future__ import annotations

import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtGui import QDesktopServices
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication

from hands import cells
from tactune.app.doctor import computer
from tactune.app.doctor.checks import Check, State
from tactune.app.window import help as help_menu

LEFT = Qt.MouseButton.LeftButton


@pytest.fixture
def opened(monkeypatch):
    urls = []
    monkeypatch.setattr(QDesktopServices, "openUrl", lambda url: urls.append(url.toLocalFile()) or True)
    return urls


def test_f1_opens_the_guide_that_ships_with_the_package(window, opened, monkeypatch, tmp_path):
    page = tmp_path / "index.html"
    page.write_text("guide")
    monkeypatch.setattr(help_menu, "guide_file", lambda: page)
    QTest.keyClick(window, Qt.Key.Key_F1)
    assert opened == [str(page)]


def test_a_guide_that_is_not_built_says_how_to_build_it(window, opened, monkeypatch, tmp_path):
    monkeypatch.setattr(help_menu, "guide_file", lambda: tmp_path / "index.html")
    QTest.keyClick(window, Qt.Key.Key_F1)
    assert opened == [] and "make guide" in window.messages.message("guide").sentence


def test_the_checks_of_this_computer_are_a_table_that_can_be_copied(window, qtbot, monkeypatch):
    lines = [Check("Sun", State.OK, "shines"), Check("Moon", State.FAIL, "wanes", "Wait for two weeks.")]
    monkeypatch.setattr(computer, "all_checks", lambda: [lambda: lines])
    window.actions_.check_computer.trigger()
    shown = window.computer
    qtbot.waitUntil(lambda: len(cells(shown.table)) == 2)
    assert cells(shown.table) == [["Sun", "✓ ok", "shines"], ["Moon", "✕ failed", "wanes\nWait for two weeks."]]
    assert "2 checks: 1 failed" in shown.status.text()
    QTest.mouseClick(shown.copy, LEFT)
    assert QApplication.clipboard().text() == computer.report(lines)
