from __future__ import annotations

import numpy as np
import pytest
from PyQt6.QtCore import QPoint, QPointF, Qt
from PyQt6.QtGui import QWheelEvent
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication

from tactune.widgets.plots.histogram import RELATIVE_DIFFERENCE, LimitHistogram

LEFT = Qt.MouseButton.LeftButton
EDGES = np.linspace(-0.1, 0.1, 41)


@pytest.fixture
def histogram(qtbot, qapp) -> LimitHistogram:
    widget = LimitHistogram(RELATIVE_DIFFERENCE, 0.03)
    qtbot.addWidget(widget)
    widget.resize(320, 120)
    widget.show()
    qtbot.waitExposed(widget)
    widget.set_data(np.arange(40), EDGES, 0.03)
    qapp.processEvents()
    return widget


def at(histogram: LimitHistogram, percent: float) -> QPoint:
    box = histogram.plot_widget.getPlotItem().getViewBox()
    return histogram.plot_widget.mapFromScene(box.mapViewToScene(QPointF(percent, 15.0)))


def drag(histogram: LimitHistogram, start: float, *targets: float) -> None:
    viewport = histogram.plot_widget.viewport()
    QTest.mouseMove(viewport, at(histogram, start))
    QTest.mousePress(viewport, LEFT, pos=at(histogram, start))
    for target in targets:
        QTest.mouseMove(viewport, at(histogram, target))
    QTest.mouseRelease(viewport, LEFT, pos=at(histogram, targets[-1]))


def test_the_caption_tells_the_share_within_the_lines(histogram: LimitHistogram) -> None:
    assert "%" not in histogram.caption()
    histogram.set_data(np.full(40, 20), EDGES, 0.03, known=1000)
    assert histogram.caption() == "24.0 % within t"  # 12 of 40 bars, and 200 values beyond them
    drag(histogram, 3.0, 6.0)
    share = float(histogram.caption().split()[0])
    assert share == pytest.approx(48, abs=2)


@pytest.mark.parametrize(("start", "target"), [(3.0, 6.0), (-3.0, -6.0), (3.0, -6.0)])
def test_dragging_a_line_moves_both_in_one_gesture(histogram: LimitHistogram, start: float, target: float) -> None:
    edits: list[tuple[float, int]] = []
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


@pytest.mark.parametrize("place", [0.3, 0.95])
def test_the_wheel_is_left_to_the_page_over_bars_and_numbers(histogram, place):
    viewport = histogram.plot_widget.viewport()
    at = QPointF(viewport.width() / 2, place * viewport.height())
    event = QWheelEvent(
        at, QPointF(viewport.mapToGlobal(at.toPoint())), QPoint(), QPoint(0, -120), Qt.MouseButton.NoButton,
        Qt.KeyboardModifier.NoModifier, Qt.ScrollPhase.NoScrollPhase, False,
    )  # fmt: skip
    QApplication.sendEvent(viewport, event)
    assert not event.isAccepted()
