"""The main window: its contents, bars, saved state, messages, and the Help menu."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PyQt6.QtCore import Qt, QTimer
from PyQt6.QtGui import QDesktopServices
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication, QPushButton

from fakes import FakeSource, at_rest, tiny_frame, tiny_rig
from hands import LEFT, show_source, text_of
from small_recordings import noisy_press, small_rig
from tactune.app.window import help as help_menu
from tactune.app.window.status import FrameStatus, patch_readings
from tactune.app.window.toolbar import FrameNumber
from tactune.app.worker.playback import PlaybackState
from tactune.app.worker.processing import FrameProcessor, told_doubt
from tactune.app.worker.reading import SourceRequest
from tactune.app.worker.results import CloudName, ColorBy, SourceInfo, Wanted
from tactune.core.errors import SourceError
from tactune.core.model.patch import Doubt
from tactune.core.preset import Preset
from tactune.widgets.basics.colormaps import patch_lut
from tactune.widgets.basics.messages import Severity
from tactune.widgets.basics.theme import THEME


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
    window.actions_.measure_noise.trigger()
    assert window.set_up.noise.isVisible(), "a step of setting up is shown"


def test_theme_switches_and_is_remembered(window, qtbot):
    base = window.palette().base().color()
    [dark] = [entry for entry in window.menus.themes.actions() if entry.data() == "dark"]
    dark.trigger()
    assert THEME.name == "dark"
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
    QTest.keyClick(window, Qt.Key.Key_3, Qt.KeyboardModifier.ControlModifier)
    window.close()
    again = make_window(size=(1500, 900))
    assert again.views.views[CloudName.TACTILE].isHidden()
    assert not again.actions_.show_tactile.isChecked()
    assert again.panel.collapsed_sections() == ["mask"]
    assert again.views.colors is ColorBy.PROVENANCE
    assert again.views.point_size.value() == 5
    assert again.actions_.run.isChecked()


def test_a_damaged_settings_file_means_defaults(make_window, settings_file):
    damaged = {"window/geometry": "rubbish", "window/across": "eHg=", "view/point_size": "many", "view/color_by": 7}
    settings_file.write_text(json.dumps(damaged))
    window = make_window()
    assert window.views.colors is ColorBy.CONTACT
    assert window.views.point_size.value() == 2


def test_the_warning_of_another_rig_stands_among_the_findings(window, qtbot, preset):
    window.document.new(preset.model_copy(update={"rig": tiny_rig(serial="9")}))
    show_source(qtbot, window, FakeSource(length=4))
    qtbot.waitUntil(lambda: "p9" in text_of(window.rail))
    assert window.messages.sentences() == [], "nothing covers the findings"
    show_source(qtbot, window, FakeSource(length=4, rig=tiny_rig(serial="9")))
    qtbot.waitUntil(lambda: "p9" not in text_of(window.rail))


def test_a_preset_of_another_size_says_so_and_shows_the_cameras(window, qtbot, preset):
    window.document.new(preset.model_copy(update={"rig": tiny_rig(32, 24)}))
    show_source(qtbot, window, FakeSource(length=1))
    patch = window.views.views[CloudName.PATCH]
    assert "32 x 24" in patch.notice.text() and window.messages.sentences() == []
    QTest.keyClick(window, Qt.Key.Key_3, Qt.KeyboardModifier.AltModifier)
    qtbot.waitUntil(lambda: not patch.isVisible() and "problem" in window.messages.by_key)
    QTest.keyClick(window, Qt.Key.Key_3, Qt.KeyboardModifier.AltModifier)
    assert window.views.views[CloudName.PROXIMITY].point_count() > 0
    window.document.new(preset)
    qtbot.waitUntil(lambda: window.result.patch is not None)
    qtbot.waitUntil(lambda: window.messages.by_key.get("problem") is None)


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
    keys = [shortcut.toString() for action in window.actions_.by_name().values() for shortcut in action.shortcuts()]
    assert len(keys) == len(set(keys))


def test_an_error_in_a_slot_is_shown_and_passed_on(window, qtbot):
    def broken():
        raise RuntimeError("the membrane burst")

    with qtbot.captureExceptions() as raised:
        window.error_hook.install()
        QTimer.singleShot(0, broken)
        qtbot.waitUntil(lambda: window.messages.by_key.get("defect") is not None)
    window.error_hook.remove()
    assert "the membrane burst" in window.messages.by_key["defect"].sentence
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
    assert window.actions_.export.isEnabled()


def fail_to_open(window, qtbot):
    def broken(_):
        raise SourceError("bag:/x.bag: damaged")

    window.open_request(SourceRequest("bag:/x.bag", broken))
    qtbot.waitUntil(lambda: window.messages.by_key.get("source") is not None)


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
    show_source(qtbot, window, FakeSource(name="another"))
    assert window.messages.sentences() == ["The membrane burst."]


def test_escape_dismisses_and_the_key_of_messages_goes_to_them(window, qtbot):
    assert not window.actions_.messages.isEnabled()
    fail_to_open(window, qtbot)
    QTest.keyClick(window, Qt.Key.Key_F12)
    assert window.messages.isAncestorOf(QApplication.focusWidget())
    window.views.setFocus()
    QTest.keyClick(window, Qt.Key.Key_Escape)
    assert window.messages.sentences() == [] and not window.actions_.messages.isEnabled()


@pytest.fixture
def opened(monkeypatch):
    urls = []
    monkeypatch.setattr(QDesktopServices, "openUrl", lambda url: urls.append(url.toLocalFile()) or True)
    return urls


def test_f1_opens_the_guide_that_ships_with_the_package(window, opened, monkeypatch, tmp_path):
    page = tmp_path / "index.html"
    page.write_text("guide")
    monkeypatch.setattr(help_menu, "guide_file", lambda name: tmp_path / f"{name}.html")
    QTest.keyClick(window, Qt.Key.Key_F1)
    assert opened == [str(page)]
    (tmp_path / "keys.html").write_text("keys")
    QTest.keyClick(window, Qt.Key.Key_F1, Qt.KeyboardModifier.ShiftModifier)
    assert opened[1:] == [str(tmp_path / "keys.html")]


@pytest.fixture
def bar(qtbot):
    made = FrameStatus()
    qtbot.addWidget(made)
    qtbot.addWidget(made.details)
    made.show()
    return made


def test_the_numbers_say_how_sure_the_patch_is_and_why(bar):
    info = SourceInfo("tiny", tiny_rig(), 1, 30.0)
    result = FrameProcessor().process(info, tiny_frame(3, info.rig), Preset(), Wanted(), PlaybackState())
    doubtful = replace(result, area_mm2=190_574.0, doubt=Doubt(0.609, 2.34, ("no dent",)))
    area, touches, boundary = patch_readings(doubtful, 30.0)[:3]
    assert [area.value, area.widest, touches.value, boundary.value] == ["190,574 mm²", area.value, "60 %", "±2.3 mm"]
    no_patch = replace(result, patch=None, playback=PlaybackState(playing=True))
    assert [reading.value for reading in patch_readings(no_patch, 29.6)] == ["30 fps"]
    bar.show_result(doubtful)
    assert "Doubts about contact: no dent" in bar.details.text()


def test_enter_goes_to_the_typed_frame_and_escape_brings_the_shown_one_back(qtbot):
    number, sought = FrameNumber(), []
    number.valueChanged.connect(sought.append)
    qtbot.addWidget(number)
    number.show_frame(3, 8)
    number.show()
    number.activateWindow()  # the window of the module may be open
    qtbot.waitUntil(number.isActiveWindow)
    for typed, key, shown in (("5", Qt.Key.Key_Return, 5), ("2", Qt.Key.Key_Escape, 5), ("7", Qt.Key.Key_Return, 7)):
        number.setFocus()
        number.selectAll()
        QTest.keyClicks(number, typed)
        number.show_frame(5, 8)  # played on while somebody types
        assert number.text().startswith(typed)
        QTest.keyClick(number, key)
        assert number.text() == f"{shown} / 7" and not number.hasFocus()
    assert sought == [5, 7]


def test_a_first_contact_is_judged_at_once_while_frames_play():
    processor, rig = FrameProcessor(), small_rig(64)
    press = noisy_press(0, rig, 3, with_truth=False)
    info = SourceInfo("press", rig, 3, 30.0)
    contact = press.next_frame()
    nothing = replace(contact, proximity_depth=np.zeros_like(contact.proximity_depth))
    playing = PlaybackState(length=3, playing=True)
    preset = Preset(contact_test="tolerance")
    judged = [processor.process(info, frame, preset, Wanted(), playing).doubt for frame in (nothing, contact, contact)]
    at_rest = processor.process(info, contact, preset, Wanted(), PlaybackState()).doubt
    first, second, third = (doubt.touch_probability for doubt in judged)
    assert first == 0.0 < second == third == at_rest.touch_probability


def test_a_doubt_about_one_of_several_contacts_says_which():
    info = SourceInfo("press", small_rig(64), 1, 30.0)
    frame = noisy_press(0, info.rig, 1, with_truth=False).next_frame()
    frame = replace(frame, proximity_depth=np.where(np.arange(64) // 2 == 10, np.uint16(0), frame.proximity_depth))
    preset = Preset(contact_test="tolerance")
    patch = FrameProcessor().process(info, frame, preset, Wanted(), PlaybackState()).patch
    small = patch.contacts[1]
    doubt_of = lambda part: Doubt(0.5, 1.0, ("no dent",) if len(part) == len(small.members) else ())
    [told] = told_doubt(replace(patch, doubt_of=doubt_of)).reasons
    assert told == f"no dent (1 contact of 2: {small.area_mm2:,.0f} mm²)"
