"""Messages of the main window go when what they speak of is no longer true; nothing is pushed aside."""

from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication

from fakes import FakeSource
from hands import show_source
from tactune.app.worker.reading import SourceRequest
from tactune.core.errors import SourceError
from tactune.widgets.basics.messages import Severity


def fail_to_open(window, qtbot):
    def broken(_):
        raise SourceError("bag:/x.bag: damaged")

    window.open_request(SourceRequest("bag:/x.bag", broken))
    qtbot.waitUntil(lambda: window.messages.by_key.get("source") is not None)


def other_source(window, qtbot, name):
    source = FakeSource()
    source.name = name
    show_source(qtbot, window, source)


def test_a_refused_source_is_told_until_the_next_task_such_as_a_recording_or_a_calibration(window, qtbot, tmp_path):
    show_source(qtbot, window, FakeSource(live=True, name="live"))
    fail_to_open(window, qtbot)
    window.settings.set("folder/recordings", str(tmp_path / "recordings"))
    QTest.keyClick(window, Qt.Key.Key_F9)
    qtbot.waitUntil(lambda: window.recording.running)
    assert window.messages.by_key.get("source") is None
    QTest.keyClick(window, Qt.Key.Key_F9)
    qtbot.waitUntil(lambda: not window.recording.running)
    fail_to_open(window, qtbot)
    QTest.keyClick(window, Qt.Key.Key_K, Qt.KeyboardModifier.ControlModifier)
    assert window.calibration.wizard.isVisible() and window.messages.by_key.get("source") is None


def test_messages_about_a_source_and_ended_tasks_go_with_another_source(window, qtbot):
    window.messages.show_message("export", Severity.ERROR, "The disk is full.", subject="task")
    window.messages.show_message("worker", Severity.ERROR, "Frame 2 is damaged.", subject="source")
    window.messages.show_message("defect", Severity.ERROR, "The membrane burst.")
    other_source(window, qtbot, "another")
    assert window.messages.sentences() == ["The membrane burst."]


def test_escape_dismisses_and_the_key_of_messages_goes_to_them(window, qtbot):
    fail_to_open(window, qtbot)
    QTest.keyClick(window, Qt.Key.Key_F12)
    assert window.messages.isAncestorOf(QApplication.focusWidget())
    window.views.setFocus()
    QTest.keyClick(window, Qt.Key.Key_Escape)
    assert window.messages.sentences() == []
