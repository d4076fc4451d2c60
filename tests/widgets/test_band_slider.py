from __future__ import annotations

import pytest
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtTest import QTest

from tactune.widgets.parameters.slider import Scale, Slider

LEFT = Qt.MouseButton.LeftButton


def make(qtbot, *, wraps: bool, low: float = 0, high: float = 179, gap: float = 0.0) -> Slider:
    slider = Slider(Scale(0, 179, step=1), 2, wraps=wraps, gap=gap)
    qtbot.addWidget(slider)
    slider.resize(372, 24)  # two pixels a step
    slider.set_values(low, high)
    slider.show()
    qtbot.waitExposed(slider)
    slider.activateWindow()
    qtbot.waitUntil(slider.isActiveWindow)
    return slider


def record(slider: Slider) -> list[tuple[float, float, int]]:
    edits: list[tuple[float, float, int]] = []
    slider.edited.connect(lambda band, gesture: edits.append((*band, gesture)))
    return edits


def at(slider: Slider, value: float) -> QPoint:
    present = slider.values()
    slider.blockSignals(True)
    slider.set_values(value, value)
    x = slider.handle_x(0)
    slider.set_values(*present)
    slider.blockSignals(False)
    return QPoint(round(x), slider.height() // 2)


def drag(slider: Slider, start: float, *targets: float) -> None:
    QTest.mousePress(slider, LEFT, pos=at(slider, start))
    for target in targets:
        QTest.mouseMove(slider, at(slider, target))
    QTest.mouseRelease(slider, LEFT, pos=at(slider, targets[-1]))


def test_a_handle_is_dragged_in_one_gesture(qtbot) -> None:
    slider = make(qtbot, wraps=False, low=50, high=120)
    edits = record(slider)
    drag(slider, 120, 130, 140, 150)
    assert [(low, high) for low, high, _ in edits] == [(50, 130), (50, 140), (50, 150)]
    assert len({gesture for *_, gesture in edits}) == 1
    drag(slider, 50, 40)
    assert slider.values() == (40, 150)
    assert len({gesture for *_, gesture in edits}) == 2


@pytest.mark.parametrize(
    ("wraps", "low", "high", "gap", "drags", "value"),
    [
        (False, 50, 120, 0, [(50, 100, 160)], (120, 120)),  # handles do not cross
        (False, 50, 120, 5, [(120, 80, 10)], (50, 55)),
        (True, 150, 170, 0, [(170, 100, 10)], (150, 10)),  # but on a circle they do
        (False, 50, 100, 0, [(75, 85, 95)], (70, 120)),  # the band moves as a whole
        (False, 50, 100, 0, [(75, 85, 95), (95, 179)], (129, 179)),
        (True, 140, 170, 0, [(155, 170)], (155, 5)),  # and turns on a circle
        (True, 140, 170, 0, [(155, 170), (0, 20)], (175, 25)),
    ],
)
def test_drags_end_where_they_should(qtbot, wraps, low, high, gap, drags, value) -> None:
    slider = make(qtbot, wraps=wraps, low=low, high=high, gap=gap)
    assert not slider.wrapped()
    for places in drags:
        drag(slider, *places)
    assert slider.values() == value
    assert slider.wrapped() == (value[0] > value[1])


def test_two_handles_on_one_spot_come_apart_both_ways(qtbot) -> None:
    slider = make(qtbot, wraps=False, low=100, high=100)
    QTest.mousePress(slider, LEFT, pos=at(slider, 100) + QPoint(2, 0))
    QTest.mouseMove(slider, at(slider, 130) + QPoint(2, 0))
    QTest.mouseRelease(slider, LEFT, pos=at(slider, 130))
    assert slider.values() == (100, 130)
    slider.set_values(179, 179)
    drag(slider, 179, 150)
    assert slider.values() == (150, 179)


def test_the_keyboard_reaches_both_handles(qtbot) -> None:
    slider = make(qtbot, wraps=False, low=50, high=100)
    edits = record(slider)
    slider.setFocus(Qt.FocusReason.TabFocusReason)
    QTest.keyClick(slider, Qt.Key.Key_Right)
    QTest.keyClick(slider, Qt.Key.Key_PageDown)
    assert slider.values() == (34, 100)
    assert edits[0][2] == edits[1][2]
    QTest.keyClick(slider, Qt.Key.Key_Tab)
    QTest.keyClick(slider, Qt.Key.Key_Up)
    QTest.keyClick(slider, Qt.Key.Key_PageUp)
    assert slider.values() == (34, 118)
    assert edits[2][2] != edits[1][2]
    QTest.keyClick(slider, Qt.Key.Key_End)
    assert slider.values() == (34, 179)
    QTest.keyClick(slider, Qt.Key.Key_Tab, Qt.KeyboardModifier.ShiftModifier)
    QTest.keyClick(slider, Qt.Key.Key_Home)
    assert slider.values() == (0, 179)
