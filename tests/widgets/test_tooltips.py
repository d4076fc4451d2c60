"""Every tooltip is wrapped at about 60 characters: of widgets, menu entries, table headers and cells."""

from __future__ import annotations

import pytest
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtGui import QHelpEvent
from PyQt6.QtWidgets import QApplication, QLabel, QToolTip

from tactune.widgets.basics.style import apply_theme

#: Too long for one line, and narrower than the screen, above whose width Qt itself breaks lines.
LONG = "The share of the estimated rim that is eroded, because the membrane leaves the object at a tangent."
SHORT = "Frames per second"
WIDEST_PX = 420


@pytest.fixture(autouse=True)
def theme(qtbot):
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


def test_a_name_that_looks_like_markup_is_shown_as_it_is(qtbot):
    formats = []
    for text in ("<p><b>Drag</b> to orbit</p>", "folder:/data/<b>cup</b>"):
        label = QLabel("value")
        qtbot.addWidget(label)
        label.setToolTip(text)
        label.show()
        formats.append(tip_at(qtbot, label, QPoint(2, 2)).textFormat())
    assert formats == [Qt.TextFormat.RichText, Qt.TextFormat.PlainText]
