"""A painted scan is opened, its paint chosen, and pairs of points clicked, by real mouse and key events."""

from __future__ import annotations

import numpy as np
import pytest
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtTest import QTest

from hands import CONTROL, CONTROL_SHIFT, LEFT, drop, type_into, type_path
from tactune.app.analysis import truth_flow
from truth_scene import (
    DISC_M,
    HALF_M,
    EndlessWork,
    click_at,
    click_pair,
    corner_errors_mm,
    corners,
    pose_of,
    settle,
    write_plate,
)

# Opening


def test_a_scan_is_dropped_and_its_contact_shown(qtbot, tab, plate):
    assert "Open the object's painted scan" in tab.guide.text()
    drop(tab, plate)
    settle(qtbot, tab)
    assert tab.views.scan.point_count() == 61 * 61
    expected = np.pi * DISC_M**2 * 1e6
    assert tab.flow.contact.area_mm2 == pytest.approx(expected, rel=0.03)
    assert f"{tab.flow.contact.area_mm2:,.0f} mm²" in tab.paint.readout.text()
    assert "Click a point on the scan" in tab.guide.text()


def test_a_scan_is_opened_by_its_path_and_offered_again(qtbot, tab, plate):
    QTest.mouseClick(tab.open_button, LEFT)
    type_path(qtbot, plate)
    settle(qtbot, tab)
    tab.recent.menu().aboutToShow.emit()
    assert [action.text() for action in tab.recent.menu().actions()] == [str(plate)]


def test_another_unit_reads_the_scan_again(qtbot, tab, tmp_path):
    tab.open_scan(write_plate(tmp_path / "mm.ply", unit_m=0.001))
    qtbot.waitUntil(lambda: any("set the unit" in sentence for sentence in tab.messages.sentences()))
    assert tab.flow.loaded is None
    QTest.keyClick(tab.unit, Qt.Key.Key_Down)
    QTest.keyClick(tab.unit, Qt.Key.Key_Down)
    assert tab.unit.currentText() == "mm"

    def width_m():
        return np.ptp(tab.flow.loaded.scan.vertices_m[:, 0]) if tab.flow.loaded else 0.0

    qtbot.waitUntil(lambda: width_m() == pytest.approx(2 * HALF_M))
    settle(qtbot, tab)
    assert not tab.messages.sentences()


def test_what_is_no_scan_is_said_and_the_present_one_stays(qtbot, ready, tmp_path):
    loaded = ready.flow.loaded
    broken = tmp_path / "broken.ply"
    broken.write_text("no scan", encoding="ascii")
    ready.open_scan(broken)
    qtbot.waitUntil(lambda: any("broken.ply" in sentence for sentence in ready.messages.sentences()))
    assert ready.flow.loaded is loaded
    assert not ready.progress.isVisible()


def test_reading_can_be_given_up(qtbot, ready, plate, monkeypatch):
    work = EndlessWork()
    loaded = ready.flow.loaded
    monkeypatch.setattr(truth_flow, "load", lambda *rest: work(rest[-1]))
    ready.open_scan(plate)
    assert ready.cancel.isVisible() and ready.progress.isVisible()
    qtbot.waitUntil(work.began.is_set)
    QTest.mouseClick(ready.cancel, LEFT)
    qtbot.waitUntil(lambda: not ready.flow.busy_loading)
    assert ready.flow.loaded is loaded
    assert not ready.progress.isVisible() and not ready.messages.sentences()


# Paint


def test_the_eyedropper_and_the_entries_choose_the_paint(qtbot, ready):
    before = ready.flow.state.paint
    QTest.mouseClick(ready.paint.droppers["set"], LEFT)
    click_at(ready.views.scan, (0.05, 0.05, 0.0))
    settle(qtbot, ready)
    assert not ready.flow.state.pairs, "an eyedropper picks a colour and no point"
    purple = ready.flow.contact.vertices
    assert 0.5 < purple.mean() < 1, "now the purple counts"
    QTest.keyClick(ready.views.scan, Qt.Key.Key_Escape)
    assert ready.paint.eyedropper == "off"
    assert ready.isVisible(), "Esc put the eyedropper away and did not close the window"
    QTest.keyClick(ready.views.scan, Qt.Key.Key_Z, CONTROL)
    settle(qtbot, ready)
    assert ready.flow.state.paint == before
    entry = ready.paint.rows["least_area_mm2"].widget.entry
    type_into(entry, "5000")
    settle(qtbot, ready)
    assert not ready.flow.contact.vertices.any(), "the disc is smaller than that"
    assert "eyedropper" in ready.guide.text()


def test_the_highlight_can_be_put_off(ready):
    pictures = []
    for _ in range(2):
        pictures.append(ready.views.scan.cloud().lut.copy())
        QTest.mouseClick(ready.paint.highlight, LEFT, pos=QPoint(8, ready.paint.highlight.height() // 2))
    assert (pictures[0] != pictures[1]).any()


# Pairs


def test_three_clicked_pairs_align_the_scan(qtbot, ready):
    first, second, third = corners(ready)
    click_pair(ready, first)
    assert "frame 4 of tiny" in ready.views.patch_name.text()
    assert ready.views.patch_name.text().startswith("Held")
    assert "2 more pairs" in ready.guide.text()
    click_pair(ready, second)
    assert ready.flow.state.pose is None
    click_pair(ready, third)
    assert corner_errors_mm(ready).max() < 4, "vertices lie 2 mm apart"
    shown = [ready.align.table.item(row, 1).text() for row in range(3)]
    assert all(0 <= float(text.removesuffix(" mm")) < 2 for text in shown)
    assert "Fitted" in ready.guide.text()
    assert [spot.label for spot in ready.views.patch.spots()] == ["1", "2", "3"]
    qtbot.waitUntil(lambda: ready.flow.scores is not None)
    assert float(ready.result.values["symmetric_rmse_mm"].text().removesuffix(" mm")) < 2.5


def test_pairs_are_undone_moved_deleted_and_taken_back(ready):
    first, second, third = corners(ready)
    click_pair(ready, first)
    click_at(ready.views.scan, (0.02, 0.02, 0.0))
    click_at(ready.views.scan, (-0.02, 0.02, 0.0))
    assert len(ready.flow.state.pairs) == 2, "a click on the same side moves the one that waits"
    assert "now click the same point on the patch" in ready.guide.text()
    QTest.keyClick(ready.views.scan, Qt.Key.Key_Escape)
    assert len(ready.flow.state.pairs) == 1
    click_pair(ready, second)
    click_pair(ready, third)
    pose = pose_of(ready)
    ready.align.table.setFocus()
    ready.align.table.selectRow(1)
    assert ready.views.scan.spots()[1].selected
    QTest.keyClick(ready.align.table, Qt.Key.Key_Delete)
    assert len(ready.flow.state.pairs) == 2
    np.testing.assert_array_equal(pose_of(ready), pose)
    QTest.keyClick(ready.align.table, Qt.Key.Key_Z, CONTROL)
    assert len(ready.flow.state.pairs) == 3
    while ready.flow.session.undo_stack.canUndo():
        QTest.keyClick(ready.views.patch, Qt.Key.Key_Z, CONTROL)
    assert ready.flow.state.empty
    assert ready.views.patch_name.text().startswith("Live")
    QTest.keyClick(ready.views.patch, Qt.Key.Key_Z, CONTROL_SHIFT)
    assert len(ready.flow.state.pairs) == 1


def test_pairs_on_a_line_are_told_and_give_no_pose(ready):
    points = ready.flow.patch.points
    row = points[np.abs(points[:, 1] - points[len(points) // 2, 1]) < 1e-4]
    for point in row[:: len(row) // 2][:3]:
        click_pair(ready, point)
    assert ready.flow.state.pose is None
    assert any("on one line" in sentence for sentence in ready.messages.sentences())
