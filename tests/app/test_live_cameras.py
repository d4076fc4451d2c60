"""Choosing and configuring cameras: lists, messages without cameras, options stored in the preset."""

import json

import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QCheckBox, QDialogButtonBox

from fakes import FakeCameras
from hands import CONTROL, LEFT, cells, press, show_source, type_into
from tactune.app.sources import list_devices
from tactune.app.window.main_window import MainWindow

L515 = {"model": "L515", "serial": "f001", "firmware": "1.5.8.1", "usb": "3.2", "role": "proximity"}
D405 = {"model": "D405", "serial": "d002", "firmware": "5.12.14", "usb": "3.2"}


@pytest.fixture
def answering(monkeypatch):
    """Let the search for cameras answer with this program."""
    return lambda text: monkeypatch.setattr(list_devices, "PROGRAM", ("-c", text))


@pytest.fixture
def finding(answering):
    return lambda *devices: answering(f"print({json.dumps(json.dumps({'devices': devices}))})")


@pytest.fixture
def window(qtbot, shared, preset, tmp_path, monkeypatch):
    opened_names = []
    monkeypatch.setattr(MainWindow, "open_source", lambda self, name: opened_names.append(name))
    made = shared.ready(qtbot, tmp_path, preset)
    made.opened_names = opened_names
    return made


def chooser(window, qtbot):
    QTest.keyClick(window, Qt.Key.Key_F3)
    qtbot.waitUntil(lambda: window.sources.dialog is not None)
    dialog = window.sources.dialog
    qtbot.waitUntil(dialog.page.refresh.isEnabled)
    return dialog


def open_button(dialog):
    return dialog.buttons.button(QDialogButtonBox.StandardButton.Open)


def test_the_cameras_are_listed_and_guessed_by_their_model_and_one_twice_is_not_opened(window, finding, qtbot):
    finding(D405, L515)
    dialog = chooser(window, qtbot)
    first, second = cells(dialog.page.list)
    assert (first[1], first[3], second[1]) == ("d002", "USB 3.2", "f001")
    assert (dialog.page.proximity.currentData(), dialog.page.tactile.currentData()) == ("f001", "d002")
    assert dialog.note.text() == "2 cameras were found."
    assert dialog.name.text() == "cameras:f001,d002"
    dialog.page.tactile.setFocus()
    QTest.keyClick(dialog.page.tactile, Qt.Key.Key_Down)
    assert dialog.page.tactile.currentData() == "f001"
    assert "same camera" in dialog.note.text() and not open_button(dialog).isEnabled()
    QTest.keyClick(dialog.page.tactile, Qt.Key.Key_Up)
    QTest.mouseClick(open_button(dialog), LEFT)
    qtbot.waitUntil(lambda: window.opened_names == ["cameras:f001,d002"])
    cameras = window.document.preset.cameras
    assert (cameras.proximity.serial, cameras.tactile.serial) == ("f001", "d002")
    QTest.keyClick(dialog, Qt.Key.Key_Escape)
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow)
    QTest.keyClick(window, Qt.Key.Key_Z, CONTROL)
    assert window.document.preset.cameras.proximity.serial == ""


def test_a_tactile_camera_alone_and_ros_2_topics_are_opened_from_the_page(window, finding, qtbot):
    finding(D405)
    asked = []
    window.context.sourceRequested.connect(asked.append)
    dialog = chooser(window, qtbot)
    assert dialog.note.text().startswith("Only one camera was found") and not open_button(dialog).isEnabled()
    dialog.page.proximity.setFocus()
    QTest.keyClicks(dialog.page.proximity, "none")
    assert dialog.name.text() == "cameras:,d002"
    QTest.mouseClick(open_button(dialog), LEFT)
    qtbot.waitUntil(lambda: asked == ["cameras:,d002"])
    QTest.keyClick(dialog, Qt.Key.Key_Escape)
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow)
    dialog = chooser(window, qtbot)
    QTest.mouseClick(dialog.page.topics, LEFT)
    qtbot.waitUntil(lambda: asked[1:] == ["ros2:"])
    assert window.document.preset.cameras.tactile.serial == "d002"


@pytest.mark.parametrize(
    ("program", "words"),
    [
        ("print('{\"devices\": []}')", "No RealSense camera was found. Plug both cameras into USB 3 ports"),
        (
            'print(\'{"problem": "live cameras need the camera driver pyrealsense2, which is not installed"}\')',
            "Live cameras need the camera driver pyrealsense2, which is not installed.",
        ),
        ("import os; os.abort()", "The camera driver does not list its cameras (crashed (SIGABRT))"),
    ],
)
def test_what_is_wrong_is_said_with_what_to_do(window, answering, qtbot, program, words):
    answering(program)
    dialog = chooser(window, qtbot)
    qtbot.waitUntil(lambda: (dialog.note.text() or dialog.page.empty.text()).startswith(words))
    assert not open_button(dialog).isEnabled()


# Settings


@pytest.fixture
def panel(window, cameras, qtbot):
    QTest.keyClick(window, Qt.Key.Key_F4)
    made = window.cameras
    qtbot.waitUntil(lambda: made.isVisible() and len(made.rows) == 5)
    return made


def test_every_option_has_a_row_that_says_what_it_means(panel):
    row = panel.rows["tactile", "exposure"]
    assert row.label.text() == "Exposure"
    assert "Exposure time of the stereo images." in row.widget.toolTip()
    assert "µs" in row.widget.toolTip()
    assert row.widget.value() == 8500
    assert not panel.rows["tactile", "temperature"].widget.isEnabled()
    assert panel.rows["proximity", "visual_preset"].widget.currentText() == "Custom"
    assert isinstance(panel.rows["tactile", "enable_auto_exposure"].widget, QCheckBox)


def test_typed_numbers_and_other_presets_reach_the_cameras_and_are_undone(window, cameras, panel, preset, qtbot):
    type_into(panel.rows["tactile", "exposure"].widget.entry, "1234")
    qtbot.waitUntil(lambda: cameras.values["tactile", "exposure"] == 1234)
    assert window.document.preset.cameras.tactile.options == {"exposure": 1234.0}
    assert window.document.dirty
    window.document.undo_stack.undo()
    qtbot.waitUntil(lambda: cameras.values["tactile", "exposure"] == 8500)
    assert window.document.preset.cameras.tactile.options == {}
    qtbot.waitUntil(lambda: panel.rows["tactile", "exposure"].widget.value() == 8500)
    window.document.new(preset.with_value("cameras.proximity.options", {"laser_power": 12.0}))
    qtbot.waitUntil(lambda: cameras.values["proximity", "laser_power"] == 12)
    assert panel.rows["proximity", "laser_power"].widget.value() == 12


def test_a_refusal_is_said(window, cameras, panel, qtbot):
    cameras.refuses.add("exposure")
    type_into(panel.rows["tactile", "exposure"].widget.entry, "1234")
    qtbot.waitUntil(lambda: any("switch auto exposure off first" in said for said in window.messages.sentences()))
    assert cameras.values["tactile", "exposure"] == 8500


def test_changed_cameras_are_offered_to_be_opened_again(window, qtbot):
    cameras = FakeCameras()
    cameras.name = "cameras:f001,d002"
    cameras.release()
    show_source(qtbot, window, cameras)
    window.document.edit("cameras.tactile_delay_s", 0.1)
    press(window.messages.by_key.get("cameras"), "Open again")
    assert window.opened_names == ["cameras:"]
