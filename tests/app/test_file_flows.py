"""Files in the window: presets, recordings with presets, unsaved changes and exports."""

import csv
import json

import cv2
import numpy as np
import pytest
from PIL import Image
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication, QFileDialog

from fakes import FakeSource, at_rest, tiny_rig
from hands import (
    CONTROL,
    CONTROL_SHIFT,
    answer_question,
    drag_slider,
    drop,
    shows_preset_of_document,
    tolerance_slider,
    type_path,
)
from tactune.app.window.animation import _pixels
from tactune.core.sources.presets import load_preset


def test_save_reopen_same_values(window, qtbot, tmp_path, make_window):
    drag_slider(tolerance_slider(window), 0.6, 0.3)
    window.document.edit("mask.hue", (170, 10))
    tuned = window.document.preset
    assert tuned.rig is None
    path = tmp_path / "tuned.json"
    QTest.keyClick(window, Qt.Key.Key_S, CONTROL)
    type_path(qtbot, path)
    qtbot.waitUntil(lambda: not window.document.dirty)
    assert load_preset(path).tolerance == tuned.tolerance
    assert load_preset(path).rig == tiny_rig(), "a saved preset knows the rig it was tuned on"
    qtbot.waitUntil(lambda: shows_preset_of_document(window))
    assert window.result.warnings == ()

    second = make_window()
    QTest.keyClick(second, Qt.Key.Key_O, CONTROL_SHIFT)
    type_path(qtbot, path)
    qtbot.waitUntil(lambda: second.document.path == path)
    assert second.document.preset.tolerance == tuned.tolerance
    assert second.document.preset.mask == tuned.mask
    assert second.panel.rows["mask.hue"].editor.value() == (170, 10)
    assert str(path) in second.settings.recent("presets")


def test_export_writes_a_readable_file(window, qtbot, tmp_path):
    path = tmp_path / "patch.csv"
    QTest.keyClick(window, Qt.Key.Key_E, CONTROL)
    type_path(qtbot, path)
    qtbot.waitUntil(path.exists)
    qtbot.waitUntil(lambda: any(str(path) in sentence for sentence in window.messages.sentences()))
    count = len(window.result.patch.points)
    assert count > 0
    assert len(list(csv.reader(path.read_text().splitlines()))) == count + 1


@pytest.mark.parametrize("suffix", [".gif", ".mp4"])
def test_an_animation_shows_the_views_of_the_marked_frames(window, qtbot, tmp_path, suffix):
    window.worker.pause()
    window.worker.seek(4)
    qtbot.waitUntil(lambda: at_rest(window, 4))
    window.context.trim = (1, 4)
    path = tmp_path / f"views{suffix}"
    QTest.keyClick(window, Qt.Key.Key_E, CONTROL)
    type_path(qtbot, path)
    frames = "1 to 1 (1)" if suffix == ".gif" else "1 to 3 (3)"
    qtbot.waitUntil(lambda: f"Frames {frames} written to {path}." in window.messages.sentences())
    qtbot.waitUntil(lambda: at_rest(window, 4))
    if suffix == ".gif":
        with Image.open(path) as shown:
            assert shown.n_frames == 1  # ten pictures a second of thirty frames
            assert shown.size[0] <= 900
    else:
        video = cv2.VideoCapture(str(path))
        pictures = [video.read()[1] for _ in range(3)]
        assert not video.read()[0]
        assert abs(pictures[0].shape[1] - window.views.width()) < 2
        window.worker.seek(3)
        qtbot.waitUntil(lambda: at_rest(window, 3) and window.result.playback.index == 3)
        shown = _pixels(window.views.picture().toImage(), None)[:, :, ::-1].astype(int)
        near = [np.abs(picture.astype(int) - shown).mean() for picture in pictures]
        assert np.argmin(near) == 2 and near[2] < 6


def test_a_cancelled_animation_leaves_no_file(window, qtbot, tmp_path):
    QTest.keyClick(window, Qt.Key.Key_E, CONTROL)
    type_path(qtbot, tmp_path / "views.mp4")
    qtbot.waitUntil(window.export_bar.isVisible)
    window.export_bar.cancel.click()
    qtbot.waitUntil(lambda: "Export cancelled." in window.messages.sentences())
    assert not list(tmp_path.glob("*.mp4"))


def test_another_recording_ends_an_animation_with_a_sentence(window, qtbot, tmp_path):
    from tactune.core.sources.folder import export_folder

    export_folder(FakeSource(length=2), tmp_path / "recording")
    QTest.keyClick(window, Qt.Key.Key_E, CONTROL)
    type_path(qtbot, tmp_path / "views.mp4")
    qtbot.waitUntil(window.export_bar.isVisible)
    QTest.keyClick(window, Qt.Key.Key_E, CONTROL)
    type_path(qtbot, tmp_path / "second.gif")
    qtbot.waitUntil(lambda: any("export is running" in each for each in window.messages.sentences()))
    drop(window, tmp_path / "recording")
    qtbot.waitUntil(lambda: any("Another source" in each for each in window.messages.sentences()))
    assert not list(tmp_path.glob("*.mp4"))
    assert window.result.source.name == f"folder:{tmp_path / 'recording'}" and window.result.source.length == 2
    assert "recording" in window.mode_bar.source.text()


def test_the_calibration_is_exported_by_the_same_dialog(window, qtbot, tmp_path):
    for name, start in (("a.urdf", b"<?xml"), ("a.launch.yaml", b"# ros2"), ("a.camchain.yaml", b"cam0")):
        window.activateWindow()
        qtbot.waitUntil(window.isActiveWindow)
        QTest.keyClick(window, Qt.Key.Key_E, CONTROL)
        type_path(qtbot, tmp_path / name)
        qtbot.waitUntil((tmp_path / name).exists)
        assert (tmp_path / name).read_bytes().startswith(start)
        qtbot.waitUntil(lambda name=name: any(name in sentence for sentence in window.messages.sentences()))
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow)
    QTest.keyClick(window, Qt.Key.Key_E, CONTROL)
    type_path(qtbot, tmp_path / "a.obj")
    qtbot.waitUntil(lambda: any("does not say what to export" in each for each in window.messages.sentences()))


WRONG_FILES = [
    ("notes.txt", "hello", "neither a preset"),
    ("broken.json", "{", "not valid JSON"),
    ("other.json", json.dumps({"schema": "other"}), "no preset"),
    ("empty.bag", "", "empty.bag"),
]


def test_drop_a_wrong_file_changes_nothing(window, qtbot, tmp_path):
    before, source = window.document.preset, window.result.source
    for name, content, words in WRONG_FILES:
        (tmp_path / name).write_text(content)
        drop(window, tmp_path / name)
        qtbot.waitUntil(lambda words=words: any(words in sentence for sentence in window.messages.sentences()))
        assert window.document.preset is before
    window.worker.seek(4)
    qtbot.waitUntil(lambda: at_rest(window, 4))
    assert window.result.source is source


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
    assert load_preset(path).name == "mine"


def test_a_new_preset_asks_too_and_takes_no_name_of_a_shipped_one(window, qtbot):
    window.document.edit("tolerance.t", 0.02)
    QTest.keyClick(window, Qt.Key.Key_N, CONTROL)
    answer_question(qtbot, "discard")
    qtbot.waitUntil(lambda: window.document.preset.name == "untitled")
    assert window.document.path is None
    assert window.document.preset.tolerance == load_preset("default").tolerance
    assert not window.document.dirty


def test_a_shipped_preset_is_saved_under_a_name_of_ones_own(window, qtbot):
    window.document.new(load_preset("simulator"))
    QTest.keyClick(window, Qt.Key.Key_S, CONTROL)
    qtbot.waitUntil(lambda: isinstance(QApplication.activeModalWidget(), QFileDialog))
    [path] = QApplication.activeModalWidget().selectedFiles()
    QTest.keyClick(QApplication.activeModalWidget(), Qt.Key.Key_Escape)
    assert path.endswith("/my-simulator.json")
