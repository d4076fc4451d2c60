"""Messages over the views: they push nothing, notes go by themselves, errors stay, and all are kept in a list."""

import pytest
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication, QFrame, QToolButton, QVBoxLayout, QWidget

from hands import shown
from tactune.widgets.basics import messages as module
from tactune.widgets.basics.messages import Messages, Severity

LEFT = Qt.MouseButton.LeftButton


@pytest.fixture
def views(qtbot):
    """A widget with messages over it, beside another that must not move."""
    window = QWidget()
    window.over, window.below = QWidget(), QFrame()
    layout = QVBoxLayout(window)
    layout.addWidget(window.over, 1)
    layout.addWidget(window.below, 1)
    window.messages = Messages(window.over)
    return shown(qtbot, window, 600, 700)


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr(module, "NOTE_MS", 30)
    monkeypatch.setattr(module, "CHARACTER_MS", 0)


def test_messages_push_nothing_aside_and_stay_inside(views):
    before = views.over.geometry(), views.below.geometry()
    for key in "abcde":
        views.messages.show_message(key, Severity.ERROR, f"{key}: " + "a long sentence " * 20)
    QApplication.processEvents()
    assert (views.over.geometry(), views.below.geometry()) == before
    assert views.over.rect().contains(views.messages.geometry())
    for message in map(views.messages.by_key.get, "abcde"):
        assert not message.isVisible() or message.height() >= message.heightForWidth(message.width())


def test_the_newest_three_are_on_the_screen_the_newest_on_top_and_errors_before_notes(views):
    views.messages.show_message("error", Severity.ERROR, "Error.")
    for key in "abc":
        views.messages.show_message(key, Severity.INFO, f"{key}.")
    QApplication.processEvents()
    shown = {key: views.messages.by_key.get(key) for key in ("error", "a", "b", "c")}
    assert [key for key, message in shown.items() if message.isVisible()] == ["error", "b", "c"]
    assert shown["c"].y() < shown["b"].y() < shown["error"].y()


def test_only_a_note_without_buttons_goes_by_itself(views, quick, qtbot):
    views.messages.show_message("note", Severity.INFO, "Written to a.ply.")
    views.messages.show_message("answer", Severity.INFO, "Recorded.", [("Open", lambda: None)])
    views.messages.show_message("error", Severity.ERROR, "Damaged.")
    qtbot.waitUntil(lambda: views.messages.sentences() == ["Recorded.", "Damaged."])


def test_a_message_is_dismissed_by_its_cross_by_escape_and_with_its_subject(views):
    for key in ("cross", "escape"):
        views.messages.show_message(key, Severity.ERROR, key)
    views.messages.show_message("left", Severity.ERROR, "left", subject="other")
    views.messages.show_message("of", Severity.ERROR, "of the source", subject="source")
    views.messages.clear_subject("source")
    assert views.messages.sentences() == ["cross", "escape", "left"]
    views.messages.clear("left")
    assert views.messages.focus_newest()
    QTest.keyClick(QApplication.focusWidget(), Qt.Key.Key_Escape)
    assert views.messages.sentences() == ["cross"]
    [cross] = views.messages.by_key["cross"].findChildren(QToolButton)
    QTest.mouseClick(cross, LEFT, pos=QPoint(4, 4))
    assert views.messages.sentences() == [] and not views.messages.isVisible()
