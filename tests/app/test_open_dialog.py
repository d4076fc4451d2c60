"""The dialog *Open…*: a page gives the name, errors are said in it."""

import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QDialogButtonBox

from fakes import FakeSource
from hands import CONTROL, LEFT
from tactune.core.sources.folder import export_folder

CAMERAS, FILES = range(2)


@pytest.fixture
def recording(tmp_path):
    export_folder(FakeSource(length=2), tmp_path / "recording")
    return tmp_path / "recording"


def open_dialog(window, qtbot, page=None):
    """Press Ctrl+O, and choose a page."""
    QTest.keyClick(window, Qt.Key.Key_O, CONTROL)
    qtbot.waitUntil(lambda: window.sources.dialog is not None and window.sources.dialog.isVisible())
    dialog = window.sources.dialog
    if page is not None:
        QTest.mouseClick(dialog.tabs.tabBar(), LEFT, pos=dialog.tabs.tabBar().tabRect(page).center())
        assert dialog.page is dialog.pages[page]
    return dialog


def type_name(dialog, name):
    dialog.name.setFocus()
    dialog.name.selectAll()
    QTest.keyClicks(dialog.name, name)


def shows(window, name):
    return window.result is not None and window.result.source.name == name


# Opening


def test_an_error_is_said_in_the_dialog_is_corrected_and_enter_opens(window, qtbot, recording):
    dialog = open_dialog(window, qtbot)
    qtbot.waitUntil(dialog.name.hasFocus)
    QTest.keyClicks(dialog.name, f"folder:{recording}x")
    QTest.mouseClick(dialog.buttons.button(QDialogButtonBox.StandardButton.Open), LEFT)
    qtbot.waitUntil(lambda: "there is no folder" in dialog.note.text())
    assert window.messages.sentences() == []
    assert window.result.source.name == "tiny"
    QTest.keyClick(dialog.name, Qt.Key.Key_Backspace)
    QTest.keyClick(dialog.name, Qt.Key.Key_Return)
    qtbot.waitUntil(lambda: shows(window, f"folder:{recording}"))
    assert window.sources.dialog is None


# Recent sources


def test_a_recording_that_was_open_opens_by_double_click(window, qtbot, recording):
    name = f"folder:{recording}"
    window.open_source(name)
    qtbot.waitUntil(lambda: shows(window, name))
    dialog = open_dialog(window, qtbot, FILES)
    opened = []
    window.worker.opened.connect(opened.append)
    place = dialog.page.list.visualItemRect(dialog.page.list.item(0)).center()
    QTest.mouseClick(dialog.page.list.viewport(), LEFT, pos=place)
    QTest.mouseDClick(dialog.page.list.viewport(), LEFT, pos=place)
    qtbot.waitUntil(lambda: [info.name for info in opened] == [name])
    assert window.sources.dialog is None


def test_a_recording_that_is_gone_is_not_listed(window, qtbot, recording, tmp_path):
    for name in (f"folder:{recording}", f"mcap:{tmp_path / 'gone.mcap'}"):
        window.settings.add_recent("sources", name)
    dialog = open_dialog(window, qtbot, FILES)
    texts = [dialog.page.list.item(row).text() for row in range(dialog.page.list.count())]
    assert texts[0] == f"folder:{recording}"
