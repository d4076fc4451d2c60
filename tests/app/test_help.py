"""The Help menu, and the card of the first start."""

from __future__ import annotations

import pytest
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtGui import QDesktopServices
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication

from hands import show_source, type_path
from tactune.app.doctor import report as doctor_report
from tactune.app.doctor.checks import Check, State
from tactune.app.window import help as help_menu
from tactune.app.window.first_steps import FirstStepsCard
from tiny_sensor import TinySource

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
    monkeypatch.setattr(doctor_report, "all_checks", lambda: [lambda: lines])
    window.actions_.check_computer.trigger()
    shown = window.computer
    qtbot.waitUntil(lambda: shown.table.rowCount() == 2)
    cells = [[shown.table.item(row, column).text() for column in range(3)] for row in range(2)]
    assert cells == [["Sun", "✓ ok", "shines"], ["Moon", "✕ failed", "wanes\nWait for two weeks."]]
    assert "2 checks: 1 failed" in shown.status.text()
    QTest.mouseClick(shown.copy, LEFT)
    assert QApplication.clipboard().text() == doctor_report.report(lines)


def test_a_closed_window_of_checks_can_check_again(window, qtbot, monkeypatch):
    monkeypatch.setattr(doctor_report, "all_checks", lambda: [lambda: [Check("Sun", State.OK, "shines")]])
    window.actions_.check_computer.trigger()
    window.computer.close()
    window.actions_.check_computer.trigger()
    qtbot.waitUntil(lambda: window.computer.table.rowCount() == 1)
    assert window.computer.copy.isEnabled()


@pytest.fixture
def first_start(make_window, qtbot, preset):
    """A window as at the first start, standing still at a frame of the simulator."""
    window = make_window(preset.with_values({"mask.enabled": False}))
    window.offer_first_steps()
    source = TinySource()
    source.name = "sim:cup"
    show_source(qtbot, window, source, 3)
    qtbot.waitUntil(card(window).isVisible)
    return window


def card(window):
    return window.findChild(FirstStepsCard)


def done(window):
    return {name for name, tick in card(window).ticks.items() if tick.text()}


def test_the_card_ticks_each_step_when_it_has_happened(first_start, qtbot, tmp_path):
    window = first_start
    assert done(window) == set()
    QTest.mouseClick(card(window).buttons["mask"], LEFT)
    assert window.panel.isAncestorOf(QApplication.focusWidget())
    QTest.keyClick(QApplication.focusWidget(), Qt.Key.Key_Space)
    qtbot.waitUntil(lambda: done(window) == {"mask"})

    window.document.edit("tolerance.t", 0.04)
    qtbot.waitUntil(lambda: done(window) == {"mask", "contact"})

    show_source(qtbot, window, TinySource())
    qtbot.waitUntil(lambda: done(window) == {"source", "mask", "contact"})

    QTest.mouseClick(card(window).buttons["save"], LEFT)
    type_path(qtbot, tmp_path / "mine.json")
    qtbot.waitUntil(lambda: done(window) == {"source", "mask", "contact", "save"})


def test_another_preset_is_no_step(first_start, qtbot, preset):
    window = first_start
    window.document.edit("region.enabled", True)
    other = preset.with_values({"tolerance.t": 0.05, "mask.enabled": True})
    window.document.new(other)
    qtbot.waitUntil(lambda: window.result.preset is other)
    assert done(window) == set()


def test_the_buttons_open_source_and_suggestions(first_start, qtbot):
    for step, action in (("source", "open_source"), ("calibrate", "calibrate"), ("contact", "suggest_all")):
        with qtbot.waitSignal(getattr(first_start.actions_, action).triggered):
            QTest.mouseClick(card(first_start).buttons[step], LEFT)
        if QApplication.activeModalWidget() is not None:
            QApplication.activeModalWidget().close()
        for window in QApplication.topLevelWidgets():
            if window is not first_start and window.isVisible():
                window.close()


def test_the_card_is_closed_for_good_and_comes_back_from_help_with_its_ticks(first_start, make_window, qtbot):
    window = first_start
    window.document.edit("tolerance.t", 0.04)
    qtbot.waitUntil(lambda: "contact" in done(window))
    QTest.mouseClick(card(window).cross, LEFT)
    assert not card(window).isVisible()
    window.settings.sync()

    again = make_window()
    again.offer_first_steps()
    show_source(qtbot, again, TinySource(), 3)
    assert not card(again).isVisible()
    again.actions_.getting_started.trigger()
    assert card(again).isVisible() and "contact" in done(again)
    QTest.keyClick(QApplication.focusWidget(), Qt.Key.Key_Escape)
    assert not card(again).isVisible()


def test_the_card_covers_one_view_only_and_the_mouse_reaches_the_others(first_start):
    first_start.resize(1024, 700)
    QApplication.processEvents()
    from tactune.app.worker.results import CloudName

    views, shown = first_start.views, card(first_start)
    tactile = views.views[CloudName.TACTILE]
    beside = QPoint(tactile.mapTo(views, tactile.rect().topLeft()).x() + 5, shown.mapTo(views, QPoint(0, 50)).y())
    assert views.rect().contains(first_start.messages.geometry())
    assert shown.mapTo(views, shown.rect().topRight()).x() < beside.x() < first_start.messages.geometry().right()
    assert tactile.isAncestorOf(views.childAt(beside))
