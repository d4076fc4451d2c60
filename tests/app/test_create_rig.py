"""*Create rig…*: a folder of images without ``rig.json`` becomes a source, with typed, fitted or read lenses."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QLineEdit

from hands import CONTROL, LEFT, drop, press, type_into
from tactune.app.sources import camera_form
from tactune.app.sources.search import CameraSearch
from tactune.core.model.rig_file import load_rig
from tactune.core.sources.folder import export_folder
from tactune.core.sources.presets import load_preset
from tiny_sensor import TinySource, tiny_rig

REAL_PRESET = Path(__file__).resolve().parents[1] / "data" / "real_pair.json"


@pytest.fixture
def bare(tmp_path):
    """A folder of tiny images without a rig."""
    folder = tmp_path / "bare"
    export_folder(TinySource(length=2), folder)
    (folder / "rig.json").unlink()
    return folder


def type_lens(form, lens, unit_m):
    type_into(form.unit, f"{1e3 * unit_m:g}", Qt.Key.Key_Tab)
    for name, entry in form.entries.items():
        type_into(entry, f"{lens[name]:.10g}", Qt.Key.Key_Tab)


def rig_dialog(window, qtbot, folder):
    """Drop the folder, and take the message's offer."""
    drop(window, folder)
    qtbot.waitUntil(lambda: window.messages.message("source") is not None)
    press(window.messages.message("source"), "Create rig…")
    qtbot.waitUntil(lambda: window.sources.rig_dialog is not None and window.sources.rig_dialog.isVisible())
    return window.sources.rig_dialog


def shows(window, folder):
    return window.result is not None and window.result.source.name == f"folder:{folder}"


def fill(dialog):
    """Type the tiny rig."""
    rig = tiny_rig()
    for key in ("proximity", "tactile"):
        camera = getattr(rig, key)
        type_lens(dialog.forms[key], camera.intrinsics.model_dump(), camera.depth_unit_m)


def test_a_real_pair_without_rig_is_typed_and_shows_a_patch(make_window, qtbot, shared_data, tmp_path):
    folder = tmp_path / "pair"
    shutil.copytree(shared_data / "real_pair", folder)
    typed = json.loads((folder / "rig.json").read_text())
    (folder / "rig.json").unlink()
    pose = {"alignment.rigid.T_proximity_tactile": typed["T_proximity_tactile"]}
    window = make_window(load_preset(REAL_PRESET).with_values(pose))
    QTest.keyClick(window, Qt.Key.Key_O, CONTROL)
    qtbot.waitUntil(lambda: window.sources.dialog is not None)
    dialog = window.sources.dialog
    type_into(dialog.name, f"folder:{folder}")
    qtbot.waitUntil(dialog.create_rig.isVisible)
    assert "rig.json" in dialog.note.text()
    QTest.mouseClick(dialog.create_rig, LEFT)
    rig = window.sources.rig_dialog
    qtbot.waitUntil(rig.isVisible)
    assert "proximity_depth.png 1280 x 720" in rig.found.text()
    for key in ("proximity", "tactile"):
        type_lens(rig.forms[key], typed[key], typed[key]["depth_unit_m"])
    QTest.mouseClick(rig.write, LEFT)
    qtbot.waitUntil(lambda: shows(window, folder) and window.result.patch is not None)
    assert window.sources.dialog is None
    assert len(window.result.patch.points) > 300_000
    written = load_rig(folder / "rig.json")
    assert written.tactile.intrinsics.fx == typed["tactile"]["fx"]


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda file: file.unlink(), "is missing"),
        (
            lambda file: cv2.imwrite(str(file), np.zeros((4, 6), np.uint16)),
            "has 6 x 4 pixels, in the first frame 64 x 48",
        ),
    ],
)
def test_a_later_frame_that_differs_is_told(window, qtbot, bare, spoil, words):
    file = bare / "000001" / "tactile_depth.png"
    spoil(file)
    dialog = rig_dialog(window, qtbot, bare)
    assert f"Not all frames can be read: {file} {words}." in dialog.found.text()
    assert dialog.write.isEnabled(), "the other frames can be"


def test_the_message_of_the_window_offers_it(window, qtbot, bare):
    dialog = rig_dialog(window, qtbot, bare)
    assert "2 frames" in dialog.found.text()
    fill(dialog)
    QTest.keyClick(dialog.forms["tactile"].coefficients, Qt.Key.Key_Return)
    qtbot.waitUntil(lambda: shows(window, bare))
    rig = load_rig(bare / "rig.json")
    assert rig.proximity.intrinsics.fx == pytest.approx(tiny_rig().proximity.intrinsics.fx)
    assert rig.proximity.depth_unit_m == tiny_rig().proximity.depth_unit_m
    assert (rig.proximity.model, rig.tactile.model) == ("L515", "D405")


WRONG_VALUES = [
    ("fx", "", "Tactile camera, 64 x 48: fx is empty; enter a number"),
    ("fx", "abc", "fx is 'abc', but it must be a number"),
    ("fx", "-3", "tactile.fx is -3"),
    ("fx", "1", "a view of 176 degrees over 64 px"),
    ("cx", "900", "cx is 900 px, far from the centre of 64 px"),
    ("cy", "nan", "tactile.cy"),
]


def test_a_wrong_value_is_said_and_nothing_is_written(window, qtbot, bare):
    dialog = rig_dialog(window, qtbot, bare)
    for field, text, words in WRONG_VALUES:
        fill(dialog)
        entry: QLineEdit = dialog.forms["tactile"].entries[field]
        entry.selectAll()
        QTest.keyClick(entry, Qt.Key.Key_Delete)
        QTest.keyClicks(entry, text)
        QTest.mouseClick(dialog.write, LEFT)
        assert words in dialog.note.text()
        assert dialog.isVisible()
        assert not (bare / "rig.json").exists()


def test_a_folder_that_lacks_an_image_says_which(window, qtbot, bare):
    (bare / "000000" / "tactile_depth.png").unlink()
    dialog = rig_dialog(window, qtbot, bare)
    assert "tactile_depth.png is missing" in dialog.note.text()
    assert not dialog.write.isEnabled()


@pytest.mark.parametrize(
    ("name", "image", "words"),
    [
        ("proximity_color.png", np.zeros((48, 64), np.uint8), "proximity_color.png is no PNG image of 3 x 8 bits"),
        ("proximity_depth.png", None, "proximity_depth.png is no PNG image of 1 x 16 bits"),
    ],
)
def test_an_image_of_another_form_is_said_before_a_rig_is_written(window, qtbot, bare, name, image, words):
    data = b"" if image is None else cv2.imencode(".png", image)[1].tobytes()
    (bare / "000000" / name).write_bytes(data)
    dialog = rig_dialog(window, qtbot, bare)
    assert words in dialog.note.text()
    assert not dialog.write.isEnabled()


def test_nominal_values_say_that_they_are_nominal(window, qtbot, bare):
    form = rig_dialog(window, qtbot, bare).forms["tactile"]
    QTest.mouseClick(form.nominal, LEFT, delay=1)
    qtbot.waitUntil(form.nominal_menu.isVisible)
    QTest.keyClick(form.nominal_menu, Qt.Key.Key_Down)
    QTest.keyClick(form.nominal_menu, Qt.Key.Key_Return)
    assert form.origin.text().startswith("Nominal values of the D405 depth lens, not measured")
    assert float(form.entries["fx"].text()) == pytest.approx(43.3, abs=0.1)  # 48 / 2 / tan(58 / 2 degrees)
    form.model.setCurrentText("Other")
    assert not form.nominal.isEnabled()


def test_a_lens_is_read_from_a_connected_camera(window, qtbot, bare, monkeypatch):
    lens = {"kind": "depth", "depth_unit_m": 0.0002, "width": 64, "height": 48, "fx": 50.5, "fy": 51.5}
    lens |= {"cx": 31.0, "cy": 23.0, "distortion": "brown_conrady", "coefficients": [0.1, 0.0, 0.0, 0.0, 0.0]}
    camera = {"model": "D405", "serial": "d2", "lenses": [lens, lens | {"width": 640}]}
    answer = json.dumps({"devices": [camera]})
    monkeypatch.setattr(
        camera_form, "CameraSearch", lambda parent, _: CameraSearch(parent, ["-c", f"print({answer!r})"])
    )
    form = rig_dialog(window, qtbot, bare).forms["tactile"]
    QTest.mouseClick(form.from_camera, LEFT)
    qtbot.waitUntil(form.from_camera.isEnabled)
    assert [entry.text() for entry in form.camera_menu.actions()] == ["D405 (serial d2), depth"]
    QTest.keyClick(form.camera_menu, Qt.Key.Key_Down)
    QTest.keyClick(form.camera_menu, Qt.Key.Key_Return)
    assert form.values() == {key: value for key, value in lens.items() if key != "kind"} | {"model": "D405"}
    assert "serial d2" in form.origin.text()


def test_a_lens_is_fitted_to_pictures_of_a_chessboard(make_window, qtbot, shared_data, tmp_path):
    folder = tmp_path / "boards"
    folder.mkdir()
    for path in (shared_data / "stereo_boards").glob("left*.jpg"):
        shutil.copy(path, folder)
    form = camera_form.CameraForm("Camera", (640, 480), "D405", native_dialogs=False)
    qtbot.addWidget(form)
    form.show()
    QTest.mouseClick(form.from_pictures, LEFT)
    dialog = form.chessboard
    qtbot.waitUntil(dialog.isVisible)
    dialog.columns.setFocus()
    dialog.columns.selectAll()
    QTest.keyClicks(dialog.columns, "8")
    type_into(dialog.folder, str(folder))
    qtbot.waitUntil(lambda: "in 0 of 6 pictures" in dialog.note.text())
    dialog.columns.selectAll()
    QTest.keyClicks(dialog.columns, "9")
    QTest.mouseClick(dialog.fit, LEFT)
    qtbot.waitUntil(lambda: dialog.note.text().startswith("6 of 6 pictures, 0.19 px RMS"))
    QTest.keyClick(dialog, Qt.Key.Key_Return)
    assert float(form.entries["fx"].text()) == pytest.approx(535.9, rel=0.01)  # OpenCV's own, left_intrinsics.yml
    assert form.origin.text().startswith("From 6 pictures of a chessboard, 0.19 px RMS")
