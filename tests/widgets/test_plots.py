"""The histogram of a limit and the time strip."""

import numpy as np
import pytest
from PyQt6.QtCore import QPointF
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication

from hands import LEFT, shown, strip_position, turn_wheel
from tactune.widgets.plots.histogram import RELATIVE_DIFFERENCE, LimitHistogram
from tactune.widgets.plots.time_strip import CURVES, TimeStrip

EDGES = np.linspace(-0.1, 0.1, 41)


@pytest.fixture
def histogram(qtbot, qapp):
    widget = shown(qtbot, LimitHistogram(RELATIVE_DIFFERENCE, 0.03), 320, 120)
    widget.set_data(np.arange(40), EDGES)
    qapp.processEvents()
    return widget


def bar_at(histogram, percent):
    box = histogram.plot_widget.getPlotItem().getViewBox()
    return histogram.plot_widget.mapFromScene(box.mapViewToScene(QPointF(percent, 15.0)))


def drag(histogram, start, *targets):
    viewport = histogram.plot_widget.viewport()
    QTest.mouseMove(viewport, bar_at(histogram, start))
    QTest.mousePress(viewport, LEFT, pos=bar_at(histogram, start))
    for target in targets:
        QTest.mouseMove(viewport, bar_at(histogram, target))
    QTest.mouseRelease(viewport, LEFT, pos=bar_at(histogram, targets[-1]))


def test_the_caption_tells_the_share_within_the_lines(histogram):
    assert "%" not in histogram.caption()
    histogram.set_data(np.full(40, 20), EDGES, known=1000)
    assert histogram.caption() == "24.0 % within t"  # 12 of 40 bars, and 200 values beyond them
    assert [item.yData.sum() for item in histogram.plot_widget.getPlotItem().listDataItems()] == [800, 240]
    drag(histogram, 3.0, 6.0)
    share = float(histogram.caption().split()[0])
    assert share == pytest.approx(48, abs=2)


@pytest.mark.parametrize(("start", "target"), [(3.0, 6.0), (3.0, -6.0)])
def test_dragging_a_line_moves_both_in_one_gesture(histogram, start, target):
    edits = []
    histogram.limitEdited.connect(lambda t, gesture: edits.append((t, gesture)))
    drag(histogram, start, (start + target) / 2, target)
    assert edits
    assert edits[-1][0] == pytest.approx(0.06, abs=0.002)
    assert len({gesture for _, gesture in edits}) == 1
    low, high = sorted(line.value() for line in histogram.lines)
    assert high == pytest.approx(100 * edits[-1][0])
    assert low == -high
    first = edits[0][1]
    drag(histogram, high, 2.0)
    assert edits[-1][1] != first


N = 300


@pytest.fixture
def strip(qtbot):
    widget = shown(qtbot, TimeStrip(), 1000, 84)
    seconds = np.arange(N) / 30
    values = {curve.key: np.full(N, np.nan) if curve.key == "iou" else np.arange(N, dtype=float) for curve in CURVES}
    widget.set_series(seconds, values, np.ones(N, np.bool_))
    QApplication.processEvents()
    return widget


def pixels_per_frame(strip):
    return (strip_position(strip, 101).x() - strip_position(strip, 100).x()) or 1e-9


def test_numbers_beside_the_strip_have_room(strip):
    axis = strip.plot_widget.getPlotItem().getAxis("left")
    numbers = {each for _, ticks in axis.tickValues(*axis.range, axis.height()) for each in ticks}
    assert 2 <= len(numbers) <= 3


def test_what_the_pointer_tells_is_seen(strip):
    before = strip.grab().toImage()
    QTest.mouseMove(strip.plot_widget.viewport(), strip_position(strip, 120).toPoint())
    assert "frame 120: 120" in strip.words and strip.grab().toImage() != before


def test_the_wheel_zooms_and_a_double_click_shows_everything(strip):
    sought = []
    strip.seekRequested.connect(sought.append)
    before = pixels_per_frame(strip)
    turn_wheel(strip.plot_widget.viewport(), strip_position(strip, 150), 10)
    assert pixels_per_frame(strip) > 2 * before
    QTest.mouseClick(strip.plot_widget.viewport(), LEFT, pos=strip_position(strip, 152).toPoint())
    assert sought == [152]
    QTest.mouseDClick(strip.plot_widget.viewport(), LEFT, pos=strip_position(strip, 152).toPoint())
    QApplication.processEvents()
    assert pixels_per_frame(strip) == pytest.approx(before)
