"""The dialog *Open…*, and recordings and folders of other programs: what they lack is asked for once, and kept."""

import cv2
import numpy as np
import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QDialogButtonBox

from fakes import FakeSource
from hands import CONTROL, LEFT, show_source, type_path
from ros_maker import color, depth, make_recording
from tactune.app.sources.folder_rig_dialog import FolderRigDialog
from tactune.core.sources.folder import export_folder
from tactune.core.sources.ros.topics import load_topics, store_topics


def press(dialog, button):
    QTest.mouseClick(dialog.buttons.button(button), LEFT)


def ask(window, qtbot, path):
    window.open_source(str(path))
    qtbot.waitUntil(lambda: window.topics.dialog is not None and window.topics.dialog.isVisible())
    return window.topics.dialog


@pytest.fixture
def asked(window, qtbot, tmp_path):
    """The dialog for a recording whose names say which camera is which, and its path."""
    streams = [
        depth("/l515/depth/image_rect_raw", "a_optical"),
        depth("/d405/depth/image_rect_raw", "b_optical", 390),
        color("/l515/color/image_raw", "c_optical"),
    ]
    path = make_recording(tmp_path / "take", streams)
    return ask(window, qtbot, path), path


def opened(window, path):
    return window.result is not None and window.result.source.name == f"rosbag:{path}"


def test_the_guess_is_opened_with_one_click_and_never_asked_again(window, qtbot, asked):
    dialog, path = asked
    assert dialog.topics == {
        "proximity.depth": "/l515/depth/image_rect_raw",
        "proximity.color": "/l515/color/image_raw",
        "tactile.depth": "/d405/depth/image_rect_raw",
    }
    chosen = dialog.topics
    press(dialog, QDialogButtonBox.StandardButton.Open)
    qtbot.waitUntil(lambda: opened(window, path))
    assert load_topics(path) == chosen
    assert window.result.frame.tactile_depth[0, 0] in (390, 391, 392)
    show_source(qtbot, window, FakeSource())
    window.open_source(str(path))
    qtbot.waitUntil(lambda: opened(window, path))
    assert window.topics.dialog is None


def test_cameras_are_exchanged_by_keys_and_one_topic_twice_is_no_choice(window, qtbot, asked):
    dialog, path = asked
    open_button = dialog.buttons.button(QDialogButtonBox.StandardButton.Open)
    for slot, topic in (("proximity.depth", "/d405"), ("tactile.depth", "/l515")):
        box = dialog.choices[slot]
        box.setFocus()
        rows = box.findText(topic, Qt.MatchFlag.MatchStartsWith) - box.currentIndex()
        for _ in range(abs(rows)):
            QTest.keyClick(box, Qt.Key.Key_Down if rows > 0 else Qt.Key.Key_Up)
        assert box.currentText().startswith(topic)
        assert open_button.isEnabled() == (slot == "tactile.depth")
    QTest.keyClick(dialog, Qt.Key.Key_Return)
    qtbot.waitUntil(lambda: opened(window, path))
    assert window.result.frame.tactile_depth[0, 0] in (400, 401, 402)


def test_names_that_tell_nothing_need_one_choice(window, qtbot, tmp_path):
    path = make_recording(tmp_path / "take", [depth("/left", "a_optical"), depth("/right", "b_optical", 390)])
    dialog = ask(window, qtbot, path)
    assert list(dialog.choices) == ["proximity.depth", "tactile.depth"] and not dialog.topics
    QTest.keyClick(dialog.choices["tactile.depth"], Qt.Key.Key_End)
    QTest.keyClick(dialog, Qt.Key.Key_Return)
    qtbot.waitUntil(lambda: opened(window, path))
    assert window.result.frame.tactile_depth[0, 0] in (390, 391, 392) and window.result.source.rig.has_proximity


def test_cancel_opens_nothing_and_says_so(window, qtbot, asked):
    dialog, path = asked
    press(dialog, QDialogButtonBox.StandardButton.Cancel)
    qtbot.waitUntil(lambda: any("No topics were chosen" in each for each in window.messages.sentences()))
    assert not opened(window, path)
    store_topics(path, {"tactile.depth": "/nowhere"})
    window.open_source(str(path))
    qtbot.waitUntil(lambda: any("/nowhere" in each for each in window.messages.sentences()))


def test_a_lens_that_the_recording_lacks_is_asked_for(window, qtbot, tmp_path):
    path = make_recording(tmp_path / "take", [depth("/d405/depth/image_rect_raw", "b_optical", 390, info=None)])
    (tmp_path / "K,1.txt").write_text("30 0 15.5 0 31 11.5 0 0 1")
    (tmp_path / "other.txt").write_text("1 0 0")
    dialog = ask(window, qtbot, path)
    assert not dialog.buttons.button(QDialogButtonBox.StandardButton.Open).isEnabled()
    for name in ("other.txt", "K,1.txt"):  # the wrong one is replaced
        QTest.mouseClick(dialog.lens, LEFT)
        type_path(qtbot, tmp_path / name)
        qtbot.waitUntil(lambda name=name: name in dialog.note.text())
    press(dialog, QDialogButtonBox.StandardButton.Open)
    qtbot.waitUntil(lambda: opened(window, path))
    assert window.result.source.rig.tactile.intrinsics.fy == 31


def test_a_folder_of_images_without_a_rig_is_asked_for_lens_and_unit(window, qtbot, tmp_path):
    folder = tmp_path / "images"
    for name in ("proximity", "tactile"):
        (folder / name).mkdir(parents=True)
        for index in range(2):
            cv2.imwrite(str(folder / name / f"depth_{index}.png"), np.full((24, 32), 400, np.uint16))
    (folder / "proximity" / "K.txt").write_text("30 0 15.5 0 31 11.5 0 0 1")
    window.open_source(str(folder))
    qtbot.waitUntil(lambda: isinstance(window.topics.dialog, FolderRigDialog))
    dialog = window.topics.dialog
    assert list(dialog.lenses) == ["proximity", "tactile"]
    open_button = dialog.buttons.button(QDialogButtonBox.StandardButton.Open)
    qtbot.waitUntil(lambda: "unit of the proximity depth is unknown" in dialog.note.text())
    assert "--" not in dialog.note.text() and not open_button.isEnabled()
    dialog.unit.setFocus()
    QTest.keyClicks(dialog.unit, "mm")
    qtbot.waitUntil(lambda: "lens of the tactile camera is unknown" in dialog.note.text())
    dialog.lenses["tactile"].setFocus()
    QTest.keyClicks(dialog.lenses["tactile"], "40,41,15,12")
    qtbot.waitUntil(open_button.isEnabled)
    assert "pose between the cameras is unknown" in dialog.about.text()
    press(dialog, QDialogButtonBox.StandardButton.Open)
    qtbot.waitUntil(lambda: window.result is not None and window.result.source.name == f"folder:{folder}")
    rig = window.result.source.rig
    assert (rig.proximity.intrinsics.fy, rig.tactile.intrinsics.fx, rig.tactile.depth_unit_m) == (31, 40, 0.001)
    assert (folder / "rig.json").is_file() and window.topics.dialog is None


CAMERAS, FILES = range(2)


@pytest.fixture
def recording(tmp_path):
    export_folder(FakeSource(length=2), tmp_path / "recording")
    return tmp_path / "recording"


def open_dialog(window, qtbot, page=None):
    QTest.keyClick(window, Qt.Key.Key_O, CONTROL)
    qtbot.waitUntil(lambda: window.sources.dialog is not None and window.sources.dialog.isVisible())
    dialog = window.sources.dialog
    if page is not None:
        QTest.mouseClick(dialog.tabs.tabBar(), LEFT, pos=dialog.tabs.tabBar().tabRect(page).center())
        assert dialog.page is dialog.pages[page]
    return dialog


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
