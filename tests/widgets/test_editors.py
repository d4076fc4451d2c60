"""Sliders and entries of numbers and ranges, by mouse and keys."""

import pytest
from PyQt6.QtCore import QPoint, QPointF, Qt
from PyQt6.QtTest import QTest

from hands import LEFT, shown, turn_wheel, type_into
from tactune.core.preset import Preset
from tactune.widgets.basics.fields import field_spec
from tactune.widgets.parameters.editors import NumbersEditor
from tactune.widgets.parameters.slider import Scale, Slider


def make_slider(qtbot, path):
    return shown(qtbot, NumbersEditor(field_spec(Preset, path)), 260, 30)


def record(widget):
    edits = []
    widget.edited.connect(lambda value, gesture: edits.append((value, gesture)))
    return edits


def test_typing_takes_effect_on_enter(qtbot):
    widget = make_slider(qtbot, "alignment.depth_offset_m")
    edits = record(widget)
    type_into(widget.entry, "-17.5")
    assert [value for value, _ in edits] == [-0.0175]
    assert widget.entry.text() == "-17.5"
    type_into(widget.entry, "3,25 mm", Qt.Key.Key_Tab)
    assert widget.value() == 0.00325
    assert edits[0][1] != edits[1][1]


@pytest.mark.parametrize(
    ("path", "text", "reason"),
    [
        ("tolerance.t", "101", "from 0 % to 100 %"),
        ("tolerance.t", "much", "“much” is not allowed"),
        ("outliers.ratio", "0", "above 0 σ to 100 σ"),
        ("outliers.k", "3.5", "but a whole number"),
        ("alignment.depth_offset_m", "101", "from −100 mm to 100 mm"),
    ],
)
def test_what_is_not_allowed_is_refused_in_words(qtbot, path, text, reason):
    widget = make_slider(qtbot, path)
    before, shown = widget.value(), widget.entry.text()
    edits, sentences = record(widget), []
    widget.refused.connect(sentences.append)
    type_into(widget.entry, text)
    assert edits == []
    assert widget.value() == before
    assert widget.entry.text() == shown
    assert len(sentences) == 1
    assert widget.spec.title in sentences[0]
    assert reason in sentences[0]


def test_a_burst_of_arrows_is_one_gesture(qtbot):
    widget = make_slider(qtbot, "outliers.k")
    edits = record(widget)
    widget.entry.setFocus()
    for _ in range(4):
        QTest.keyClick(widget.entry, Qt.Key.Key_Up)
    assert [value for value, _ in edits] == [21, 22, 23, 24]
    assert len({gesture for _, gesture in edits}) == 1
    widget.slider.setFocus()
    QTest.keyClick(widget.slider, Qt.Key.Key_Right)
    QTest.keyClick(widget.slider, Qt.Key.Key_PageUp)
    assert [value for value, _ in edits[4:]] == [25, 34]
    assert len({gesture for _, gesture in edits}) == 2


def test_arrows_step_without_rounding_noise_and_stop_at_the_bounds(qtbot):
    widget = make_slider(qtbot, "outliers.ratio")
    edits = record(widget)
    widget.entry.setFocus()
    widget.setValue(0.3)
    for _ in range(5):
        QTest.keyClick(widget.entry, Qt.Key.Key_Down)
    assert [value for value, _ in edits] == [0.2, 0.1]
    widget.setValue(0.2345)
    QTest.keyClick(widget.entry, Qt.Key.Key_Up)
    assert widget.value() == 0.3
    widget.setValue(0.2345)
    QTest.keyClick(widget.entry, Qt.Key.Key_Down)
    assert widget.value() == 0.2


def make_band(qtbot, *, wraps, low=0, high=179, gap=0.0):
    slider = Slider(Scale(0, 179, step=1), 2, wraps=wraps, gap=gap)
    slider.set_values(low, high)
    return shown(qtbot, slider, 372, 24)  # two pixels a step


def place_of(slider, value):
    present = slider.values
    slider.blockSignals(True)
    slider.set_values(value, value)
    x = slider.handle_x(0)
    slider.set_values(*present)
    slider.blockSignals(False)
    return QPoint(round(x), slider.height() // 2)


def drag_band(slider, start, *targets):
    QTest.mousePress(slider, LEFT, pos=place_of(slider, start))
    for target in targets:
        QTest.mouseMove(slider, place_of(slider, target))
    QTest.mouseRelease(slider, LEFT, pos=place_of(slider, targets[-1]))


@pytest.mark.parametrize(
    ("wraps", "low", "high", "gap", "drags", "value"),
    [
        (False, 50, 120, 0, [(50, 100, 160)], (120, 120)),  # handles do not cross
        (False, 50, 120, 5, [(120, 80, 10)], (50, 55)),
        (False, 50, 120, 5, [(50, 100, 160)], (115, 120)),
        (True, 150, 170, 0, [(170, 100, 10)], (150, 10)),  # but on a circle they do
        (False, 50, 100, 0, [(70, 60)], (60, 100)),  # a press beside brings the nearer one
        (False, 80, 80, 0, [(60, 40), (100, 120)], (40, 120)),  # of two at one place, the one that can come
        (False, 50.4, 100, 0, [(50, 50)], (50.4, 100)),  # a press alone changes nothing
    ],
)
def test_drags_end_where_they_should(qtbot, wraps, low, high, gap, drags, value):
    slider = make_band(qtbot, wraps=wraps, low=low, high=high, gap=gap)
    assert not slider.wrapped()
    for places in drags:
        drag_band(slider, *places)
    assert slider.values == value
    assert slider.wrapped() == (value[0] > value[1])


def test_the_keyboard_reaches_both_handles(qtbot):
    slider = make_band(qtbot, wraps=False, low=50, high=100)
    edits = record(slider)
    slider.setFocus(Qt.FocusReason.TabFocusReason)
    QTest.keyClick(slider, Qt.Key.Key_Right)
    QTest.keyClick(slider, Qt.Key.Key_PageDown)
    assert slider.values == (34, 100)
    assert edits[0][1] == edits[1][1]
    QTest.keyClick(slider, Qt.Key.Key_Tab)
    QTest.keyClick(slider, Qt.Key.Key_Up)
    QTest.keyClick(slider, Qt.Key.Key_PageUp)
    assert slider.values == (34, 118)
    assert edits[2][1] != edits[1][1]
    QTest.keyClick(slider, Qt.Key.Key_End)
    assert slider.values == (34, 179)
    QTest.keyClick(slider, Qt.Key.Key_Tab, Qt.KeyboardModifier.ShiftModifier)
    QTest.keyClick(slider, Qt.Key.Key_Home)
    assert slider.values == (0, 179)
    turn_wheel(slider, QPointF(9, 9), 1)
    slider.clearFocus()
    turn_wheel(slider, QPointF(9, 9), 1)
    slider.setFocus(Qt.FocusReason.BacktabFocusReason)
    turn_wheel(slider, QPointF(9, 9), -1)
    assert slider.values == (1, 178)
