"""Colours of the themes and of the images, the focus ring, the badge of an old image, and messages over the views."""

import cv2
import numpy as np
import pytest
from PyQt6.QtCore import QPoint, QRect, Qt
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication, QFrame, QPushButton, QToolButton, QVBoxLayout, QWidget

from colour_vision import EYES, contrast_ratio, nearest
from hands import LEFT, shown
from tactune.core.model.patch import Provenance
from tactune.widgets.basics import colormaps
from tactune.widgets.basics import messages as module
from tactune.widgets.basics.controls import TintedLabel
from tactune.widgets.basics.messages import Messages, Severity
from tactune.widgets.basics.style import apply_theme
from tactune.widgets.basics.theme import THEME, theme_colors

NAMES = ("light", "dark")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("background", ["window", "base", "button"])
@pytest.mark.parametrize("line", ["outline", "focus"])
def test_fields_grooves_and_the_focus_are_seen(name, background, line):
    colors = theme_colors(name)
    assert contrast_ratio(getattr(colors, line), getattr(colors, background)) >= 3.0


@pytest.mark.parametrize("name", NAMES)
def test_the_button_of_the_next_step_stays_readable_under_the_mouse(qapp, qtbot, name):
    apply_theme(qapp, name)
    button = QToolButton()
    qtbot.addWidget(button)
    button.setProperty("primary", True)
    button.setText("Record")
    button.setAttribute(Qt.WidgetAttribute.WA_UnderMouse)
    image = button.grab().toImage()
    assert contrast_ratio(image.pixelColor(4, image.height() // 2).name(), theme_colors().on_accent) >= 4.5


def test_a_coloured_label_follows_the_theme_and_leaves_nothing_behind(qapp):
    known, label = THEME.receivers(THEME.changed), TintedLabel("failed", "error")
    for name in reversed(NAMES):
        apply_theme(qapp, name)
        assert label.palette().windowText().color().name() == theme_colors(name).error
    assert THEME.receivers(THEME.changed) == known


@pytest.mark.parametrize("name", NAMES)
def test_a_ring_shows_where_the_keyboard_acts(qapp, qtbot, name):
    apply_theme(qapp, name)
    window = QWidget()
    qtbot.addWidget(window)
    layout = QVBoxLayout(window)
    for text in ("One", "Two"):
        layout.addWidget(QPushButton(text))
    one, two = window.findChildren(QPushButton)
    two.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
    with qtbot.waitActive(window):
        window.show()
    ring, colors = QRect(two.geometry()).adjusted(-2, -2, 2, 2), theme_colors()

    def edges():
        image = window.grab(ring).toImage()
        return {image.pixelColor(x, y).name() for x, y in ((20, 0), (20, 1), (0, 10), (1, 10))}

    one.setFocus()
    assert edges() == {colors.window}
    qtbot.keyClick(one, Qt.Key.Key_Tab)
    qtbot.waitUntil(lambda: edges() == {colors.focus})
    qtbot.keyClick(two, Qt.Key.Key_Backtab)
    qtbot.waitUntil(lambda: edges() == {colors.window})
    apply_theme(qapp, "light")


@pytest.fixture
def views(qtbot):
    """A widget with messages over it, beside another that must not move."""
    window = QWidget()
    window.over, window.below = QWidget(), QFrame()
    layout = QVBoxLayout(window)
    layout.addWidget(window.over, 1)
    layout.addWidget(window.below, 1)
    window.messages = Messages(window.over)
    return shown(qtbot, window, 600, 700)


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr(module, "NOTE_MS", 30)
    monkeypatch.setattr(module, "CHARACTER_MS", 0)


def test_messages_push_nothing_aside_and_stay_inside(views):
    before = views.over.geometry(), views.below.geometry()
    for key in "abcde":
        views.messages.show_message(key, Severity.ERROR, f"{key}: " + "a long sentence " * 20)
    QApplication.processEvents()
    assert (views.over.geometry(), views.below.geometry()) == before
    assert views.over.rect().contains(views.messages.geometry())
    for message in map(views.messages.by_key.get, "abcde"):
        assert not message.isVisible() or message.height() >= message.heightForWidth(message.width())


def test_the_newest_three_are_on_the_screen_the_newest_on_top_and_errors_before_notes(views):
    views.messages.show_message("error", Severity.ERROR, "Error.")
    for key in "abc":
        views.messages.show_message(key, Severity.INFO, f"{key}.")
    QApplication.processEvents()
    shown = {key: views.messages.by_key.get(key) for key in ("error", "a", "b", "c")}
    assert [key for key, message in shown.items() if message.isVisible()] == ["error", "b", "c"]
    assert shown["c"].y() < shown["b"].y() < shown["error"].y()


def test_only_a_note_without_buttons_goes_by_itself(views, quick, qtbot):
    views.messages.show_message("note", Severity.INFO, "Written to a.ply.")
    views.messages.show_message("answer", Severity.INFO, "Recorded.", [("Open", lambda: None)])
    views.messages.show_message("error", Severity.ERROR, "Damaged.")
    qtbot.waitUntil(lambda: views.messages.sentences() == ["Recorded.", "Damaged."])


def test_a_message_is_dismissed_by_its_cross_by_escape_and_with_its_subject(views):
    for key in ("cross", "escape"):
        views.messages.show_message(key, Severity.ERROR, key)
    views.messages.show_message("left", Severity.ERROR, "left", subject="other")
    views.messages.show_message("of", Severity.ERROR, "of the source", subject="source")
    views.messages.clear_subject("source")
    assert views.messages.sentences() == ["Cross.", "Escape.", "Left."]
    views.messages.clear("left")
    assert views.messages.focus_newest()
    QTest.keyClick(QApplication.focusWidget(), Qt.Key.Key_Escape)
    assert views.messages.sentences() == ["Cross."]
    [cross] = views.messages.by_key["cross"].findChildren(QToolButton)
    QTest.mouseClick(cross, LEFT, pos=QPoint(4, 4))
    assert views.messages.sentences() == [] and not views.messages.isVisible()


def lab(colors):
    """CIE L*a*b* of RGB rows."""
    rgb = (np.asarray(colors, dtype=np.float32) / 255).reshape(-1, 1, 3)
    return np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2LAB)).reshape(-1, 3)


def test_depth_colours_are_perceptually_uniform_and_get_darker():
    colors = lab(colormaps.depth_lut()[:, :3])
    assert (np.diff(colors[:, 0]) < 0.5).all(), "lightness falls from near to far, 8-bit rounding aside"
    steps = np.linalg.norm(colors[8:] - colors[:-8], axis=1)
    assert steps.max() / steps.min() < 2.5
    assert (colormaps.depth_lut()[:, 3] == 255).all()


@pytest.mark.parametrize("eye", EYES)
def test_the_band_and_both_signs_are_told_apart_with_any_colour_vision(eye):
    lut = colormaps.difference_lut(0.03)
    rows = {"low end": 1, "below": 85, "band": 128, "above": 171, "high end": 255}
    assert nearest({name: lut[row, :3] for name, row in rows.items()}, eye)[0] > 8


@pytest.mark.parametrize("eye", EYES)
@pytest.mark.parametrize("theme", NAMES)
def test_drop_reasons_and_contact_are_told_apart_with_any_colour_vision(theme, eye):
    lut = colormaps.provenance_lut(theme)
    context = {
        Provenance.NO_PROXIMITY_DEPTH,
        Provenance.OUTSIDE_REGION,
        Provenance.OUTSIDE_RANGE,
        Provenance.OUTSIDE_TOLERANCE,
    }
    strong = {provenance: lut[provenance, :3] for provenance in Provenance if provenance not in context}
    assert nearest(strong, eye)[0] > 20
    for provenance in context:
        for reason, rgb in strong.items():
            assert nearest({provenance: lut[provenance, :3], reason: rgb}, eye)[0] > 15
