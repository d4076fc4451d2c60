"""Recordings in files: dropped or chosen in the dialog, one or the two of two cameras."""

from __future__ import annotations

import pytest
from PyQt6.QtCore import QMimeData, QPointF, Qt, QUrl
from PyQt6.QtGui import QDropEvent
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication, QFileDialog, QLineEdit

from tactune.app.window.files import recording_filters, recording_scheme
from tactune.core.recording.writer import SessionWriter
from tiny_sensor import TinySource

CONTROL = Qt.KeyboardModifier.ControlModifier


def drop(window, *paths):
    data = QMimeData()
    data.setUrls([QUrl.fromLocalFile(str(path)) for path in paths])
    window.dropEvent(
        QDropEvent(
            QPointF(300, 300),
            Qt.DropAction.CopyAction,
            data,
            Qt.MouseButton.LeftButton,
            Qt.KeyboardModifier.NoModifier,
        )
    )


@pytest.fixture
def session(tmp_path):
    path = tmp_path / "session.mcap"
    with TinySource(length=5) as source:
        writer = SessionWriter(path, source.rig)
        for frame in source:
            writer.put(frame, wait=True)
        writer.close()
    return path


def shows(window, name):
    return window.result is not None and window.result.source.name == name


def test_a_session_that_is_dropped_plays_seeks_steps_and_loops(make_window, qtbot, session):
    window = make_window()
    drop(window, session)
    qtbot.waitUntil(lambda: shows(window, f"mcap:{session}"))
    assert window.result.source.length == 5
    shown = set()
    window.context.frameShown.connect(lambda: shown.add(window.result.frame.sequence))
    qtbot.waitUntil(lambda: shown == {0, 1, 2, 3, 4})
    QTest.keyClick(window, Qt.Key.Key_Space)
    qtbot.waitUntil(lambda: not window.transport.state.playing)
    window.worker.seek(2)
    qtbot.waitUntil(lambda: window.result.frame.sequence == 2)
    QTest.keyClick(window, Qt.Key.Key_Period)
    qtbot.waitUntil(lambda: window.result.frame.sequence == 3)


def test_a_session_is_opened_by_key_and_dialog(make_window, qtbot, session):
    window = make_window()
    QTest.keyClick(window, Qt.Key.Key_R, CONTROL)
    qtbot.waitUntil(lambda: isinstance(QApplication.activeModalWidget(), QFileDialog))
    dialog = QApplication.activeModalWidget()
    assert "*.mcap" in dialog.nameFilters()[0]
    entry = dialog.findChild(QLineEdit)
    entry.setText(str(session))
    QTest.keyClick(entry, Qt.Key.Key_Return)
    qtbot.waitUntil(lambda: shows(window, f"mcap:{session}"))


@pytest.mark.parametrize(
    ("name", "scheme"),
    [("a.mcap", "mcap"), ("A.MCAP", "mcap"), ("a.bag", "bag"), ("a.db3", "bag"), ("a.json", ""), ("mcap", "")],
)
def test_files_are_known_by_their_ending(tmp_path, name, scheme):
    assert recording_scheme(tmp_path / name) == scheme


def test_the_dialog_offers_every_kind_of_file():
    assert all(ending in recording_filters()[0] for ending in ("*.mcap", "*.bag", "*.db3"))


def test_two_bags_are_opened_together(make_window, tmp_path):
    window = make_window()
    names = []
    window.file_flows._open_source = names.append
    drop(window, tmp_path / "b.bag", tmp_path / "a.bag")
    assert names == [f"bag:{tmp_path / 'a.bag'},{tmp_path / 'b.bag'}"]


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (("a.bag", "b.bag", "c.bag"), "one recording at a time, or the two"),
        (("a.mcap", "b.mcap"), "one recording at a time"),
        (("a.mcap", "b.bag"), "a.mcap, b.bag are recordings of different kinds"),
        (("a.txt",), "a.txt is neither a preset"),
    ],
)
def test_what_cannot_be_opened_together_is_said(make_window, tmp_path, names, words):
    window = make_window()
    drop(window, *(tmp_path / name for name in names))
    assert any(words in sentence for sentence in window.messages.sentences())
