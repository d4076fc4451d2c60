"""The time strip alone: zoom, cursor, curves without values."""

from __future__ import annotations

import numpy as np
import pytest
from PyQt6.QtCore import QPoint, QPointF, Qt
from PyQt6.QtGui import QWheelEvent
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication, QGraphicsTextItem

from tactune.widgets.plots.time_strip import CURVES, TimeStrip

LEFT = Qt.MouseButton.LeftButton
N = 300


@pytest.fixture
def strip(qtbot):
    widget = TimeStrip()
    qtbot.addWidget(widget)
    widget.resize(1000, 84)
    widget.show()
    qtbot.waitExposed(widget)
    seconds = np.arange(N) / 30
    values = {curve.key: np.full(N, np.nan) if curve.key == "iou" else np.arange(N, dtype=float) for curve in CURVES}
    widget.set_series(seconds, values, np.ones(N, np.bool_))
    QApplication.processEvents()
    return widget


@pytest.fixture
def sought(strip):
    frames = []
    strip.seekRequested.connect(frames.append)
    return frames


def turn_wheel(strip, index, notches):
    viewport = strip.plot_widget.viewport()
    place = strip.position_of(index)
    event = QWheelEvent(
        place, QPointF(viewport.mapToGlobal(place.toPoint())), QPoint(), QPoint(0, 120 * notches),
        Qt.MouseButton.NoButton, Qt.KeyboardModifier.NoModifier, Qt.ScrollPhase.NoScrollPhase, False,
    )  # fmt: skip
    QApplication.sendEvent(viewport, event)
    QApplication.processEvents()


def pixels_per_frame(strip):
    return (strip.position_of(101).x() - strip.position_of(100).x()) or 1e-9


def test_a_click_means_the_nearest_frame(strip, sought):
    for index in (0, 120, N - 1):
        QTest.mouseClick(strip.plot_widget.viewport(), LEFT, pos=strip.position_of(index).toPoint())
    assert sought == [0, 120, N - 1]


def test_the_wheel_zooms_and_a_double_click_shows_everything(strip, sought):
    before = pixels_per_frame(strip)
    turn_wheel(strip, 150, 10)
    assert pixels_per_frame(strip) > 2 * before
    QTest.mouseClick(strip.plot_widget.viewport(), LEFT, pos=strip.position_of(152).toPoint())
    assert sought == [152]
    QTest.mouseDClick(strip.plot_widget.viewport(), LEFT, pos=strip.position_of(152).toPoint())
    QApplication.processEvents()
    assert pixels_per_frame(strip) == pytest.approx(before)


def test_the_zoomed_strip_follows_the_cursor(strip):
    turn_wheel(strip, 20, 15)
    assert strip.position_of(280).x() > strip.plot_widget.width()
    strip.set_cursor(280)
    QApplication.processEvents()
    assert 0 < strip.position_of(280).x() < strip.plot_widget.width()


def test_names_of_neighbouring_markers_do_not_overlap(strip):
    strip.set_markers([(104, "Marker 2"), (100, "Marker 1")])
    QApplication.processEvents()
    places = {
        item.toPlainText(): item.mapRectToScene(item.boundingRect())
        for item in strip.plot_widget.scene().items()
        if isinstance(item, QGraphicsTextItem) and item.toPlainText().startswith("Marker")
    }
    assert len(places) == 2
    assert not places["Marker 1"].intersects(places["Marker 2"])
