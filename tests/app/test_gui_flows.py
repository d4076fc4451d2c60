"""Whole flows by real mouse and key events, as a person does them."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
from PyQt6.QtCore import QMimeData, QPoint, QPointF, Qt, QUrl
from PyQt6.QtGui import QDragEnterEvent, QDropEvent
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication, QFileDialog, QLineEdit, QMessageBox, QPushButton

from tactune.app.message_bar import Message
from tactune.app.recovery import Autosave
from tactune.app.worker import SourceRequest
from tactune.core.pipeline import ContactPipeline
from tactune.core.preset_file import load_preset, save_preset

from .conftest import HEIGHT, MEMBRANE_RGB, WIDTH, TinySource, at_rest, tiny_frame, tiny_rig

LEFT = Qt.MouseButton.LeftButton
CONTROL = Qt.KeyboardModifier.ControlModifier
CONTROL_SHIFT = CONTROL | Qt.KeyboardModifier.ShiftModifier


def drag_slider(slider, *fractions):
    """Press at the handle's place for the first fraction, move through the others, let go."""
    start, length = slider.travel()
    points = [QPoint(round(start + fraction * length), slider.height() // 2) for fraction in fractions]
    QTest.mousePress(slider, LEFT, pos=points[0])
    for point in points[1:]:
        QTest.mouseMove(slider, point)
    QTest.mouseRelease(slider, LEFT, pos=points[-1])


def tolerance_slider(window):
    slider = window.panel.rows["tolerance.t"].widget.slider
    window.panel.ensureWidgetVisible(slider)
    return slider


def shows_preset_of_document(window):
    return window.result is not None and window.result.preset is window.document.preset


def answer_question(qtbot, key):
    """Answer the question that is open, by its keyboard shortcut."""
    qtbot.waitUntil(lambda: isinstance(QApplication.activeModalWidget(), QMessageBox))
    box = QApplication.activeModalWidget()
    button = {
        "save": QMessageBox.StandardButton.Save,
        "discard": QMessageBox.StandardButton.Discard,
    }.get(key)
    if button is None:
        QTest.keyClick(box, Qt.Key.Key_Escape)
    else:
        QTest.mouseClick(box.button(button), LEFT)


def type_path(qtbot, path):
    """Paste a path into the file dialog that is open and press Enter."""
    qtbot.waitUntil(lambda: isinstance(QApplication.activeModalWidget(), QFileDialog))
    dialog = QApplication.activeModalWidget()
    entry = dialog.findChild(QLineEdit, "fileNameEdit")
    entry.selectAll()
    QApplication.clipboard().setText(str(path))
    QTest.keyClick(entry, Qt.Key.Key_V, CONTROL)
    suggestions = entry.completer().popup()
    if suggestions.isVisible():
        QTest.keyClick(suggestions, Qt.Key.Key_Escape)
    QTest.keyClick(entry, Qt.Key.Key_Return)


def drop(window, path):
    data = QMimeData()
    data.setUrls([QUrl.fromLocalFile(str(path))])
    place, action, none = QPointF(200, 200), Qt.DropAction.CopyAction, Qt.KeyboardModifier.NoModifier
    enter = QDragEnterEvent(place.toPoint(), action, data, LEFT, none)
    QApplication.sendEvent(window, enter)
    assert enter.isAccepted()
    QApplication.sendEvent(window, QDropEvent(place, action, data, LEFT, none))


def test_a_typed_value_is_undone_while_its_entry_has_the_focus(window, qtbot):
    before = window.document.preset
    entry = window.panel.rows["tolerance.t"].widget.entry
    window.activateWindow()
    entry.setFocus()
    entry.selectAll()
    QTest.keyClicks(entry, "0.05")
    QTest.keyClick(entry, Qt.Key.Key_Return)
    assert window.document.preset.tolerance.t == 0.05
    assert QApplication.focusWidget() is entry
    QTest.keyClick(entry, Qt.Key.Key_Z, CONTROL)
    assert window.document.preset is before


def test_drag_a_slider_then_undo_and_redo(window, qtbot):
    before = window.document.preset
    points_before = len(window.result.patch.points)
    drag_slider(tolerance_slider(window), 0.6, 0.7, 0.8, 0.95)
    qtbot.waitUntil(lambda: shows_preset_of_document(window))
    t = window.document.preset.tolerance.t
    assert t > 0.1
    assert len(window.result.patch.points) > points_before
    assert window.document.undo_stack.count() == 1
    assert window.isWindowModified()
    assert window.toolbar.preset.text() == "Preset: tiny *"

    QTest.keyClick(window, Qt.Key.Key_Z, CONTROL)
    assert window.document.preset is before
    assert window.panel.rows["tolerance.t"].editor.value() == before.tolerance.t
    assert not window.isWindowModified()
    qtbot.waitUntil(lambda: shows_preset_of_document(window))
    assert len(window.result.patch.points) == points_before
    QTest.keyClick(window, Qt.Key.Key_Z, CONTROL_SHIFT)
    assert window.document.preset.tolerance.t == t


def test_type_a_number(window, qtbot):
    entry = window.panel.rows["tolerance.t"].widget.entry
    window.panel.ensureWidgetVisible(entry)
    QTest.mouseClick(entry, LEFT, pos=QPoint(8, entry.height() // 2))
    qtbot.waitUntil(entry.hasFocus)
    entry.selectAll()
    QTest.keyClicks(entry, "0.05")
    QTest.keyClick(entry, Qt.Key.Key_Return)
    assert window.document.preset.tolerance.t == 0.05
    assert window.document.undo_stack.undoText() == "Tolerance t 0.05"


def test_eyedropper_takes_the_membrane_s_colour_as_one_step(window, qtbot):
    before = window.document.preset
    enable = window.panel.rows["mask.enabled"].widget
    window.panel.ensureWidgetVisible(enable)
    QTest.mouseClick(enable, LEFT, pos=QPoint(8, enable.height() // 2))
    assert window.document.preset.mask.enabled
    pick = window.panel._eyedroppers["set"]
    QTest.mouseClick(pick, LEFT)
    assert window.eyedropper.mode == "set"
    pane = window.strip.panes["color"]
    place = pane.widget_position(8, 8).toPoint()
    QTest.mouseMove(pane.view.viewport(), place)
    QTest.mouseClick(pane.view.viewport(), LEFT, pos=place)
    mask = window.document.preset.mask
    assert mask.hue[0] <= 115 <= mask.hue[1], f"the hue of {MEMBRANE_RGB} is 115"
    assert mask.hue[1] - mask.hue[0] < 30
    assert window.document.undo_stack.count() == 2
    qtbot.waitUntil(lambda: shows_preset_of_document(window))
    assert len(window.result.patch.points) > 0, "the object's red is not masked"
    QTest.keyClick(window.panel, Qt.Key.Key_Escape)
    assert window.eyedropper.mode == "off"
    window.document.undo_stack.undo()
    window.document.undo_stack.undo()
    assert window.document.preset is before


def test_hovering_says_why_a_pixel_was_kept(window, qtbot):
    pane = window.strip.panes["difference"]
    QTest.mouseMove(pane.view.viewport(), pane.widget_position(WIDTH // 2, HEIGHT // 2).toPoint())
    qtbot.waitUntil(lambda: "Kept" in window.strip._readout.text())
    text = window.strip._readout.text()
    assert f"({WIDTH // 2}, {HEIGHT // 2})" in text
    assert "dp 0.252" in text
    assert "dt 0.250" in text
    QTest.mouseMove(pane.view.viewport(), pane.widget_position(2, 2).toPoint())
    qtbot.waitUntil(lambda: "Dropped" in window.strip._readout.text())


def test_save_reopen_same_values(window, qtbot, tmp_path, make_window):
    drag_slider(tolerance_slider(window), 0.6, 0.3)
    window.document.edit("mask.hue", (170, 10))
    tuned = window.document.preset
    path = tmp_path / "tuned.json"
    QTest.keyClick(window, Qt.Key.Key_S, CONTROL)
    type_path(qtbot, path)
    qtbot.waitUntil(lambda: not window.document.dirty)
    assert load_preset(path).tolerance == tuned.tolerance

    second = make_window()
    QTest.keyClick(second, Qt.Key.Key_O, CONTROL)
    type_path(qtbot, path)
    qtbot.waitUntil(lambda: second.document.path == path)
    assert second.document.preset.tolerance == tuned.tolerance
    assert second.document.preset.mask == tuned.mask
    assert second.panel.rows["mask.hue"].editor.value() == (170, 10)
    assert str(path) in second.settings.recent("presets")


def test_saving_again_asks_nothing(window, qtbot, tmp_path):
    path = tmp_path / "mine.json"
    window.document.save(path)
    window.document.edit("tolerance.t", 0.02)
    QTest.keyClick(window, Qt.Key.Key_S, CONTROL)
    assert QApplication.activeModalWidget() is None
    assert load_preset(path).tolerance.t == 0.02


def test_pause_step_and_seek(window, qtbot):
    state = window.transport.state
    assert not state.playing
    QTest.keyClick(window, Qt.Key.Key_Period)
    qtbot.waitUntil(lambda: at_rest(window, 4))
    QTest.keyClick(window, Qt.Key.Key_Comma)
    qtbot.waitUntil(lambda: at_rest(window, 3))
    drag_slider(window.transport.slider, 0.5, 1.0)
    qtbot.waitUntil(lambda: at_rest(window, 7))
    assert window.result.frame.sequence == 7
    QTest.keyClick(window, Qt.Key.Key_Space)
    qtbot.waitUntil(lambda: window.transport.state.playing)
    processed = window.result.processed
    qtbot.waitUntil(lambda: window.result.processed > processed + 5)
    QTest.keyClick(window, Qt.Key.Key_F)
    qtbot.waitUntil(lambda: window.transport.state.frozen)
    QTest.keyClick(window, Qt.Key.Key_Space)
    qtbot.waitUntil(lambda: not window.transport.state.frozen and window.transport.state.playing)


def test_the_space_bar_in_an_entry_stays_there(window, qtbot):
    entry = window.panel.rows["tolerance.t"].widget.entry
    window.panel.ensureWidgetVisible(entry)
    QTest.mouseClick(entry, LEFT, pos=QPoint(8, entry.height() // 2))
    qtbot.waitUntil(entry.hasFocus)
    QTest.keyClicks(entry, ".")
    assert at_rest(window, 3)


@pytest.mark.parametrize("suffix", ["ply", "pcd", "npz", "csv"])
def test_export_writes_a_readable_file(window, qtbot, tmp_path, suffix):
    path = tmp_path / f"patch.{suffix}"
    QTest.keyClick(window, Qt.Key.Key_E, CONTROL)
    type_path(qtbot, path)
    qtbot.waitUntil(path.exists)
    qtbot.waitUntil(lambda: any(str(path) in sentence for sentence in window.messages.sentences()))
    count = len(window.result.patch.points)
    assert count > 0
    if suffix == "npz":
        np.testing.assert_array_equal(np.load(path)["points"], window.result.patch.points)
    elif suffix == "csv":
        assert len(list(csv.reader(path.read_text().splitlines()))) == count + 1
    else:
        head = path.read_bytes()[:400].decode("latin-1")
        assert f"element vertex {count}" in head or f"POINTS {count}" in head


def test_export_to_an_unknown_format_is_said(window, qtbot, tmp_path):
    QTest.keyClick(window, Qt.Key.Key_E, CONTROL)
    type_path(qtbot, tmp_path / "patch.doc")
    qtbot.waitUntil(lambda: any(".doc" in sentence for sentence in window.messages.sentences()))


def test_drop_a_preset(window, qtbot, preset, tmp_path):
    path = tmp_path / "dropped.json"
    save_preset(preset.with_values({"name": "dropped", "tolerance.t": 0.011}), path)
    drop(window, path)
    qtbot.waitUntil(lambda: window.document.path == path)
    assert window.document.preset.tolerance.t == 0.011
    assert window.toolbar.preset.text() == "Preset: dropped"


def test_drop_a_recording(window, qtbot, tmp_path):
    from tactune.core.sources.folder import export_folder

    export_folder(TinySource(length=2), tmp_path / "recording")
    drop(window, tmp_path / "recording")
    qtbot.waitUntil(lambda: window.result is not None and window.result.source.name.startswith("folder:"))
    assert window.result.source.length == 2
    assert "recording" in window.toolbar.source.text()


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("notes.txt", "hello", "neither a preset"),
        ("broken.json", "{", "not valid JSON"),
        ("other.json", json.dumps({"schema": "other"}), "no preset"),
        ("empty.bag", "", "empty.bag"),
    ],
)
def test_drop_a_wrong_file_changes_nothing(window, qtbot, tmp_path, name, content, words):
    before, source = window.document.preset, window.result.source
    path = tmp_path / name
    path.write_text(content)
    drop(window, path)
    qtbot.waitUntil(lambda: any(words in sentence for sentence in window.messages.sentences()))
    assert window.document.preset is before
    window.worker.seek(4)
    qtbot.waitUntil(lambda: at_rest(window, 4))
    assert window.result.source is source


def test_drop_a_folder_that_is_no_recording(window, qtbot, tmp_path):
    (tmp_path / "holiday").mkdir()
    drop(window, tmp_path / "holiday")
    qtbot.waitUntil(lambda: any("holiday" in sentence for sentence in window.messages.sentences()))
    assert window.result.source.name == "tiny"


def test_closing_asks_and_cancel_keeps_the_window(window, qtbot):
    window.document.edit("tolerance.t", 0.02)
    window.close()
    answer_question(qtbot, "cancel")
    assert window.isVisible()
    assert window.worker.isRunning()
    assert window.document.dirty


def test_closing_and_discarding(window, qtbot):
    window.document.edit("tolerance.t", 0.02)
    window.close()
    answer_question(qtbot, "discard")
    qtbot.waitUntil(lambda: not window.isVisible())
    assert window.worker.isFinished()
    assert not window.autosave.file.exists()


def test_closing_and_saving(window, qtbot, tmp_path):
    path = tmp_path / "mine.json"
    window.document.edit("tolerance.t", 0.02)
    window.close()
    answer_question(qtbot, "save")
    type_path(qtbot, path)
    qtbot.waitUntil(lambda: not window.isVisible())
    assert load_preset(path).tolerance.t == 0.02
    assert load_preset(path).name == "tiny"


def test_cancelling_the_save_of_a_close_keeps_the_window(window, qtbot):
    window.document.edit("tolerance.t", 0.02)
    window.close()
    answer_question(qtbot, "save")
    qtbot.waitUntil(lambda: isinstance(QApplication.activeModalWidget(), QFileDialog))
    QTest.keyClick(QApplication.activeModalWidget(), Qt.Key.Key_Escape)
    qtbot.waitUntil(lambda: QApplication.activeModalWidget() is None)
    assert window.isVisible()
    assert window.document.dirty


def test_a_new_preset_asks_too_and_takes_no_name_of_a_shipped_one(window, qtbot):
    window.document.edit("tolerance.t", 0.02)
    QTest.keyClick(window, Qt.Key.Key_N, CONTROL)
    answer_question(qtbot, "discard")
    qtbot.waitUntil(lambda: window.document.preset.name == "untitled")
    assert window.document.path is None
    assert window.document.preset.tolerance == load_preset("default").tolerance
    assert not window.document.dirty


def test_the_patch_on_the_screen_is_the_pipeline_s_bit_for_bit(window, qtbot):
    drag_slider(tolerance_slider(window), 0.6, 0.75)
    qtbot.waitUntil(lambda: shows_preset_of_document(window))
    patch = ContactPipeline(window.document.preset, tiny_rig()).process(tiny_frame(3, tiny_rig()))
    np.testing.assert_array_equal(window.result.patch.points, patch.points)
    np.testing.assert_array_equal(window.result.patch.provenance, patch.provenance)


def offer(window) -> Message:
    message = window.messages.message("recovery")
    assert message is not None
    return message


def press(message: Message, text: str) -> None:
    [button] = [button for button in message.findChildren(QPushButton) if button.text() == text]
    QTest.mouseClick(button, LEFT)


@pytest.fixture
def crashed(qtbot, preset, tmp_path):
    """What a window leaves that died with unsaved changes."""
    from tactune.app.document import Document

    document = Document(preset)
    autosave = Autosave(document, tmp_path / "unsaved")
    document.edit("tolerance.t", 0.0123)
    autosave.flush()
    autosave.close(keep=True)
    return autosave.file


def test_after_a_crash_unsaved_work_is_offered_and_restored(crashed, window, qtbot):
    window.offer_unsaved_work()
    press(offer(window), "Restore")
    assert window.document.preset.tolerance.t == 0.0123
    assert window.document.dirty
    qtbot.waitUntil(lambda: not crashed.exists())
    assert window.messages.message("recovery") is None
    qtbot.waitUntil(window.autosave.file.exists)


def test_after_a_crash_unsaved_work_can_be_discarded(crashed, window, preset):
    window.offer_unsaved_work()
    press(offer(window), "Discard")
    assert window.document.preset == preset
    assert not crashed.exists()


def test_a_source_that_fails_on_the_way_is_said_and_can_be_played_on(make_window, qtbot):
    window = make_window()
    window.open_request(SourceRequest("tiny", lambda progress: TinySource(broken=frozenset({2}))))
    qtbot.waitUntil(lambda: "tiny: frame 2 is damaged; skip it" in window.messages.sentences())
    qtbot.waitUntil(lambda: not window.transport.state.playing)
    window.worker.seek(3)
    qtbot.waitUntil(lambda: at_rest(window, 3))


def test_naming_a_preset_is_one_step(window, qtbot):
    QTest.keyClick(window, Qt.Key.Key_F2)
    qtbot.waitUntil(lambda: QApplication.activeModalWidget() is not None)
    dialog = QApplication.activeModalWidget()
    entry = dialog.findChild(QLineEdit)
    entry.selectAll()
    QTest.keyClicks(entry, "green membrane")
    QTest.keyClick(entry, Qt.Key.Key_Return)
    qtbot.waitUntil(lambda: window.document.preset.name == "green membrane")
    assert window.toolbar.preset.text() == "Preset: green membrane *"
    assert window.document.undo_stack.count() == 1
    window.document.undo_stack.undo()
    assert window.document.preset.name == "tiny"


def test_a_saved_preset_knows_the_rig_it_was_tuned_on(window, qtbot, tmp_path):
    assert window.document.preset.rig is None
    QTest.keyClick(window, Qt.Key.Key_S, CONTROL_SHIFT)
    type_path(qtbot, tmp_path / "mine.json")
    qtbot.waitUntil(lambda: window.document.path is not None)
    assert load_preset(tmp_path / "mine.json").rig == tiny_rig()
    qtbot.waitUntil(lambda: shows_preset_of_document(window))
    assert window.result.warnings == ()
