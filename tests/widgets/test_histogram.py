from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PyQt6.QtCore import QPoint, QPointF, Qt
from PyQt6.QtGui import QWheelEvent
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication

from tactune.widgets.plots.histogram import GAP, RELATIVE_DIFFERENCE, LimitHistogram, split_at

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


def tallest(histogram: LimitHistogram) -> float:
    return max(curve.getData()[1].max() for curve in histogram.plot_widget.getPlotItem().listDataItems())


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


def test_programmatic_changes_do_not_emit(histogram: LimitHistogram) -> None:
    edits: list[float] = []
    histogram.limitEdited.connect(lambda t, _: edits.append(t))
    histogram.set_limit(0.05)
    histogram.set_data(np.ones(40), EDGES, 0.02)
    assert histogram.limit() == 0.02
    assert sorted(line.value() for line in histogram.lines) == [-2.0, 2.0]
    assert edits == []


def test_what_arrives_while_hidden_is_drawn_when_shown(qtbot, histogram: LimitHistogram) -> None:
    histogram.hide()
    histogram.set_data(np.full(40, 7), EDGES)
    assert tallest(histogram) == 39
    histogram.show()
    assert tallest(histogram) == 7


def test_an_empty_histogram_is_no_error(histogram: LimitHistogram) -> None:
    histogram.set_data(np.zeros(40), EDGES, 0.0)
    assert histogram.limit() == 0.0


def test_the_line_of_the_gaps_is_dragged_in_millimetres(qtbot, qapp) -> None:
    gaps = LimitHistogram(GAP, 0.00005)
    qtbot.addWidget(gaps)
    gaps.resize(320, 120)
    gaps.show()
    qtbot.waitExposed(gaps)
    counts = np.r_[9000, np.arange(49, 0, -1)]
    gaps.set_data(counts, np.linspace(0, 0.0005, 51), 0.00005)
    qapp.processEvents()
    (line,) = gaps.lines
    assert line.value() == pytest.approx(0.05)
    box = gaps.plot_widget.getPlotItem().getViewBox()
    assert box.viewRange()[1][1] < 100, "the bar at 0 does not flatten the others"
    edits: list[float] = []
    gaps.limitEdited.connect(lambda limit, _: edits.append(limit))
    drag(gaps, 0.05, 0.1, 0.2)
    assert edits[-1] == pytest.approx(0.0002, abs=0.00001)
    drag(gaps, 0.2, 0.1, -0.1)
    assert edits[-1] == 0.0


@given(
    counts=st.lists(st.integers(0, 1000), min_size=1, max_size=30),
    cut=st.one_of(st.just(0.0), st.floats(1e-6, 2.0)),
)
def test_splitting_keeps_the_outline(counts: list[int], cut: float) -> None:
    edges = np.linspace(-1.0, 1.0, len(counts) + 1)
    split_edges, split_counts = split_at(edges, np.array(counts, float), (-cut, cut))
    assert len(split_edges) == len(split_counts) + 1
    assert (np.diff(split_edges) > 0).all()
    if cut < 1.0:
        assert {-cut + 0.0, cut} <= set(split_edges + 0.0)
    middles = (split_edges[:-1] + split_edges[1:]) / 2
    index = np.clip(np.searchsorted(edges, middles) - 1, 0, len(counts) - 1)
    np.testing.assert_array_equal(split_counts, np.array(counts, float)[index])


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
