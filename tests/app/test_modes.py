"""The three modes, the bar at the top and the search, by real keys and mouse."""

import pytest
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication, QFileDialog, QPushButton

from fakes import FakeSource
from hands import CONTROL, CONTROL_SHIFT, LEFT, show_source
from tactune.app.window.modes import Mode, RunPanel
from tactune.core.preset import CONTACT_TESTS
from tactune.widgets.parameters.slider import Slider

KEYS = {Mode.SET_UP: Qt.Key.Key_1, Mode.TUNE: Qt.Key.Key_2, Mode.RUN: Qt.Key.Key_3}


def places(window, *widgets):
    return [(widget.mapTo(window, QPoint(0, 0)), widget.size()) for widget in widgets]


def search(qtbot, window, words):
    window.activateWindow()  # the list of an earlier search may have been active
    qtbot.waitUntil(window.isActiveWindow)
    QTest.keyClick(window, Qt.Key.Key_P, CONTROL_SHIFT)
    assert window.search.hasFocus()
    QTest.keyClicks(window.search, words)
    QTest.keyClick(window.search, Qt.Key.Key_Return)


def test_keys_choose_a_mode_and_its_controls_and_nothing_else_moves(window):
    fixed = (window.mode_bar, window.search, window.mode_bar.source, window.mode_bar.preset, window.views, window.rail)
    before = places(window, *fixed)
    panels = {Mode.SET_UP: window.set_up, Mode.TUNE: window.panel, Mode.RUN: window.publishing.panel}
    for mode, key in KEYS.items():
        QTest.keyClick(window, key, CONTROL)
        QApplication.processEvents()
        assert [other for other, panel in panels.items() if panel.isVisible()] == [mode]
        assert places(window, *fixed) == before
    window.document.edit("name", "a preset with a name that is longer than its button")
    QApplication.processEvents()
    assert places(window, *fixed) == before


def test_a_recording_is_played_as_if_it_were_live(window, qtbot):
    show_source(qtbot, window, FakeSource(length=3))
    QTest.keyClick(window, Qt.Key.Key_3, CONTROL)
    button = window.findChild(RunPanel).play_live
    with qtbot.waitSignal(window.context.sourceRequested, check_params_cb=lambda name: name.startswith("live:")):
        QTest.mouseClick(button, LEFT)


def test_enter_runs_the_entry_that_the_arrows_marked(window, qtbot):
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow)
    QTest.keyClick(window, Qt.Key.Key_P, CONTROL_SHIFT)
    QTest.keyClicks(window.search, "view")
    popup = window.search.completer().popup()
    rows = [popup.model().index(row, 0) for row in range(popup.model().rowCount())]
    wanted = next(row for row in rows if "Top view" in row.data())
    for _ in range(wanted.row() + 1):
        QTest.keyClick(popup, Qt.Key.Key_Down)
    with qtbot.waitSignal(window.actions_.top_view.triggered):
        QTest.keyClick(popup, Qt.Key.Key_Return)


def test_what_can_be_exported_is_found_by_its_kind(window, qtbot):
    show_source(qtbot, window, FakeSource(length=3))
    search(qtbot, window, "animation")
    qtbot.waitUntil(lambda: isinstance(QApplication.activeModalWidget(), QFileDialog))
    dialog = QApplication.activeModalWidget()
    assert "(*.gif)" in dialog.selectedNameFilter()
    dialog.reject()


def test_the_next_step_has_its_button(window, qtbot):
    QTest.keyClick(window, Qt.Key.Key_3, CONTROL)
    assert window.modes.button.defaultAction() is window.actions_.export
    QTest.keyClick(window, Qt.Key.Key_2, CONTROL)
    assert window.modes.button.defaultAction() is window.actions_.suggest_all
    window.document.edit("tolerance.t", 0.02)
    assert window.modes.button.defaultAction() is window.actions_.save
    QTest.keyClick(window, Qt.Key.Key_3, CONTROL)
    show_source(qtbot, window, FakeSource(live=True))
    qtbot.waitUntil(lambda: window.modes.button.defaultAction() is window.actions_.record)


@pytest.mark.parametrize("contact_test", CONTACT_TESTS)
def test_sliders_are_long_enough_to_aim_with_in_a_small_window(window, qtbot, contact_test):
    window.resize(1024, 700)
    QTest.keyClick(window, Qt.Key.Key_2, CONTROL)
    window.document.edit("contact_test", contact_test)
    window.panel.set_collapsed_sections([])
    for form in window.panel.forms.values():
        form.more.fold(False)
    sliders = [slider for slider in window.panel.findChildren(Slider) if slider.isVisible()]
    qtbot.waitUntil(lambda: min(slider.width() for slider in sliders) >= 120)
    for row in window.panel.rows.values():
        if row.label.isVisible():
            assert row.label.width() >= row.label.sizeHint().width()


def test_the_space_bar_plays_after_a_change_of_mode_by_keys(window, qtbot):
    show_source(qtbot, window, FakeSource(length=3))
    QTest.keyClick(window, Qt.Key.Key_1, CONTROL)
    window.set_up.findChild(QPushButton).setFocus()
    QTest.keyClick(window, Qt.Key.Key_2, CONTROL)
    with qtbot.waitSignal(window.actions_.play.triggered):
        QTest.keyClick(QApplication.focusWidget() or window, Qt.Key.Key_Space)
    window.panel.suggests["mask"].setFocus(Qt.FocusReason.MouseFocusReason)  # as by a click
    with qtbot.waitSignal(window.actions_.play.triggered):
        QTest.keyClick(window.windowHandle(), Qt.Key.Key_Space)


def test_search_runs_an_action_and_shows_a_parameter(window, qtbot):
    search(qtbot, window, "in mark")
    qtbot.waitUntil(lambda: window.context.trim == (3, 8))
    assert window.search.text() == ""
    window.timeline.clear_marks()
    window.panel.set_collapsed_sections(["tolerance"])
    QTest.keyClick(window, Qt.Key.Key_1, CONTROL)
    row = window.panel.rows["tolerance.t"]
    search(qtbot, window, f"tolerance: {row.spec.title.lower()}")
    qtbot.waitUntil(lambda: any(stop.hasFocus() for stop in row.tab_stops))
    assert window.modes.mode is Mode.TUNE and row.widget.isVisible()


def test_search_finds_every_action_and_every_parameter(window, qtbot):
    show_source(qtbot, window, FakeSource(), 3)
    names = [name for name, *_ in window._found_by_name()]
    assert len(names) >= len(window.actions_.by_name().values()) + len(window.panel.rows)
    assert len(names) == len(set(names)), "each name means one thing"
