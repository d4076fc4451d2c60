"""User input for windows: real mouse and key events."""

from __future__ import annotations

from PyQt6.QtCore import QMimeData, QPoint, QPointF, Qt, QUrl
from PyQt6.QtGui import QDragEnterEvent, QDropEvent, QWheelEvent
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication, QFileDialog, QLabel, QLineEdit, QMessageBox, QPushButton, QSlider, QStyle

from fakes import at_rest
from tactune.app.worker.reading import SourceRequest
from tactune.widgets.basics.messages import Message

LEFT = Qt.MouseButton.LeftButton
CONTROL = Qt.KeyboardModifier.ControlModifier
CONTROL_SHIFT = CONTROL | Qt.KeyboardModifier.ShiftModifier


def shown(qtbot, widget, *size):
    """Show a widget in a window of its own, which has the keyboard."""
    qtbot.addWidget(widget)
    widget.resize(*size)
    widget.show()
    qtbot.waitExposed(widget)
    widget.activateWindow()
    qtbot.waitUntil(widget.isActiveWindow)
    return widget


def turn_wheel(widget, at, notches, receiver=None):
    """Turn the wheel over a place of a widget; its events are sent to the receiver."""
    receiver = receiver or widget
    event = QWheelEvent(
        widget.mapTo(receiver, at), widget.mapToGlobal(at), QPoint(), QPoint(0, 120 * notches),
        Qt.MouseButton.NoButton, Qt.KeyboardModifier.NoModifier, Qt.ScrollPhase.NoScrollPhase, False,
    )  # fmt: skip
    QApplication.sendEvent(receiver, event)
    QApplication.processEvents()


def drag_slider(slider, *fractions):
    """Press at the handle's place for the first fraction, move through the others, let go."""
    if isinstance(slider, QSlider):
        handle = slider.style().pixelMetric(QStyle.PixelMetric.PM_SliderLength, None, slider)
        start, length = handle / 2, slider.width() - handle
    else:
        start, length = slider.travel()
    points = [QPoint(round(start + fraction * length), slider.height() // 2) for fraction in fractions]
    QTest.mousePress(slider, LEFT, pos=points[0])
    for point in points[1:]:
        QTest.mouseMove(slider, point)
    QTest.mouseRelease(slider, LEFT, pos=points[-1])


def show_source(qtbot, window, source, index=None):
    """Open a source and wait for a frame of it; with an index, stand still at that frame."""
    before = None if window.result is None else window.result.source
    window.open_request(SourceRequest(source.name, lambda progress: source))
    qtbot.waitUntil(lambda: window.result is not None and window.result.source is not before)
    if index is not None:
        window.worker.pause()
        window.worker.seek(index)
        qtbot.waitUntil(lambda: at_rest(window, index))


def type_into(entry, text, end=Qt.Key.Key_Return):
    """Replace what an entry holds, and finish with a key."""
    entry.setFocus()
    entry.selectAll()
    QTest.keyClicks(entry, text)
    QTest.keyClick(entry, end)


def text_of(widget):
    """The text of all labels in a widget."""
    return " ".join(label.text() for label in widget.findChildren(QLabel))


def cells(table):
    """The texts of a table, row by row."""
    model = table.model()
    columns = range(model.columnCount())
    return [[model.index(row, column).data() for column in columns] for row in range(model.rowCount())]


def image_position(pane, u, v):
    """Where an image pixel is drawn, in coordinates of the pane's viewport."""
    return QPointF(pane.view.mapFromScene(pane.box.mapViewToScene(QPointF(u, v))))


def strip_position(strip, index):
    """Where the time of a frame is drawn in a time strip, in coordinates of its plot."""
    plot = strip.plot_widget
    return QPointF(
        plot.mapFromScene(plot.getPlotItem().getViewBox().mapViewToScene(QPointF(strip.seconds[index], 0.0)))
    )


def tolerance_slider(window):
    slider = window.panel.rows["tolerance.t"].widget.slider
    window.panel.ensureWidgetVisible(slider)
    return slider


def shows_preset_of_document(window):
    return window.result is not None and window.result.preset is window.document.preset


def answer_question(qtbot, answer):
    """Press a button of the question that is open, by its text, or Escape; return what the question says."""
    qtbot.waitUntil(lambda: isinstance(QApplication.activeModalWidget(), QMessageBox))
    box = QApplication.activeModalWidget()
    words = f"{box.text()} {box.informativeText()}"
    if answer == "escape":
        QTest.keyClick(box, Qt.Key.Key_Escape)
    else:
        [button] = [button for button in box.buttons() if button.text().replace("&", "").lower() == answer.lower()]
        QTest.mouseClick(button, LEFT)
    return words


def type_path(qtbot, path):
    """Paste a path into the file dialog that is open and press Enter."""
    qtbot.waitUntil(lambda: isinstance(QApplication.activeModalWidget(), QFileDialog))
    dialog = QApplication.activeModalWidget()
    entry = dialog.findChild(QLineEdit, "fileNameEdit")
    entry.selectAll()
    QApplication.clipboard().setText(str(path))
    QTest.keyClick(entry, Qt.Key.Key_V, CONTROL)
    suggestions = entry.completer().popup()
    if suggestions.isVisible():
        QTest.keyClick(suggestions, Qt.Key.Key_Escape)
    QTest.keyClick(entry, Qt.Key.Key_Return)


def drop(window, *paths):
    data = QMimeData()
    data.setUrls([QUrl.fromLocalFile(str(path)) for path in paths])
    place, action, none = QPointF(200, 200), Qt.DropAction.CopyAction, Qt.KeyboardModifier.NoModifier
    enter = QDragEnterEvent(place.toPoint(), action, data, LEFT, none)
    QApplication.sendEvent(window, enter)
    assert enter.isAccepted()
    QApplication.sendEvent(window, QDropEvent(place, action, data, LEFT, none))


def press(message: Message, text: str) -> None:
    [button] = [button for button in message.findChildren(QPushButton) if button.text() == text]
    QTest.mouseClick(button, LEFT)
