"""Every window: texts that can be read in both themes, controls for keyboard and screen reader, nothing cut."""

import numpy as np
import pytest
from PyQt6.QtCore import QPoint, QSize, Qt
from PyQt6.QtGui import QImage, QKeySequence
from PyQt6.QtWidgets import (
    QAbstractButton,
    QAbstractItemView,
    QAbstractScrollArea,
    QAbstractSlider,
    QAbstractSpinBox,
    QApplication,
    QCheckBox,
    QComboBox,
    QDialogButtonBox,
    QLabel,
    QLineEdit,
    QPushButton,
    QRadioButton,
    QScrollArea,
    QScrollBar,
    QStackedWidget,
    QTabBar,
    QTabWidget,
    QToolButton,
    QWidget,
)
from pytestqt.qtbot import QtBot

from colour_vision import contrast_ratio
from fakes import FakeSource
from hands import show_source
from tactune.widgets.basics.controls import ElidedLabel

#: The room of a window on a screen of 1024 x 700.
SMALL = QSize(1008, 660)
ACTIONS = (
    "calibrate",
    "check_drift",
    "open_source",
    "camera_settings",
    "suggest_all",
)
#: The main window in each mode.
MODES = ("set_up", "tune", "run")
#: The window of the analyses has its tabs as pages.
NAMES = (*MODES, *ACTIONS, "tilt")
#: What needs a tooltip, too; over a view or an image one would be in the way.
CONTROLS = (QAbstractButton, QComboBox, QLineEdit, QAbstractSpinBox, QAbstractSlider, QAbstractItemView)
#: Buttons whose words say all.
PLAIN = ("ok", "cancel", "close", "open", "save", "choose")


@pytest.fixture(scope="module", params=["dark", "light"])  # the last one stays for the tests that follow
def main(request, qapp, shared, preset, tmp_path_factory):
    """One main window a theme: to change the theme under many open windows takes longer than to begin again."""
    shared.close()
    robot = QtBot(request)
    window = shared.ready(robot, tmp_path_factory.mktemp("main"), preset)
    window.set_theme(request.param, remember=False)
    show_source(robot, window, FakeSource(), 3)
    return window


@pytest.fixture(params=NAMES)
def shown(request, main, qtbot):
    """One window after the other."""
    if request.param in MODES:
        getattr(main.actions_, request.param).trigger()
        return main
    before = set(tops())
    actions = main.analysis.actions
    action = actions[request.param] if request.param in actions else getattr(main.actions_, request.param)
    action.trigger()
    qtbot.waitUntil(lambda: len(set(tops()) - before) == 1)
    (made,) = set(tops()) - before
    return made


def tops():
    windows = [widget for widget in QApplication.topLevelWidgets() if widget.isVisible()]
    return [window for window in windows if window.windowType() != Qt.WindowType.ToolTip]


def pages(window, qtbot):
    """Turn to every page of the window's stack, if it has one."""
    stacks = [stack for stack in window.findChildren(QStackedWidget) if stack.isVisible() and stack.count() > 1]
    in_tabs = window.findChild(QTabWidget)
    book = in_tabs or (stacks[0] if stacks else None)
    for page in range(book.count() if book is not None else 1):
        if book is not None and book.isVisible():
            book.setCurrentIndex(page)
        settle()
        yield page


def settle():
    for _ in range(3):  # a page that was just made lays itself out in steps
        QApplication.processEvents()


def within(window, kind):
    return [widget for widget in window.findChildren(kind) if widget.isVisible() and widget.isEnabled()]


def said(widget):
    """Return the name that Qt gives a screen reader: the accessible one, a button's words, or those of its label."""
    if widget.accessibleName():
        return widget.accessibleName()
    if isinstance(widget, QAbstractButton):
        return widget.text()
    return next((label.text() for label in widget.window().findChildren(QLabel) if label.buddy() is widget), "")


def described(widget):
    text = getattr(widget, "text", str)()
    return f"{type(widget).__name__} {text or said(widget)!r} in {type(widget.parent()).__name__}"


def place(widget, window):
    """Return what is seen of a widget, in coordinates of the window."""
    seen = widget.visibleRegion().boundingRect()
    return seen.translated(widget.mapTo(window, QPoint(0, 0)))


def sharpest(image, rect):
    """Return the contrast of the most different pixel against the most frequent one."""
    part = image[rect.top() : rect.bottom() + 1, rect.left() : rect.right() + 1]
    pixels, counts = np.unique(part & 0xFFFFFF, return_counts=True)
    background = f"#{pixels[counts.argmax()]:06x}"
    return max(contrast_ratio(f"#{pixel:06x}", background) for pixel in pixels)


def pixels_of(window):
    """Return the picture of a window, (height, width) of 0xAARRGGBB."""
    image = window.grab().toImage().convertToFormat(QImage.Format.Format_RGB32)
    return np.frombuffer(image.constBits().asarray(image.sizeInBytes()), np.uint32).reshape(image.height(), -1).copy()


def test_every_window_can_be_read_reached_and_seen_whole(shown, main, qtbot):
    missing, faint = set(), set()
    for page in pages(shown, qtbot):
        missing |= unreachable(shown, main)
        faint |= {(page, *each) for each in unreadable(shown)}
    size = QSize(960, 500) if shown is main else SMALL
    shown.resize(shown.size().boundedTo(size))
    cut = set().union(*(cut_off(shown, page, size) for page in pages(shown, qtbot)))
    assert (missing, faint, cut) == (set(), set(), set())


def unreadable(shown):
    faint = set()
    image = pixels_of(shown)
    for widget in [w for kind in (QLabel, QAbstractButton, QComboBox, QLineEdit) for w in within(shown, kind)]:
        text = widget.currentText() if isinstance(widget, QComboBox) else widget.text()
        rect = place(widget, shown)
        if isinstance(widget, (QCheckBox, QRadioButton)):
            rect.setLeft(rect.left() + 22)  # the box is not the text
        # One letter may have no stroke that covers a whole pixel.
        if len(text.strip()) > 1 and rect.width() > 8 and rect.height() > 8:
            contrast = sharpest(image, rect)
            if contrast < 4.5:
                faint.add((described(widget), round(contrast, 1)))
    return faint


def unreachable(shown, window):
    missing = set()
    by_menu = {action for action in window.actions_.by_name().values() if not action.shortcut().isEmpty()}
    for widget in controls(shown):
        reached = bool(widget.focusPolicy() & Qt.FocusPolicy.TabFocus) or (
            isinstance(widget, QAbstractButton)
            and (
                not widget.shortcut().isEmpty()
                or (isinstance(widget, QToolButton) and widget.defaultAction() in by_menu)
                or (widget.group() is not None and widget.group().exclusive())  # arrow keys
            )
        )
        in_box = isinstance(widget.parent(), QDialogButtonBox)
        plain = isinstance(widget, QAbstractButton) and widget.text().replace("&", "").lower() in PLAIN
        if not said(widget):
            missing.add(("name", described(widget)))
        if isinstance(widget, CONTROLS) and not (told(widget, shown) or in_box or plain):
            missing.add(("tooltip", described(widget)))
        if not reached:
            missing.add(("key", described(widget)))
        if isinstance(widget, QPushButton) and shown is not window and not keys_of([widget]):
            missing.add(("mnemonic", described(widget)))
    used = keys_of([*within(shown, QAbstractButton), *within(shown, QLabel)]) if shown is not window else []
    return missing | {("two have this mnemonic", key) for key in used if used.count(key) > 1}


def keys_of(widgets):
    """Return the letters that press a button with Alt, or go to the field of a label."""
    texts = [each.text() for each in widgets if not isinstance(each, QLabel) or each.buddy() is not None]
    return [key for text in texts if (key := QKeySequence.mnemonic(text).toString())]


def told(widget, window):
    """Tell whether pointing at a widget shows a tooltip, its own or that of what it is part of."""
    while widget is not window and widget is not None:
        if widget.toolTip():
            return True
        widget = widget.parentWidget()
    return False


def controls(window):
    """Return what a person can act on; parts of a control do not count."""
    found = []
    for widget in within(window, QWidget):
        part = (
            isinstance(widget.parent(), (QAbstractSpinBox, QComboBox, QTabBar, QAbstractItemView, QLineEdit))
            or isinstance(widget, (QScrollBar, QTabBar, QScrollArea, QLabel))
            or widget.objectName().startswith("qt_")
            or (isinstance(widget.parent(), QAbstractScrollArea) and widget.parent().viewport() is widget)
        )
        takes_keys = widget.focusPolicy() & Qt.FocusPolicy.TabFocus and not isinstance(
            widget, (QTabWidget, QAbstractScrollArea)
        )
        if not part and (isinstance(widget, CONTROLS) or takes_keys):
            found.append(widget)
    return found


def cut_off(shown, page, size):
    assert shown.width() <= size.width() and shown.height() <= size.height(), (page, shown.minimumSizeHint())
    cut = set()
    for widget in within(shown, QLabel) + within(shown, QAbstractButton):
        least = widget.minimumSizeHint()
        if isinstance(widget, ElidedLabel):
            continue
        if isinstance(widget, QLabel) and widget.wordWrap():
            least = QSize(0, widget.heightForWidth(widget.width()))
        if isinstance(widget, QAbstractButton) and not widget.icon().isNull():
            continue
        if isinstance(widget, QAbstractButton):
            least = widget.fontMetrics().size(Qt.TextFlag.TextShowMnemonic, widget.text())
        if widget.width() < least.width() or widget.height() < least.height():
            cut.add((page, described(widget), widget.size(), least))
    return cut
