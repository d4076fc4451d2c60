"""The main window: its contents, saved state and messages."""

import json

from PyQt6.QtCore import Qt, QTimer
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QPushButton

from fakes import FakeSource, at_rest, tiny_rig
from hands import show_source, text_of
from tactune.app.worker.results import CloudName, ColorBy
from tactune.app.worker.worker import SourceRequest
from tactune.widgets.basics.colormaps import patch_lut
from tactune.widgets.basics.theme import theme_name

LEFT = Qt.MouseButton.LeftButton


def test_shows_every_part_of_a_frame(window):
    views = window.views.views
    assert views[CloudName.PATCH].point_count() == len(window.result.patch.points) > 0
    assert views[CloudName.PROXIMITY].point_count() == views[CloudName.TACTILE].point_count() == 64 * 48
    status = text_of(window.status)
    assert "tiny" in status
    assert window.transport.position.text() == "4 of 8"


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
    assert again.views.colors is ColorBy.PROVENANCE
    assert again.views.point_size.value() == 5


def test_a_damaged_settings_file_means_defaults(make_window, settings_file):
    damaged = {"window/geometry": "rubbish", "window/across": "eHg=", "view/point_size": "many", "view/color_by": 7}
    settings_file.write_text(json.dumps(damaged))
    window = make_window()
    assert window.views.colors is ColorBy.CONTACT
    assert window.views.point_size.value() == 2


def test_another_rig_warns_once_and_can_be_put_away(window, qtbot, preset):
    window.document.new(preset.model_copy(update={"rig": tiny_rig(serial="9")}))
    show_source(qtbot, window, FakeSource(length=4))
    qtbot.waitUntil(lambda: window.messages.by_key.get("rig") is not None)
    assert "p9" in window.messages.by_key["rig"].sentence
    window.messages.clear("rig")
    processed = window.result.processed
    qtbot.waitUntil(lambda: window.result.processed > processed + 2)
    assert window.messages.by_key.get("rig") is None


def test_a_preset_of_another_size_says_so_and_shows_the_cameras(window, qtbot, preset):
    window.document.new(preset.model_copy(update={"rig": tiny_rig(32, 24)}))
    show_source(qtbot, window, FakeSource(length=1))
    assert "32 x 24" in window.messages.by_key["problem"].sentence
    assert window.views.views[CloudName.PROXIMITY].point_count() > 0
    window.document.new(preset)
    qtbot.waitUntil(lambda: window.result.patch is not None)
    assert window.messages.by_key.get("problem") is None


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
        qtbot.waitUntil(lambda: window.messages.by_key.get("defect") is not None)
    window.error_hook.remove()
    assert "the membrane burst" in window.messages.by_key["defect"].sentence
    assert [str(error) for _, error, _ in raised] == ["the membrane burst"]


def test_a_frame_that_overtakes_the_news_of_its_source_stays(window):
    window.worker.opened.emit(window.result.source)
    assert window.views.views[CloudName.PATCH].point_count() > 0
    assert window.actions_.export.isEnabled()
