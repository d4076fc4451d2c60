"""Colours of the themes, the focus ring, tooltips in lines of readable length, and the badge of an old image."""

import pyqtgraph as pg
import pytest
from PyQt6.QtCore import QRect, Qt
from PyQt6.QtGui import QPalette
from PyQt6.QtWidgets import QPushButton, QToolButton, QVBoxLayout, QWidget

from contrast import contrast_ratio
from tactune.widgets.basics.controls import NoteLabel
from tactune.widgets.basics.style import apply_theme
from tactune.widgets.basics.theme import ACCENT, theme_colors, theme_name
from tactune.widgets.images.image_pane import ImagePane

NAMES = ("light", "dark")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("background", ["window", "base", "alternate", "button"])
@pytest.mark.parametrize("text", ["text", "muted", "accent_text", "error"])
def test_text_is_readable_on_every_background(name, background, text):
    colors = theme_colors(name)
    assert contrast_ratio(getattr(colors, text), getattr(colors, background)) >= 4.5


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("background", ["window", "base", "button"])
@pytest.mark.parametrize("line", ["outline", "focus"])
def test_fields_grooves_and_the_focus_are_seen(name, background, line):
    colors = theme_colors(name)
    assert contrast_ratio(getattr(colors, line), getattr(colors, background)) >= 3.0


@pytest.mark.parametrize("name", NAMES)
def test_a_theme_reaches_qt_and_pyqtgraph(qapp, qtbot, name):
    widget = QWidget()
    qtbot.addWidget(widget)
    assert apply_theme(qapp, name) == name
    qapp.processEvents()
    assert theme_name() == name
    colors = theme_colors()
    assert colors == theme_colors(name)
    assert widget.palette().color(QPalette.ColorRole.Window).name() == colors.window
    assert widget.palette().color(QPalette.ColorRole.Highlight).name() == ACCENT
    assert pg.getConfigOption("background") == colors.base


def test_an_image_has_the_window_s_background_after_a_change_of_theme(qapp, qtbot):
    pane = ImagePane("Colour")
    qtbot.addWidget(pane)
    pane.show()
    for name in (*NAMES, NAMES[0]):
        apply_theme(qapp, name)
        qapp.processEvents()
        assert pane.view.grab().toImage().pixelColor(2, 2).name() == theme_colors().window


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


def test_a_note_is_in_the_colour_of_errors_for_errors_only(qapp, qtbot):
    apply_theme(qapp, "light")
    note = NoteLabel()
    qtbot.addWidget(note)
    usual = note.palette().color(QPalette.ColorRole.WindowText).name()
    note.say("No press stands out of the noise.", error=True)
    for name in ("dark", "light"):
        apply_theme(qapp, name)
        qapp.processEvents()
        assert note.palette().color(QPalette.ColorRole.WindowText).name() == theme_colors(name).error
    note.say("Applied.")
    assert note.palette().color(QPalette.ColorRole.WindowText).name() == usual
