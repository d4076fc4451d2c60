"""Findings in the window: in their rail, at the field and in the empty view; a click mends, Ctrl+Z undoes."""

import re
from dataclasses import replace

import numpy as np
import pytest
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication, QPushButton, QScrollArea

from fakes import FakeSource, tiny_frame, tiny_rig
from hands import CONTROL, LEFT, image_position, show_source, text_of
from tactune.app.worker.results import CloudName
from tactune.core.preset import Preset
from tactune.widgets.basics.controls import NoteLabel
from tactune.widgets.basics.messages import Severity

WIDTH, HEIGHT = 160, 120
RIG = tiny_rig(WIDTH, HEIGHT)


def disagreeing_frame(index, rig):
    """Both cameras see the same slanted wall, and the proximity camera reads 12 mm too far."""
    frame = tiny_frame(index, rig)
    height, width = rig.proximity.intrinsics.shape
    wall_m = np.broadcast_to(0.25 + 0.0004 * np.arange(width), (height, width))
    return replace(
        frame,
        proximity_depth=np.rint((wall_m + 0.012) / rig.proximity.depth_unit_m).astype(np.uint16),
        tactile_depth=np.rint(wall_m / rig.tactile.depth_unit_m).astype(np.uint16),
    )


@pytest.fixture
def window(qtbot, window):
    """A window that stands still on cameras that disagree."""
    window.document.new(Preset(name="tiny", contact_test="tolerance").with_values({"tolerance.t": 0.02}))
    show_source(qtbot, window, FakeSource(rig=RIG, make=disagreeing_frame, name="disagreeing"), 3)
    qtbot.waitUntil(lambda: found(window))
    return window


def found(window):
    return window.rail.title.text() == "Findings: 1"


def place(widget, window):
    return widget.mapTo(window, QPoint(0, 0)), widget.size()


def button(widget, text):
    [found] = [each for each in widget.findChildren(QPushButton) if each.text() == text and each.isVisible()]
    return found


def test_the_rail_mends_and_nothing_moves(window, qtbot):
    row = window.panel.rows["alignment.depth_offset_m"]
    assert "+12.0 mm: the cameras disagree" in row.label.toolTip(), "the field is marked"
    assert "+12.0 mm: the cameras disagree" in text_of(window.rail)
    places = [place(widget, window) for widget in (window.panel, row.widget, window.rail)]
    QTest.keyClick(window, Qt.Key.Key_F, CONTROL)
    mend = button(window.rail, "Depth offset +12.0 mm")
    assert mend.hasFocus() and "Bias between the cameras: +12.0 ±" in mend.toolTip()
    QTest.mouseClick(mend, LEFT)
    assert window.document.preset.alignment.depth_offset_m == pytest.approx(0.012, abs=0.0003)
    assert window.document.undo_stack.undoText() == "Depth offset +12.0 mm"
    assert window.rail.title.text() == "No findings"
    assert row.label.toolTip() == row.spec.tooltip
    assert [place(widget, window) for widget in (window.panel, row.widget, window.rail)] == places
    qtbot.waitUntil(lambda: len(window.result.patch.points) > 10_000)
    QTest.keyClick(window, Qt.Key.Key_Z, CONTROL)
    assert window.document.preset.alignment.depth_offset_m == 0.0
    qtbot.waitUntil(lambda: found(window))
    window.resize(window.minimumSize())
    full = window.rail.height()
    QTest.mouseClick(button(window.rail, "Depth offset +12.0 mm"), LEFT)
    qtbot.waitUntil(lambda: window.rail.height() < full / 2)  # in a low window the controls get what it leaves


def test_a_message_covers_no_finding(window, qtbot):
    said, title = window.rail.findChildren(NoteLabel)[0], place(window.rail.title, window)
    top = place(said, window)[0]
    window.messages.show_message("worker", Severity.ERROR, "The camera was unplugged. " * 4)
    qtbot.waitUntil(window.messages.isVisible)
    area = window.rail.findChild(QScrollArea)
    shown = [window.messages, area.viewport()]
    qtbot.waitUntil(lambda: place(shown[0], window)[0].y() >= place(shown[1], window)[0].y() + shown[1].height())
    assert area.viewport().height() > said.fontMetrics().height()
    assert place(window.rail.title, window) == title and place(said, window)[0] == top, "nothing moves"


def test_the_empty_patch_view_says_why_and_has_the_button(window, qtbot):
    view = window.views.views[CloudName.PATCH]
    qtbot.waitUntil(lambda: "the cameras disagree" in view.notice.text())
    QTest.mouseClick(button(view, "Depth offset +12.0 mm"), LEFT)
    qtbot.waitUntil(lambda: view.point_count() > 0)
    assert view.notice.text() == ""
    assert not [each for each in view.findChildren(QPushButton) if each.isVisible()]


def test_a_pose_that_is_not_known_is_told_once_with_the_button_that_calibrates(window, qtbot):
    window.actions_.show_tactile.trigger()  # a view that is hidden says nothing of the pose
    rig = RIG.model_copy(update={"T_proximity_tactile": None})
    show_source(qtbot, window, FakeSource(rig=rig, make=disagreeing_frame, name="no pose"), 3)
    view = window.views.views[CloudName.PATCH]
    qtbot.waitUntil(lambda: "pose of the tactile camera is not known" in view.notice.text())
    assert window.messages.sentences() == [] and view.header.entries == []
    window.document.edit_many({"region.enabled": True, "region.rectangle": (WIDTH, 0, 9, 9)}, title="Region")
    qtbot.waitUntil(lambda: "move the region into the image" in view.notice.text())
    assert not view.notice.button.isVisible(), "calibrating does not mend it"
    window.document.undo_stack.undo()
    qtbot.waitUntil(view.notice.button.isVisible)
    QTest.mouseClick(button(view, "Calibrate"), LEFT)
    qtbot.waitUntil(lambda: window.calibration.wizard is not None and window.calibration.wizard.isVisible())


def hovering_frame(index, rig):
    """An object whose gap to a bulged membrane is 1.3 mm."""
    height, width = rig.proximity.intrinsics.shape
    v, u = np.mgrid[:height, :width]
    away = np.hypot(u - width / 2, v - height / 2)
    membrane_m = 0.25 + 1.7e-6 * away**2
    object_m = membrane_m + np.where(away < 25, 0.0013, 0.03)
    return replace(
        tiny_frame(index, rig),
        proximity_depth=np.rint(object_m / rig.proximity.depth_unit_m).astype(np.uint16),
        tactile_depth=np.rint(membrane_m / rig.tactile.depth_unit_m).astype(np.uint16),
    )


def test_hovering_tells_the_gap_of_the_membrane(make_window, qtbot):
    window = make_window(Preset(name="tiny").with_value("membrane.bias", False))
    show_source(qtbot, window, FakeSource(rig=RIG, make=hovering_frame, name="hovering"), 0)
    window.strip.choose("difference")
    QApplication.processEvents()
    pane = window.strip.panes["difference"]
    QTest.mouseMove(pane.view.viewport(), image_position(pane, WIDTH // 2, HEIGHT // 2).toPoint())
    qtbot.waitUntil(lambda: "outside the edge of contact" in window.status.readout.text())
    gap_mm = float(re.search(r"gap ([\d.]+) mm", window.status.readout.text())[1])
    assert 0.05 < gap_mm < 1.5


def test_a_finding_stays_until_it_has_been_gone_for_a_while(window, qtbot):
    window.worker.examined.emit((), window.document.preset)
    assert found(window), "it may be back in the next frame"

    def gone():
        window.worker.examined.emit((), window.document.preset)
        return window.rail.title.text() == "No findings"

    qtbot.waitUntil(gone)
