"""The main window: its contents, saved state and messages."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from PyQt6.QtCore import QByteArray, QRect, QSize, Qt, QTimer
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication, QDialog, QPushButton, QScrollArea, QWidget

from fakes import FakeSource, at_rest, tiny_frame, tiny_rig
from hands import show_source, text_of
from tactune.app.settings import Settings
from tactune.app.worker.results import CloudName, ColorBy
from tactune.app.worker.worker import SourceRequest
from tactune.core.errors import SourceError
from tactune.core.model.provenance import Provenance
from tactune.widgets.basics.colormaps import patch_lut
from tactune.widgets.basics.dialogs import room_on
from tactune.widgets.basics.theme import theme_name
from tactune.widgets.clouds.cloud_labels import LegendLine

LEFT = Qt.MouseButton.LeftButton
CONTROL = Qt.KeyboardModifier.ControlModifier


class OneCameraSource(FakeSource):
    """What a recording with one depth camera gives: no tactile depth anywhere."""

    def __init__(self, rig):
        super().__init__(rig=rig)
        self.name = "one camera"

    def read(self, index):
        frame = tiny_frame(index, self.rig)
        return replace(frame, tactile_depth=np.zeros_like(frame.tactile_depth))


def test_shows_every_part_of_a_frame(window):
    views = window.views.views
    assert views[CloudName.PATCH].point_count() == len(window.result.patch.points) > 0
    assert views[CloudName.PROXIMITY].point_count() == views[CloudName.TACTILE].point_count() == 64 * 48
    status = text_of(window.status)
    assert "tiny" in status
    assert f"patch {window.result.area_mm2 / 100:.1f} cm²" in status
    assert window.transport.position.text() == "frame 4 of 8"


def test_says_which_stage_dropped_everything(window, qtbot):
    view = window.views.views[CloudName.PATCH]
    passed = view.point_count()
    window.document.edit("mask.enabled", True)
    qtbot.waitUntil(lambda: view.message() != "")
    assert view.message().startswith(f"{passed:,} points passed the contact test, but the mask dropped all: correct if")


def test_one_camera_says_that_there_is_no_contact_to_find(make_window, qtbot):
    rig = tiny_rig()
    nobody = rig.proximity.model_copy(update={"model": "none", "serial": ""})
    alone = rig.model_copy(update={"tactile": nobody})
    window = make_window()
    show_source(qtbot, window, OneCameraSource(rig=alone))
    views = window.views.views
    qtbot.waitUntil(lambda: views[CloudName.TACTILE].message() == "This recording has no tactile camera")
    assert views[CloudName.PATCH].message() == "One camera only: no contact can be found"
    assert views[CloudName.PROXIMITY].message() == ""
    show_source(qtbot, window, FakeSource())
    qtbot.waitUntil(lambda: views[CloudName.PATCH].point_count() > 0)
    assert {view.message() for view in views.values()} == {""}


def test_hidden_parts_are_not_drawn(window, qtbot):
    window.actions_.show_tactile.trigger()
    window.actions_.show_strip.trigger()
    window.actions_.show_panel.trigger()
    assert window.views.views[CloudName.TACTILE].isHidden()
    assert window.strip.isHidden()
    qtbot.waitUntil(lambda: CloudName.TACTILE not in window.result.rendered.clouds)
    qtbot.waitUntil(lambda: window.result.rendered.strip is None and window.result.rendered.histogram is None)
    window.actions_.show_strip.trigger()
    qtbot.waitUntil(lambda: window.result.rendered.strip is not None)


def test_colours_have_a_legend(window, qtbot):
    legends = {
        ColorBy.DEPTH: [" m", "not touching"],
        ColorBy.DIFFERENCE: ["−3.0%", "below 0", "+3.0%"],
        ColorBy.PROVENANCE: ["contact", "not touching"],
        ColorBy.CONTACT: ["contact", "not touching"],
    }
    assert set(legends) == set(ColorBy)

    def explained(expected):
        words = "|".join(text for text, _ in window.views.views[CloudName.PATCH].legend())
        return all(word in words for word in expected)

    for choice, expected in legends.items():
        window.views.choose_colors(choice)
        qtbot.waitUntil(lambda expected=expected: explained(expected))


def test_all_reasons_are_named_at_1280_and_clouds_stay_equally_large(make_window, qtbot):
    window = make_window()
    show_source(qtbot, window, FakeSource(), 3)
    views = list(window.views.views.values())

    def canvases() -> set[int]:
        return {view.findChild(QWidget, "canvas").height() for view in views}

    (high,) = canvases()
    window.views.choose_colors(ColorBy.PROVENANCE)
    qtbot.waitUntil(lambda: bool(window.result.rendered.verdicts))
    few, many = (
        replace(window.result, rendered=replace(window.result.rendered, verdicts=frozenset(verdicts)))
        for verdicts in ([Provenance.CONTACT], Provenance)
    )
    window.views.show_result(many, "light")
    legends = [view.findChild(LegendLine) for view in views]
    qtbot.waitUntil(lambda: all(legend.needed_height() <= legend.height() for legend in legends))
    qtbot.waitUntil(lambda: all(legend.height() == legend.sizeHint().height() for legend in legends))
    assert len(canvases()) == 1 and canvases() != {high}
    (low,) = canvases()
    window.views.show_result(few, "light")
    qtbot.wait(50)
    assert canvases() == {low}, "nothing jumps when a reason does not occur"
    window.views.choose_colors(ColorBy.CONTACT)
    qtbot.waitUntil(lambda: canvases() == {high})


def test_views_turn_together(window):
    QTest.keyClick(window, Qt.Key.Key_T)
    cameras = {view.camera() for view in window.views.views.values()}
    assert len(cameras) == 1
    QTest.keyClick(window, Qt.Key.Key_S)
    assert window.views.views[CloudName.TACTILE].camera() not in cameras


def test_theme_switches_and_is_remembered(window, qtbot):
    base = window.palette().base().color()
    [dark] = [entry for entry in window.menus.themes.actions() if entry.data() == "dark"]
    dark.trigger()
    assert theme_name() == "dark"
    qtbot.waitUntil(lambda: window.palette().base().color() != base)
    assert dark.isChecked()
    assert window.settings.text("theme") == "dark"
    qtbot.waitUntil(lambda: window.result.rendered.clouds[CloudName.PATCH].lut is patch_lut("dark"))
    window.set_theme("light")
    qtbot.waitUntil(lambda: window.result.rendered.clouds[CloudName.PATCH].lut is patch_lut("light"))


def test_the_layout_is_remembered(make_window):
    window = make_window()
    window.resize(1500, 900)
    window.actions_.show_tactile.trigger()
    window.panel.set_collapsed_sections(["mask"])
    window.views.choose_colors(ColorBy.PROVENANCE)
    window.views.point_size.setValue(5)
    window.close()
    again = make_window(size=(1500, 900))
    assert again.views.views[CloudName.TACTILE].isHidden()
    assert not again.actions_.show_tactile.isChecked()
    assert again.panel.collapsed_sections() == ["mask"]
    assert again.views.chosen_colors() is ColorBy.PROVENANCE
    assert again.views.point_size.value() == 5


def test_a_window_is_never_larger_than_the_screen_nor_partly_beside_it(own_window, monkeypatch):
    window, room, asked = own_window, QRect(0, 30, 1600, 1000), (9000, 9000)
    monkeypatch.setattr(QApplication, "platformName", lambda: "xcb")
    monkeypatch.setattr(window, "screen", lambda: SimpleNamespace(availableGeometry=lambda: room))
    window.move(1500, 900)
    window.resize_to(*asked)
    with_title_bar = room.size() - room_on(window.screen()).size()
    assert with_title_bar.height() >= 30
    assert room.contains(QRect(window.pos(), window.size() + with_title_bar))
    assert window.size() == QSize(*asked).boundedTo(room_on(window.screen()).size())


def test_a_damaged_settings_file_means_defaults(make_window, settings_file):
    damaged = {"window/geometry": "rubbish", "window/across": "eHg=", "view/point_size": "many", "view/color_by": 7}
    settings_file.write_text(json.dumps(damaged))
    window = make_window()
    assert window.views.chosen_colors() is ColorBy.CONTACT
    assert window.views.point_size.value() == 2


def test_two_windows_write_only_what_they_changed(settings_file):
    one, two = Settings(settings_file), Settings(settings_file)
    one.set("a", 1)
    one.sync()
    two.set("b", QByteArray(b"\0\xff"))
    two.sync()
    again = Settings(settings_file)
    assert (again.number("a", 0), again.blob("b")) == (1, QByteArray(b"\0\xff"))


def test_another_rig_warns_once_and_can_be_put_away(make_window, qtbot, preset):
    window = make_window(preset.model_copy(update={"rig": tiny_rig(serial="9")}))
    show_source(qtbot, window, FakeSource(length=4))
    qtbot.waitUntil(lambda: window.messages.message("rig") is not None)
    assert "p9" in window.messages.message("rig").sentence
    window.messages.clear("rig")
    processed = window.result.processed
    qtbot.waitUntil(lambda: window.result.processed > processed + 2)
    assert window.messages.message("rig") is None


def test_a_preset_of_another_size_says_so_and_shows_the_cameras(make_window, qtbot, preset):
    window = make_window(preset.model_copy(update={"rig": tiny_rig(32, 24)}))
    show_source(qtbot, window, FakeSource(length=1))
    assert "32 x 24" in window.messages.message("problem").sentence
    assert window.views.views[CloudName.PROXIMITY].point_count() > 0
    assert not window.actions_.export_patch.isEnabled()
    window.document.new(preset)
    qtbot.waitUntil(lambda: window.result.patch is not None)
    assert window.messages.message("problem") is None


def test_opening_shows_progress_and_cancel_keeps_the_present_source(window, qtbot):
    def slow(progress):
        while True:
            progress(0.4, "pressing")

    window.open_request(SourceRequest("sim:slow", slow))
    qtbot.waitUntil(lambda: "pressing" in text_of(window.opening))
    assert window.opening.isVisible()
    QTest.mouseClick(window.opening.findChild(QPushButton), LEFT)
    qtbot.waitUntil(lambda: not window.opening.isVisible())
    assert window.messages.sentences() == []
    window.worker.seek(5)
    qtbot.waitUntil(lambda: at_rest(window, 5))


def test_a_source_that_cannot_be_opened_is_said(window, qtbot):
    def fail(progress):
        raise SourceError("bag:/x.bag: damaged at byte 12; record it again")

    window.open_request(SourceRequest("bag:/x.bag", fail))
    qtbot.waitUntil(lambda: "bag:/x.bag: damaged at byte 12; record it again" in window.messages.sentences())
    assert window.toolbar.source.text() == "Source: tiny"
    window.worker.seek(5)
    qtbot.waitUntil(lambda: at_rest(window, 5))


def test_help_lists_every_shortcut(window, qtbot):
    QTest.keyClick(window, Qt.Key.Key_F1, Qt.KeyboardModifier.ShiftModifier)
    qtbot.waitUntil(lambda: isinstance(QApplication.activeModalWidget(), QDialog))
    dialog = QApplication.activeModalWidget()
    words = text_of(dialog)
    for action in window.actions_.all():
        for shortcut in action.shortcuts():
            assert shortcut.toString() in words
    assert "Space" in words
    assert dialog.findChild(QScrollArea).horizontalScrollBar().maximum() == 0, "nothing is cut off at the side"
    QTest.keyClick(dialog, Qt.Key.Key_Escape)
    qtbot.waitUntil(lambda: QApplication.activeModalWidget() is None)


def test_every_shortcut_belongs_to_one_action(window):
    keys = [shortcut.toString() for action in window.actions_.all() for shortcut in action.shortcuts()]
    assert len(keys) == len(set(keys))


def test_an_error_in_a_slot_is_shown_and_passed_on(window, qtbot):
    window.error_hook.install()

    def broken():
        raise RuntimeError("the membrane burst")

    with qtbot.captureExceptions() as raised:
        window.error_hook.remove()
        window.error_hook.install()
        QTimer.singleShot(0, broken)
        qtbot.waitUntil(lambda: window.messages.message("defect") is not None)
    window.error_hook.remove()
    assert "the membrane burst" in window.messages.message("defect").sentence
    assert [str(error) for _, error, _ in raised] == ["the membrane burst"]


def test_region_dragged_in_the_strip_is_a_step(window, qtbot):
    window.document.edit("region.enabled", True)
    window.strip.regionEdited.emit((4, 4, 20, 20), 11)
    window.strip.regionEdited.emit((4, 4, 30, 20), 11)
    assert window.document.preset.region.rectangle == (4, 4, 30, 20)
    assert window.document.undo_stack.count() == 2


def test_a_frame_that_overtakes_the_news_of_its_source_stays(window):
    window.worker.opened.emit(window.result.source)
    assert window.views.views[CloudName.PATCH].point_count() > 0
    assert window.actions_.export_patch.isEnabled()
