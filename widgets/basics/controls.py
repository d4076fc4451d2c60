"""Controls that several windows share: buttons, labels, progress bars, a collapsible section; gestures of editing."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterable
from typing import TypeVar

from PyQt6.QtCore import QEvent, QObject, QSize, Qt, QTimer, pyqtSignal
from PyQt6.QtGui import QAction, QColor, QKeyEvent, QKeySequence, QPainter, QPaintEvent, QPalette, QShortcut
from PyQt6.QtWidgets import (
    QAbstractButton,
    QComboBox,
    QDialogButtonBox,
    QFrame,
    QLabel,
    QProgressBar,
    QPushButton,
    QSizePolicy,
    QToolButton,
    QWidget,
)

from .icons import icon
from .layouts import hbox, vbox
from .theme import text_font, theme_colors

_Widget = TypeVar("_Widget", bound=QWidget)


def shortened(sentence: str) -> str:
    """Return a sentence of at most 600 characters; the centre of a longer one, such as a name of any length, goes."""
    return sentence if len(sentence) <= 600 else f"{sentence[:300]} … {sentence[-300:]}"


def named(widget: _Widget, name: str, tip: str = "") -> _Widget:
    """Give a widget its name for screen readers and its tooltip, which is the name where there is no other."""
    widget.setAccessibleName(name)
    widget.setToolTip(tip or name)
    return widget


def timer(parent: QObject | None, interval_ms: int, call: Callable[[], object], *, once: bool = False) -> QTimer:
    """Return a timer, not started yet, that calls a method again and again, or once."""
    made = QTimer(parent)
    made.setSingleShot(once)
    made.setInterval(interval_ms)
    made.timeout.connect(call)  # no lambda: Qt would call it after Python has cleared a closed window
    return made


# Buttons


def push_button(text: str, tip: str, shortcut: str = "") -> QPushButton:
    """Return a button with a tooltip that Enter does not press by itself."""
    button = QPushButton(text)
    button.setToolTip(tip)
    button.setAutoDefault(False)
    if shortcut:  # beside the mnemonic, which `setShortcut` would replace
        QShortcut(QKeySequence(shortcut), button).activated.connect(button.click)
    return button


def choice_button(text: str, tip: str, shortcut: str = "") -> QPushButton:
    """Return a checkable button; the style fills checked ones with the accent colour."""
    button = push_button(text, tip, shortcut)
    button.setCheckable(True)
    return button


def tool_button(text: str, tip: str, name: str = "", *, icon_name: str = "", checkable: bool = False) -> QToolButton:
    """Return a small button that takes the focus; one with an icon is flat. ``name`` is for screen readers."""
    button = QToolButton()
    button.setText(text)
    button.setToolTip(tip)
    button.setAccessibleName(name)
    if icon_name:
        button.setIcon(icon(icon_name))
        button.setAutoRaise(True)
    button.setCheckable(checkable)
    button.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
    return button


def free_space_bar(window: QWidget, event: QEvent | None) -> None:
    """Take the focus from a button that was clicked before the space bar reaches it; one reached by a key keeps it."""
    if not isinstance(event, QKeyEvent) or event.key() != Qt.Key.Key_Space:
        return
    clicked = not window.testAttribute(Qt.WidgetAttribute.WA_KeyboardFocusChange)
    if event.type() == QEvent.Type.ShortcutOverride and clicked and isinstance(window.focusWidget(), QAbstractButton):
        window.setFocus()


def keep_place(widget: QWidget, keep: bool = True) -> None:
    """Let a widget keep its place in its layout while it is hidden, so that nothing moves."""
    policy = widget.sizePolicy()
    policy.setRetainSizeWhenHidden(keep)
    widget.setSizePolicy(policy)


def action_button(action: QAction, kind: str = "", *, with_text: bool = False) -> QToolButton:
    """Return a flat button with the icon of an action; only the Tab key takes the focus there.

    With text it is not flat, and a shorter text later does not make it narrower. ``kind`` is a property of that name
    for the style sheet.
    """
    button = QToolButton()
    if kind:
        button.setProperty(kind, True)
    button.setDefaultAction(action)
    button.setAutoRaise(not with_text)
    button.setFocusPolicy(Qt.FocusPolicy.TabFocus)
    if with_text:
        button.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextBesideIcon)
        button.setMinimumWidth(button.sizeHint().width())
    return button


class FoldButton(QToolButton):
    """The button above a body that folds: an arrow and a title over the whole width."""

    folded = pyqtSignal(bool)

    def __init__(self, title: str, name: str, tip: str, body: QWidget) -> None:
        super().__init__()
        self._body, self.is_folded = body, False
        named(self, name, tip)
        self.setText(title)
        self.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextBesideIcon)
        self.setAutoRaise(True)
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.setArrowType(Qt.ArrowType.DownArrow)
        self.clicked.connect(lambda: self.fold(not self.is_folded))

    def fold(self, folded: bool) -> None:
        self.is_folded = folded
        self._body.setHidden(folded)
        self.setArrowType(Qt.ArrowType.RightArrow if folded else Qt.ArrowType.DownArrow)
        self.folded.emit(folded)


def dialog_buttons(standard: QDialogButtonBox.StandardButton) -> QDialogButtonBox:
    """Return a row of standard buttons; Close is never the primary one."""
    box = QDialogButtonBox(standard)
    add_mnemonics(box.buttons())
    close = box.button(QDialogButtonBox.StandardButton.Close)
    if close is not None:
        close.setAutoDefault(False)
    return box


def add_mnemonics(buttons: Iterable[QAbstractButton]) -> None:
    """Let Alt with its first letter press each standard button that the desktop gave no key."""
    for button in buttons:
        if "&" not in button.text():
            button.setText(f"&{button.text()}")


# Labels


def caption(text: str, control: QWidget) -> QLabel:
    label = QLabel(text)
    label.setBuddy(control)
    return label


def wrapped_label(text: str = "", *, verdict: bool = False, selectable: bool = False) -> QLabel:
    """Return a label for sentences, which may take several lines and, if ``selectable``, can be copied."""
    label = QLabel(text)
    label.setWordWrap(True)
    if verdict:
        label.setFont(text_font("title", bold=True))
    if selectable:
        label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
    return label


def heading(text: str = "") -> QLabel:
    label = QLabel(text)
    label.setFont(text_font("body", bold=True))
    return label


class TintedLabel(QLabel):
    """A label in one of the theme's colours, a field of `ThemeColors`; empty: the usual one of text."""

    def __init__(self, text: str = "", color: str = "") -> None:
        super().__init__(text)
        self._color = ""
        self.tint(color)

    def tint(self, color: str) -> None:
        before, self._color = self._color, color  # first: a change of the palette tints again
        if color or before:
            palette = QPalette()
            if color:
                palette.setColor(QPalette.ColorRole.WindowText, QColor(getattr(theme_colors(), color)))
            self.setPalette(palette)

    def changeEvent(self, event: QEvent | None) -> None:
        """Follow the theme. A connection to `THEME` would outlive the label: PyQt removes it when it next emits."""
        super().changeEvent(event)
        if event is not None and event.type() == QEvent.Type.PaletteChange and self._color:
            self.tint(self._color)


class NoteLabel(TintedLabel):
    """A wrapped sentence that can be selected; ``lines`` keeps room for a longer one, so that it moves nothing."""

    def __init__(self, text: str = "", lines: int = 1) -> None:
        super().__init__(text)
        self.setWordWrap(True)
        self.setMinimumWidth(1)  # a long word widens no window
        self.setTextFormat(Qt.TextFormat.PlainText)
        self.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        if lines > 1:
            self.setMinimumHeight(lines * self.fontMetrics().height())
            self.setAlignment(Qt.AlignmentFlag.AlignTop)

    def say(self, sentence: str, error: bool = False) -> None:
        self.tint("error" if error else "")
        self.setText(shortened(sentence))


def number_label(widest: str, tip: str) -> TintedLabel:
    """Return a label wide enough for its widest text, so that nothing moves as numbers change."""
    label = TintedLabel()
    label.setToolTip(tip)
    label.setMinimumWidth(label.fontMetrics().horizontalAdvance(widest))
    return label


class ElidedLabel(QLabel):
    """Plain text in a line that accepts any width; the tooltip has the whole text if it is elided."""

    def __init__(self, text: str = "") -> None:
        super().__init__(text)
        self.setTextFormat(Qt.TextFormat.PlainText)
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)

    def sizeHint(self) -> QSize:
        return QSize(0, self.fontMetrics().height() + 4)  # also while empty: nothing jumps

    minimumSizeHint = sizeHint

    def paintEvent(self, _: QPaintEvent | None) -> None:
        shown = self.fontMetrics().elidedText(self.text(), Qt.TextElideMode.ElideRight, self.width() - 4)
        tip = "" if shown == self.text() else self.text()
        if tip != self.toolTip():  # each call tells every widget above, also without a change
            self.setToolTip(tip)
        painter = QPainter(self)
        painter.setPen(self.palette().windowText().color())
        painter.drawText(self.rect().adjusted(2, 0, -2, 0), Qt.AlignmentFlag.AlignVCenter, shown)


# Entries and tables


class ChoiceBox(QComboBox):
    """A list to choose from, in which a letter chooses an entry and is no shortcut of the window."""

    def event(self, event: QEvent | None) -> bool:
        if isinstance(event, QKeyEvent) and event.type() == QEvent.Type.ShortcutOverride:
            held = event.modifiers() & ~(Qt.KeyboardModifier.ShiftModifier | Qt.KeyboardModifier.KeypadModifier)
            if held == Qt.KeyboardModifier.NoModifier and event.text().strip().isprintable() and event.text().strip():
                event.accept()
                return True
        return super().event(event)


# Progress


class ProgressBar(QProgressBar):
    """The share of a job that is done, in percent or as the current step in one line, which is elided to fit."""

    def __init__(self, words: str = "") -> None:
        super().__init__()
        self._words = words
        self.setRange(0, 100)

    def show_share(self, share: float, words: str | None = None) -> None:
        """Show a share, 0 to 1, where 0 means unknown, and the step, or keep the words."""
        if words is not None and words != self._words:
            self._words = words
            self.updateGeometry()
        self.setRange(0, 100 if share > 0 else 0)
        self.setValue(round(100 * share))
        self.update()

    def text(self) -> str:
        done = f"{self.value()} %" if self.maximum() else ""  # a bar without an end says only the step
        words = ", ".join(filter(None, (self._words, done)))
        return self.fontMetrics().elidedText(words, Qt.TextElideMode.ElideRight, self.width() - 8)

    def sizeHint(self) -> QSize:
        return QSize(self.fontMetrics().horizontalAdvance(f"{self._words}, 100 %") + 24, super().sizeHint().height())

    def minimumSizeHint(self) -> QSize:
        return QSize(100, super().minimumSizeHint().height())


class ProgressCard(QFrame):
    """What a job does, its progress, and a Cancel button with the tooltip ``tip``; hidden while there is no job."""

    def __init__(self, name: str, tip: str) -> None:
        super().__init__()
        self._words = NoteLabel()
        self._bar = ProgressBar()
        self._bar.setAccessibleName(name)
        self.cancel = push_button("Cancel", tip)
        row = hbox((self._bar, 1), self.cancel)
        vbox(self._words, row, within=self, margins=(8, 4, 4, 4), spacing=4)
        self.hide()

    def show_share(self, share: float, words: str) -> None:
        """Show a share, 0 to 1, and the step; a share of 0 means unknown."""
        self._words.setText(words)
        self._bar.setTextVisible(share > 0)
        self._bar.show_share(share)
        self.show()


class CollapsibleSection(QFrame):
    """A titled section: a header button that folds the body; what is added to ``header`` stays when it is folded."""

    def __init__(self, title: str) -> None:
        super().__init__()
        self.body = QWidget()
        self.button = FoldButton(title, f"{title} section", f"Fold or unfold {title.lower()}", self.body)
        self.button.setFont(text_font("body", bold=True))
        self.header = hbox((self.button, 1), margins=(4, 0, 4, 0), spacing=4)
        vbox(self.header, self.body, within=self, margins=0, spacing=0)


#: All edits of one drag, or of one burst of keys, share a number.
_gesture_numbers = itertools.count(1)

#: Key presses or wheel steps within this time of each other belong to one gesture, seconds.
BURST_S = 0.8


def new_gesture() -> int:
    """Return a number that is unique in this process; never 0."""
    return next(_gesture_numbers)


class GestureClock:
    """Assigns edits of a widget to gestures."""

    def __init__(self) -> None:
        self.held = False  # a mouse button is down
        self._number = 0
        self._last_s = 0.0

    def hold(self) -> None:
        self._number = new_gesture()
        self.held = True

    def release(self) -> None:
        """End the drag, or the burst of keys; the next edit is another gesture."""
        self.held = False
        self._number = 0

    def number(self) -> int:
        now_s = time.monotonic()
        if not self.held and (self._number == 0 or now_s - self._last_s > BURST_S):
            self._number = new_gesture()
        self._last_s = now_s
        return self._number
