"""The Strain tab: a pressed printed grid, measured on a separate thread."""

from __future__ import annotations

import csv
from dataclasses import replace
from threading import Event

import numpy as np
import pytest
from PyQt6.QtCore import QEvent, Qt
from PyQt6.QtGui import QMouseEvent
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication

from hands import image_position, press, show_source, type_into
from rigs import one_place_rig
from tactune.app.analysis import strain_tab
from tactune.app.analysis.strain_work import StrainTask, examine
from tactune.core.errors import FrameError
from tactune.core.model.frames import GroundTruth, SensorFrame, TrueStrain
from tactune.core.sources.base import SeekableSource

RIG = one_place_rig(320, 240, 193.0, 1e-5, 1e-5)
CAMERA, LENS = RIG.tactile, RIG.tactile.intrinsics
V, U = np.mgrid[:240, :320].astype(float)


def sheet(index: int, stretch=(1.0, 1.0), depth_m=0.3, dots=True) -> SensorFrame:
    """A flat sheet with 13 x 9 dots, 10 mm apart before it was stretched."""
    s = (U - LENS.cx) / LENS.fx * depth_m / stretch[0]
    t = (V - LENS.cy) / LENS.fy * depth_m / stretch[1]
    column, row = np.rint(s / 0.01), np.rint(t / 0.01)
    gap = np.hypot((s - column * 0.01) * stretch[0], (t - row * 0.01) * stretch[1])
    cover = np.clip((0.0022 - gap) / 0.0012 + 0.5, 0, 1)
    cover[(np.abs(column) > 6) | (np.abs(row) > 4)] = 0
    color = np.repeat((170 - 130 * cover * dots).astype(np.uint8)[..., None], 3, axis=2)
    counts = np.full((240, 320), round(depth_m / 1e-5), np.uint16)
    return SensorFrame(index, counts, counts, color, color)


class PressedGrid(SeekableSource):
    """Frame n is 3 n mm nearer and stretched by 5 n % along the length and 2 n % along the width."""

    def __init__(self, untouched=True, dots=True):
        super().__init__("grid", RIG, 8)
        self._has_untouched, self._dots = untouched, dots

    def read(self, index):
        frame = sheet(index, (1 + 0.05 * index, 1 + 0.02 * index), 0.3 - 0.003 * index, self._dots)
        strain = TrueStrain(0.09 * index, 0.05 * index, 0.02 * index, 0.05 * index, 0.02 * index)
        return replace(frame, truth=GroundTruth(np.zeros((240, 320), bool), strain=strain))

    def untouched(self):
        return sheet(0) if self._has_untouched else None


def opened(qtbot, window, source=None, index=3):
    """Show a frame of the grid in the tab, opened by its key."""
    show_source(qtbot, window, source or PressedGrid(), index)
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow)
    QTest.keyClick(window, Qt.Key.Key_T, Qt.KeyboardModifier.ControlModifier)
    analysis = window.analysis.window
    qtbot.waitExposed(analysis)
    tab = analysis.made["strain"]
    settled(qtbot, tab, index)
    return tab


def settled(qtbot, tab, index):
    """Wait until the tab shows a frame measured with the present spacing and untouched frame."""

    def shown():
        if tab.view is None or tab.untouched.searching:
            return False
        task = tab.view.task
        known = task.untouched is not None or tab.untouched.frame is None
        return known and task.frame.sequence == index and task.spacing_m == tab.spacing.value() / 1e3

    qtbot.waitUntil(shown, timeout=60_000)


class HeldExamine:
    """`examine` that waits until it may go on."""

    def __init__(self):
        self.go_on = Event()
        self.in_time = []

    def __call__(self, task):
        self.in_time.append(self.go_on.wait(60))
        return examine(task)


def go_to(qtbot, window, tab, index):
    window.worker.seek(index)
    settled(qtbot, tab, index)


def cell(tab, row, column):
    return tab.numbers.cells[row][column].text()


def test_the_key_opens_the_tab_with_the_present_frame_measured(qtbot, make_window):
    tab = opened(qtbot, make_window())
    assert tab.view.measured.length.largest == pytest.approx(0.15, abs=0.01)
    assert tab.view.displacement_mm == pytest.approx(9.0, abs=0.2)
    assert "9.0 mm displacement" in tab.numbers.verdict.text()
    assert cell(tab, 0, 1).startswith("15.") or cell(tab, 0, 1).startswith("14.")
    assert (cell(tab, 0, 3), cell(tab, 1, 4)) == ("15.0 %", "6.0 %")
    assert cell(tab, 1, 2).endswith("px")
    assert len(tab.view.cells.corners) == 12 * 8
    assert tab.view.cells.width == pytest.approx(0.06, abs=0.01)
    choose_and_read_the_map(qtbot, tab)


def choose_and_read_the_map(qtbot, tab):
    """By keys, and with the mouse."""
    picture = tab.map.grab().toImage()
    tab.map_of.setFocus()
    QTest.keyClick(tab.map_of, Qt.Key.Key_Down)
    QTest.keyClick(tab.map_of, Qt.Key.Key_Down)
    assert tab.map_of.currentText() == "Along width"
    assert tab.map.grab().toImage() != picture
    viewport, place = tab.map.view.viewport(), image_position(tab.map, 163, 123)
    free = (Qt.MouseButton.NoButton, Qt.MouseButton.NoButton, Qt.KeyboardModifier.NoModifier)
    moved = QMouseEvent(QEvent.Type.MouseMove, place, viewport.mapToGlobal(place), *free)
    QApplication.sendEvent(viewport, moved)  # QTest's moves do not reach a window that the platform has not raised
    qtbot.waitUntil(lambda: "along length" in tab.pointed.text())
    assert "% along width" in tab.pointed.text()


def test_the_curve_grows_while_the_membrane_is_pressed(qtbot, make_window):
    window = make_window()
    tab = opened(qtbot, window, index=1)
    for index in (4, 2, 6, 4):
        go_to(qtbot, window, tab, index)
    points = tab.curve.points
    assert [point.sequence for point in points] == [1, 2, 4, 6], "in the order of the frames"
    assert [point.displacement_mm for point in points] == pytest.approx([3.0, 6.0, 12.0, 18.0], abs=0.2)
    assert [point.strain[0] for point in points] == pytest.approx([5.0, 10.0, 20.0, 30.0], abs=2.0)
    shown = tab.curve.plot.getPlotItem().listDataItems()
    assert any(len(item.getData()[0] if item.getData()[0] is not None else ()) == 4 for item in shown)


class OneWrong(PressedGrid):
    """Frame 4 is stretched by 59 % along the length, its neighbours by 15 and 25 %."""

    def read(self, index):
        frame = super().read(index)
        wrong = sheet(index, (1.59, 1.08), 0.288)
        return replace(frame, tactile_color=wrong.tactile_color) if index == 4 else frame


def test_a_strain_unlike_its_neighbours_is_marked_and_not_joined(qtbot, make_window, tmp_path):
    window = make_window()
    tab = opened(qtbot, window, OneWrong(), index=2)
    for index in (6, 3, 5, 4):
        go_to(qtbot, window, tab, index)
    length, width = (item.getData()[1] for item in tab.curve.plot.getPlotItem().listDataItems() if item.name())
    assert np.isnan(length).tolist() == [False, False, True, False, False]
    assert not np.isnan(width).any()
    tab.save_to(tmp_path / "curve.csv")
    qtbot.waitUntil(lambda: any("curve.csv" in sentence for sentence in tab.messages.sentences()))
    rows = list(csv.DictReader((tmp_path / "curve.csv").read_text().splitlines()))
    assert [row["sequence"] for row in rows if row["strain_length_unlikely"] == "1"] == ["4"]
    assert float(rows[2]["strain_length_percent"]) > 50


def test_a_reset_curve_can_be_brought_back_and_another_spacing_changes_it_and_is_remembered(qtbot, make_window):
    window = make_window()
    tab = opened(qtbot, window)
    QTest.mouseClick(tab.reset, Qt.MouseButton.LeftButton)
    assert not tab.curve.points
    press(tab.messages.message("reset"), "Bring it back")
    assert [point.sequence for point in tab.curve.points] == [3]
    type_into(tab.spacing, "11.5")
    settled(qtbot, tab, 3)
    qtbot.waitUntil(lambda: abs(tab.view.measured.length.largest) < 0.01)
    (point,) = tab.curve.points
    assert point.at_spacing(11.5)[0] == pytest.approx(0.0, abs=1.0)
    assert window.settings.number("strain/spacing_mm", 0) == 11.5


def test_without_a_grid_it_says_what_to_do_and_of_which_frame(qtbot, make_window):
    window = make_window()
    tab = opened(qtbot, window, PressedGrid(dots=False))
    assert window.transport.position.text().endswith("frame 4 of 8")
    assert tab.numbers.verdict.text().startswith("Frame 4: no grid of dots")
    assert "print a square grid" in tab.numbers.verdict.text()
    assert cell(tab, 0, 1) == "–"
    assert not tab.curve.points
    assert not tab.export.isEnabled()


def test_a_captured_frame_is_the_untouched_frame_of_a_source_without_one(qtbot, make_window):
    window = make_window()
    tab = opened(qtbot, window, PressedGrid(untouched=False), index=0)
    assert tab.view.displacement_mm is None
    assert "Take as untouched" in tab.status.text()
    QTest.mouseClick(tab.capture, Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: tab.view.displacement_mm is not None)
    go_to(qtbot, window, tab, 5)
    assert tab.view.displacement_mm == pytest.approx(15.0, abs=0.2)
    assert [point.sequence for point in tab.curve.points] == [0, 5]


def test_another_source_begins_a_curve_of_its_own(qtbot, make_window, monkeypatch):
    window = make_window()
    tab = opened(qtbot, window)
    QTest.mouseClick(tab.reset, Qt.MouseButton.LeftButton)
    held = HeldExamine()
    monkeypatch.setattr(strain_tab, "examine", held)
    tab.spacing.setValue(9.0)  # frame 3 is being measured once more
    tab.show_result(replace(window.result, source=replace(window.result.source, name="other"), frame=sheet(5)))
    held.go_on.set()
    qtbot.waitUntil(lambda: tab.view.task.frame.sequence == 5)
    assert [point.sequence for point in tab.curve.points] == [5]
    assert tab.messages.message("reset") is None


def test_picture_and_points_are_written(qtbot, make_window, tmp_path):
    window = make_window()
    tab = opened(qtbot, window)
    go_to(qtbot, window, tab, 5)
    tab.save_to(tmp_path / "strain.png")
    qtbot.waitUntil(lambda: any("strain.csv" in sentence for sentence in tab.messages.sentences()))
    assert (tmp_path / "strain.png").read_bytes().startswith(b"\x89PNG")
    rows = list(csv.DictReader((tmp_path / "strain.csv").read_text().splitlines()))
    assert [row["sequence"] for row in rows] == ["3", "5"]
    assert float(rows[1]["strain_length_percent"]) == pytest.approx(25.0, abs=2.0)
    assert float(rows[1]["true_strain_length_percent"]) == 25.0
    tab.save_to(tmp_path / "strain.png" / "strain.csv")
    qtbot.waitUntil(lambda: tab.messages.message("failed") is not None)


def test_errors_count_frames_as_windows_do_also_where_a_recording_begins_late():
    frames = [sheet(index) for index in (502, 503)]
    colorless = [replace(frame, tactile_color=None) for frame in frames]
    assert examine(StrainTask(colorless, 4, RIG, 0.01, None)).problem.startswith("frame 4 has no tactile colour")
    nothing = replace(sheet(0), tactile_depth=np.zeros((240, 320), np.uint16))
    problem = examine(StrainTask(frames, 4, RIG, 0.01, nothing)).problem
    assert problem.startswith("frame 4 and the untouched membrane have no pixel")
    small = CAMERA.model_copy(update={"intrinsics": LENS.model_copy(update={"width": 300})})
    with pytest.raises(FrameError, match=r"^frame 3: tactile_depth"):
        examine(StrainTask(frames, 4, RIG.model_copy(update={"tactile": small}), 0.01, None))


def test_frames_at_rest_are_averaged_and_moving_ones_are_not(qtbot, make_window):
    window = make_window()
    tab = opened(qtbot, window)
    tab.average.setValue(10)
    settled(qtbot, tab, 3)
    tab.show_result(replace(window.result, frame=replace(window.result.frame)))
    qtbot.waitUntil(lambda: tab.view.averaged == 2)
    go_to(qtbot, window, tab, 5)
    assert tab.view.averaged == 1


def test_a_slow_measurement_does_not_hold_up_the_window(qtbot, make_window, monkeypatch):
    window = make_window()
    tab = opened(qtbot, window)
    held = HeldExamine()
    monkeypatch.setattr(strain_tab, "examine", held)
    for index in (4, 5, 6):
        window.worker.seek(index)
        qtbot.waitUntil(lambda index=index: window.result.frame.sequence == index)
    assert tab.view.task.frame.sequence == 3
    held.go_on.set()
    settled(qtbot, tab, 6)
    assert all(held.in_time), "the window went on while the measurement was held"
    assert 5 not in [point.sequence for point in tab.curve.points]
