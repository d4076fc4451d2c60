"""The time strip by mouse and keys: seek, in and out marks, export of a part; and the series that it draws."""

import os
import signal
from dataclasses import replace

import numpy as np
import pytest
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtTest import QTest

from fakes import FakeCameras, FakeSource, at_rest, tiny_frame
from hands import CONTROL, show_source, strip_position, type_path
from tactune.app.timeline.series import Series, time_series, visiting_order
from tactune.core import ContactPipeline
from tactune.core.model.frames import GroundTruth
from tactune.core.output.writer import export_mcap
from tactune.core.preset import Preset
from tactune.core.sources.folder import export_folder
from tactune.core.sources.tactune_files import McapSource
from tactune.widgets.basics.fields import format_number

LENGTH = 24


@pytest.fixture
def scene(tmp_path):
    folder = tmp_path / "scene"
    export_folder(FakeSource(LENGTH), folder)
    return folder


def show_scene(qtbot, window, scene, index):
    window.open_source(f"folder:{scene}")
    qtbot.waitUntil(lambda: window.result is not None and window.result.source.name == f"folder:{scene}")
    window.worker.pause()
    go_to(qtbot, window, index)


def go_to(qtbot, window, index):
    window.worker.seek(index)
    qtbot.waitUntil(lambda: at_rest(window, index) and window.result.playback.index == index)


def mark(qtbot, window, first, last):
    for index, key in ((first, Qt.Key.Key_I), (last, Qt.Key.Key_O)):
        go_to(qtbot, window, index)
        QTest.keyClick(window, key)


def computed(window):
    return window.timeline.series is not None and window.timeline.series.complete


@pytest.mark.parametrize(("name", "export"), [("lost.mcap", export_mcap), ("lost", export_folder)])
def test_a_recording_with_lost_frames_has_the_times_of_their_stamps(qtbot, window, tmp_path, name, export):
    times_s = np.array([10.0, 10.1, 10.3, 11.5, 11.6])

    def make(index, rig):
        at_s = float(times_s[index])
        return replace(tiny_frame(index, rig), proximity_time_s=at_s, tactile_time_s=at_s)

    export(FakeSource(5, make=make), tmp_path / name)
    window.open_source(str(tmp_path / name))
    qtbot.waitUntil(lambda: window.timeline.series is not None and len(window.timeline.series) == 5)
    np.testing.assert_allclose(window.timeline.series.seconds, times_s - 10)
    qtbot.waitUntil(lambda: computed(window))
    line = window.time_strip.plot_widget.getPlotItem().curves[0]
    qtbot.waitUntil(lambda: list(line.opts["connect"]) == [True, True, False, True, False])


def test_the_series_is_the_pipelines_follows_preset_and_undo_and_is_read_by_the_pointer(make_window, scene, qtbot):
    window = make_window()
    show_scene(qtbot, window, scene, 3)
    qtbot.waitUntil(lambda: computed(window))
    first = window.timeline.series
    areas = first.values["area_mm2"].tolist()
    window.document.edit("tolerance.t", 0.001)
    qtbot.waitUntil(lambda: computed(window) and window.timeline.series is not first)
    assert np.all(window.timeline.series.values["area_mm2"] == 0)
    window.document.undo_stack.undo()
    qtbot.waitUntil(lambda: computed(window))
    assert window.timeline.series.values["area_mm2"].tolist() == areas

    strip = window.time_strip
    strip.curve_box.setFocus()
    QTest.keyClick(strip.curve_box, Qt.Key.Key_Down)
    assert strip.curve.key == "points"
    QTest.mouseMove(strip.plot_widget.viewport(), strip_position(strip, 9).toPoint() + QPoint(0, 10))
    points = int(first.values["points"][9])
    qtbot.waitUntil(lambda: strip.words == f"0.3 s, frame 9: {points} points")

    first = window.timeline.series
    killed = window.timeline.job.process  # is replaced, and that one ends with the window
    os.kill(killed.pid, signal.SIGKILL)
    killed.join()
    window.document.edit("tolerance.t", 0.02)
    qtbot.waitUntil(lambda: "ended" in window.time_strip.words or computed(window))
    window.document.edit("tolerance.t", 0.021)
    qtbot.waitUntil(lambda: computed(window) and window.timeline.series is not first)
    number = window.timeline.job.process.pid
    assert number != killed.pid
    window.close_without_asking()
    with pytest.raises(ProcessLookupError):
        os.kill(number, 0)


def test_an_export_has_exactly_the_marked_frames(window, qtbot, tmp_path, scene):
    show_scene(qtbot, window, scene, 3)
    mark(qtbot, window, 6, 10)
    assert window.context.trim == (6, 11)
    QTest.keyClick(window, Qt.Key.Key_E, CONTROL)
    type_path(qtbot, tmp_path / "part.mcap")
    qtbot.waitUntil(lambda: window.messages.by_key.get("export") is not None)
    assert "Frames 6 to 10 (5) written to" in window.messages.by_key["export"].sentence
    with McapSource(tmp_path / "part.mcap") as written:
        assert [frame.sequence for frame in written] == [6, 7, 8, 9, 10]

    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow)
    QTest.keyClick(window, Qt.Key.Key_I, Qt.KeyboardModifier.ShiftModifier)
    assert window.context.trim is None


def test_a_single_frame_has_nothing_to_mark_and_a_live_source_scrolls(window, qtbot):
    show_source(qtbot, window, FakeSource(1))
    assert not window.actions_.mark_in.isEnabled()
    live = FakeCameras()
    show_live(qtbot, window, live)
    assert not window.actions_.mark_in.isEnabled()
    values = window.timeline._live
    for number, ago_s in enumerate((2.1, 0.1, 0)):  # no frame for 2 s
        values[number] = values[2][0] - ago_s, values[number][1]
    qtbot.waitUntil(lambda: np.isnan(window.time_strip._line.getData()[1]).tolist() == [False, True, False])


def show_live(qtbot, window, live):
    live.release()
    show_source(qtbot, window, live)
    for count in (2, 3):
        live.release()
        qtbot.waitUntil(lambda count=count: window.result.frame.sequence == count - 1)
    area = window.result.area_mm2

    def hovered():
        plot = window.time_strip.plot_widget
        QTest.mouseMove(plot.viewport(), QPoint(plot.width() // 2, 30))
        QTest.mouseMove(plot.viewport(), QPoint(plot.width() - 12, 30))
        return f"{format_number(area, 3)} mm²" in window.time_strip.words

    qtbot.waitUntil(hovered)


PRESET = Preset(contact_test="tolerance").with_values({"tolerance.t": 0.03, "outliers.enabled": False})


def known_frame(index, rig):
    """A frame with its truth: the right half of the image is in contact."""
    contact = np.zeros(rig.proximity.intrinsics.shape, np.bool_)
    contact[:, contact.shape[1] // 2 :] = True
    return replace(tiny_frame(index, rig), truth=GroundTruth(contact))


def test_the_series_is_the_pipelines_and_a_damaged_frame_a_gap():
    source = FakeSource(8, broken={3}, make=known_frame)
    series = Series(source.length, source.frame_rate_hz)
    for values in time_series(source, PRESET, visiting_order(8, PRESET)):
        series.put(values)
    assert series.complete
    assert np.flatnonzero(np.isnan(series.values["area_mm2"])).tolist() == [3]
    pipeline = ContactPipeline(PRESET, source.rig)
    for index in (0, 1, 7):
        frame = source.read(index)
        patch = pipeline.process(frame)
        true = frame.truth.contact
        assert series.values["area_mm2"][index] == patch.area_mm2 > 0
        assert series.values["points"][index] == len(patch.points)
        assert series.values["iou"][index] == (patch.mask & true).sum() / (patch.mask | true).sum() > 0


@pytest.mark.parametrize("length", [1, 2, 99, 101, 900, 5000])
def test_visits_every_frame_once_and_the_whole_recording_first(length):
    order = visiting_order(length, Preset())
    assert sorted(order) == list(range(length))
    first_pass = order[: order.index(max(order[:100])) + 1]
    assert len(first_pass) <= 100
    assert max(first_pass) >= 0.95 * length - 1
    assert visiting_order(length, Preset().with_values({"membrane.frames": 5})) == list(range(length))
