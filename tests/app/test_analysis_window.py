"""The Analysis window: opened by its actions, updated while visible, closed with the main window."""

import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QLabel

from tactune.app.analysis import window as analysis_window
from tactune.app.analysis.tab import AnalysisTab, TabKind


class NotingTab(AnalysisTab):
    """Remembers what it was told."""

    def __init__(self, _context):
        super().__init__()
        self.sequences = []
        self.ended = False

    def show_result(self, result):
        self.sequences.append(result.frame.sequence)

    def shut_down(self):
        self.ended = True


def broken_tab(_context):
    raise RuntimeError("no such sensor")


@pytest.fixture(autouse=True)
def tabs(monkeypatch):
    own = {
        "compare": TabKind("&Compare", "Compares", NotingTab, "F7"),
        "strain": TabKind("&Strain", "Measures strain", NotingTab, "Ctrl+T"),
    }
    added = {"clash": TabKind("&Xclash", "Wants a key that is taken", broken_tab, "F7")}
    problems = {"worn": "the entry point 'worn' of the package worn cannot be loaded"}
    monkeypatch.setattr(analysis_window, "OWN_TABS", own)
    monkeypatch.setattr(analysis_window, "added_by_others", lambda group, kind: (added, problems))


def opened(qtbot, window):
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow)
    QTest.keyClick(window, Qt.Key.Key_F7)
    analysis = window.analysis.window
    assert analysis is not None
    qtbot.waitExposed(analysis)
    return analysis


def test_a_key_opens_the_window_on_its_tab_with_the_present_frame(qtbot, window):
    analysis = opened(qtbot, window)
    assert analysis.isVisible() and not analysis.isModal()
    assert list(analysis.made) == ["compare"]
    assert analysis.made["compare"].sequences[-1] == 3
    preset = window.document.preset
    window.document.edit("tolerance.t", 0.04)
    QTest.keyClick(analysis, Qt.Key.Key_Z, Qt.KeyboardModifier.ControlModifier)
    assert window.document.preset == preset
    QTest.keyClick(analysis, Qt.Key.Key_F6)
    qtbot.waitUntil(lambda: window.modes.mode == "set_up" and window.isActiveWindow())


def test_only_the_visible_tab_takes_frames_and_a_closed_window_none(qtbot, window):
    analysis = opened(qtbot, window)
    compare = analysis.made["compare"]
    analysis.open_on("strain")
    seen = len(compare.sequences)
    window.worker.seek(5)
    qtbot.waitUntil(lambda: analysis.made["strain"].sequences[-1] == 5)
    assert len(compare.sequences) == seen
    QTest.keyClick(analysis, Qt.Key.Key_Escape)
    assert not analysis.isVisible()
    strain = list(analysis.made["strain"].sequences)
    window.worker.seek(6)
    qtbot.waitUntil(lambda: window.result.frame.sequence == 6)
    assert analysis.made["strain"].sequences == strain
    opened(qtbot, window)
    assert analysis.made["compare"].sequences[-1] == 6


def test_the_main_window_closes_it_and_ends_its_tabs_and_its_place_is_remembered(qtbot, window):
    analysis = opened(qtbot, window)
    analysis.setGeometry(40, 50, 700, 500)
    window.close_without_asking()
    assert analysis.made["compare"].ended
    assert not analysis.isVisible()
    again = analysis_window.AnalysisWindow(analysis_window.OWN_TABS, window.context, window.actions_.play)
    qtbot.addWidget(again)
    assert again.geometry() == analysis.geometry()


def test_the_menu_lists_every_tab_with_its_tip_and_free_shortcut(own_window):
    texts = [(action.text(), action.toolTip()) for action in own_window.analysis.actions.values()]
    assert texts == [
        ("&Compare…", "Compares (F7)"),
        ("&Strain…", "Measures strain (Ctrl+T)"),
        ("&Xclash…", "Wants a key that is taken"),
    ]
    listed = [action.text() for menu in own_window.menuBar().actions() for action in menu.menu().actions()]
    assert {text for text, _ in texts} <= set(listed)
    assert own_window.messages.by_key.get("shortcut of clash") is not None
    assert own_window.messages.by_key.get("tab worn") is not None


def test_a_tab_that_cannot_be_opened_says_why_and_leaves_the_others_alone(qtbot, own_window):
    window = own_window
    with qtbot.captureExceptions() as raised:
        window.analysis.open("clash")
    analysis = window.analysis.window
    label = analysis.made["clash"].findChild(QLabel)
    assert "no such sensor" in label.text() and len(raised) == 1
    analysis.open_on("compare")
    assert analysis.made["compare"].sequences[-1] == 3
