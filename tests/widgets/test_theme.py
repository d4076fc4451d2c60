"""Colours of the themes, the focus ring, tooltips in lines of readable length, and the badge of an old image."""

import pyqtgraph as pg
import pytest
from PyQt6.QtCore import QPoint, QRect, Qt
from PyQt6.QtGui import QHelpEvent, QPalette
from PyQt6.QtWidgets import QApplication, QLabel, QPushButton, QToolTip, QVBoxLayout, QWidget

from contrast import contrast_ratio
from tactune.widgets.basics.style import apply_theme
from tactune.widgets.basics.theme import ACCENT, theme_colors, theme_name

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


#: Too long for one line, and narrower than the screen, above whose width Qt itself breaks lines.
LONG = "The share of the estimated rim that is eroded, because the membrane leaves the object at a tangent."
SHORT = "Frames per second"
WIDEST_PX = 420


@pytest.fixture(autouse=True)
def no_tip_before(qtbot):
    apply_theme(QApplication.instance(), "light")
    yield
    QToolTip.hideText()
    qtbot.waitUntil(lambda: not QToolTip.isVisible())


def tip_at(qtbot, widget, place):
    """Rest the pointer at a place of a widget; return the label in which Qt shows the tooltip."""
    event = QHelpEvent(QHelpEvent.Type.ToolTip, place, widget.mapToGlobal(place))
    QApplication.sendEvent(widget, event)
    qtbot.waitUntil(QToolTip.isVisible)
    [tip] = [label for label in QApplication.topLevelWidgets() if label.inherits("QTipLabel") and label.isVisible()]
    return tip


def assert_readable(tip, text):
    assert tip.text() == text
    assert tip.width() <= WIDEST_PX
    words = tip.fontMetrics().boundingRect(0, 0, tip.width(), 9999, Qt.TextFlag.TextWordWrap, text)
    assert tip.height() >= words.height()
    assert tip.screen().geometry().contains(tip.geometry())


def test_a_widget_and_another_right_after_it(qtbot):
    for text in (LONG, SHORT, LONG):
        label = QLabel("value")
        qtbot.addWidget(label)
        label.setToolTip(text)
        label.show()
        tip = tip_at(qtbot, label, QPoint(2, 2))
        assert_readable(tip, text)
        assert (tip.height() > 2 * tip.fontMetrics().height()) == (text is LONG)
