from __future__ import annotations

import pyqtgraph as pg
import pytest
from PyQt6.QtCore import QRect, Qt
from PyQt6.QtGui import QPalette
from PyQt6.QtWidgets import QApplication, QCheckBox, QPushButton, QRadioButton, QVBoxLayout, QWidget

from contrast import contrast_ratio
from tactune.widgets.basics.controls import NoteLabel
from tactune.widgets.basics.style import apply_theme
from tactune.widgets.basics.theme import ACCENT, theme_colors, theme_name
from tactune.widgets.images.image_pane import ImagePane
from tactune.widgets.plots.histogram import RELATIVE_DIFFERENCE, LimitHistogram

NAMES = ("light", "dark")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("background", ["window", "base", "alternate", "button"])
@pytest.mark.parametrize("text", ["text", "muted", "accent_text", "error"])
def test_text_is_readable_on_every_background(name: str, background: str, text: str) -> None:
    colors = theme_colors(name)
    assert contrast_ratio(getattr(colors, text), getattr(colors, background)) >= 4.5


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("background", ["window", "base", "button"])
@pytest.mark.parametrize("line", ["outline", "focus"])
def test_fields_grooves_and_the_focus_are_seen(name: str, background: str, line: str) -> None:
    colors = theme_colors(name)
    assert contrast_ratio(getattr(colors, line), getattr(colors, background)) >= 3.0


@pytest.mark.parametrize("name", NAMES)
def test_a_theme_reaches_qt_and_pyqtgraph(qapp: QApplication, qtbot, name: str) -> None:
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


def test_what_paints_itself_follows_a_change_of_theme(qapp: QApplication, qtbot) -> None:
    histogram, message = LimitHistogram(RELATIVE_DIFFERENCE, 0.03), NoteLabel()
    pane = ImagePane("Proximity depth")
    message.say("out of range", error=True)
    for widget in (histogram, message, pane):
        qtbot.addWidget(widget)
    for name in ("dark", "light", "dark"):
        apply_theme(qapp, name)
        qapp.processEvents()
        colors = theme_colors(name)
        assert histogram.plot_widget.backgroundBrush().color().name() == colors.base
        assert pane.view.backgroundBrush().color().name() == colors.base
        assert message.palette().color(QPalette.ColorRole.WindowText).name() == colors.error


@pytest.mark.parametrize("name", NAMES)
def test_a_ring_shows_where_the_keyboard_acts(qapp: QApplication, qtbot, name: str) -> None:
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

    def edges() -> set[str]:
        image = window.grab(ring).toImage()
        return {image.pixelColor(x, y).name() for x, y in ((20, 0), (20, 1), (0, 10), (1, 10))}

    one.setFocus()
    assert edges() == {colors.window}
    qtbot.keyClick(one, Qt.Key.Key_Tab)
    qtbot.waitUntil(lambda: edges() == {colors.focus})
    qtbot.keyClick(two, Qt.Key.Key_Backtab)
    qtbot.waitUntil(lambda: edges() == {colors.window})
    apply_theme(qapp, "light")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", [QCheckBox, QRadioButton])
def test_a_box_to_tick_is_seen(qapp: QApplication, qtbot, name: str, kind: type[QWidget]) -> None:
    apply_theme(qapp, name)
    box = kind()
    qtbot.addWidget(box)
    box.show()
    image, colors = box.grab().toImage(), theme_colors(name)
    across = {image.pixelColor(x, image.height() // 2).name() for x in range(image.width())}
    for background in (colors.window, colors.base):
        assert max(contrast_ratio(pixel, background) for pixel in across) > 3
    apply_theme(qapp, "light")
