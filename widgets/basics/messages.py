"""Messages over a window's views: notes, warnings and errors with buttons that answer them. They push nothing aside."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from enum import StrEnum
from html import escape

from PyQt6.QtCore import QEvent, QObject, Qt, pyqtSignal
from PyQt6.QtGui import QKeyEvent, QPalette, QShowEvent
from PyQt6.QtWidgets import (
    QApplication,
    QFrame,
    QPlainTextEdit,
    QPushButton,
    QToolButton,
    QWidget,
)

from ...core.errors import TactuneError, as_sentence
from .controls import push_button, shortened, timer, tool_button, wrapped_label
from .layouts import STRETCH, hbox, vbox

#: Messages on the screen at once; older ones wait.
LIMIT = 3
#: Width of a message, and its distance from the edge of the views, in pixels.
_WIDTH_PX, _MARGIN_PX, _GAP_PX = 400, 8, 4
#: A note stays for this time and the time to read its characters, in ms.
NOTE_MS, CHARACTER_MS = 4000, 60
_SHOWN_OR_HIDDEN = (QEvent.Type.ShowToParent, QEvent.Type.HideToParent)


class Severity(StrEnum):
    """Severity of a message, shown as a coloured stripe (by the style sheet) and as its first word."""

    INFO = "Note"
    WARNING = "Warning"
    ERROR = "Error"


#: Text and action of a button.
Offer = tuple[str, Callable[[], object]]


def _make_card(frame: QFrame) -> None:
    frame.setFrameShape(QFrame.Shape.StyledPanel)
    frame.setAutoFillBackground(True)
    frame.setBackgroundRole(QPalette.ColorRole.AlternateBase)


class Message(QFrame):
    """One sentence with its buttons, optional details, and a button that dismisses it, as does Esc.

    A note without buttons goes by itself, but not while the pointer or the focus is on it.
    """

    def __init__(
        self,
        severity: Severity,
        sentence: str,
        details: str,
        subject: str,
        offers: Sequence[Offer],
        close: Callable[[], None],
        parent: QWidget,
    ) -> None:
        super().__init__(parent)
        _make_card(self)
        self.sentence, self.subject = sentence, subject
        self._close = close
        self.lasts = bool(offers) or severity is not Severity.INFO
        self.rank = 0 if severity is Severity.ERROR else 1 if self.lasts else 2
        self._goes = timer(self, NOTE_MS + CHARACTER_MS * len(sentence), self._leave, once=True)
        self.setAccessibleName(f"{severity}: {sentence}")

        text = wrapped_label(f"<b>{severity}.</b> {escape(shortened(sentence))}", selectable=True)
        text.setTextFormat(Qt.TextFormat.RichText)
        text.setMinimumWidth(1)  # a long word does not push the button aside
        dismiss = tool_button("", "Dismiss this message (Esc)", "Dismiss", icon_name="close")
        dismiss.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        dismiss.clicked.connect(close)
        body = vbox(hbox((text, 1), vbox(dismiss, STRETCH)), margins=(8, 4, 4, 4), spacing=4)
        answers: list[QWidget] = []
        if details:
            shown = QPlainTextEdit(details)
            shown.setReadOnly(True)
            shown.setMaximumHeight(160)
            shown.hide()
            body.addWidget(shown)
            more = QToolButton()
            more.setText("Details")
            more.setCheckable(True)
            more.toggled.connect(shown.setVisible)
            answers.append(more)
        for name, action in offers:
            button = push_button(name, "")
            button.clicked.connect(close)
            button.clicked.connect(lambda _=False, action=action: action())
            answers.append(button)
        if answers:
            body.addLayout(hbox(STRETCH, *answers))
        stripe = QFrame()
        stripe.setFixedWidth(5)
        stripe.setProperty("severity", str(severity))
        hbox(stripe, (body, 1), within=self, margins=0, spacing=0)

    def keyPressEvent(self, event: QKeyEvent | None) -> None:
        if event is not None and event.key() == Qt.Key.Key_Escape:
            self._close()
        else:
            super().keyPressEvent(event)

    def run(self) -> None:
        """Count the time of a note that goes by itself from now on."""
        if not self.lasts:
            self._goes.start()

    def _leave(self) -> None:
        focus = QApplication.focusWidget()
        if not self.isVisible() or self.underMouse() or (focus is not None and self.isAncestorOf(focus)):
            self._goes.start()
        else:
            self._close()

    def showEvent(self, event: QShowEvent | None) -> None:
        super().showEvent(event)
        self.run()


class Messages(QWidget):
    """The messages at the lower left over a widget, the newest on top. A message replaces an older one of its key.

    At most `LIMIT` are shown, fewer if the widget is low; errors come first, notes that go by themselves last. The
    others wait. ``free`` returns how many pixels stay free at the widget's lower edge; call `arrange` when it changes.
    With ``room_px`` all but a single large message keep to that height at the lower edge.
    """

    covers = pyqtSignal(int)  # height at the lower edge that messages cover, pixels

    def __init__(self, over: QWidget, free: Callable[[], int] = lambda: 0, room_px: int = 0) -> None:
        super().__init__(over)
        self._over, self._free, self._room_px = over, free, room_px
        self.by_key: dict[str, Message] = {}
        self._pinned: list[QFrame] = []
        over.installEventFilter(self)
        self.hide()

    def show_message(
        self,
        key: str,
        severity: Severity,
        sentence: str,
        offers: Sequence[Offer] = (),
        details: str = "",
        subject: str = "",
    ) -> None:
        """Show a sentence until it is dismissed, answered or replaced; a note without buttons also goes by itself.

        ``details`` are shown on request, such as a traceback; ``subject`` is for `clear_subject`.
        """
        old, sentence = self.by_key.get(key), as_sentence(sentence)
        if old is not None and old.sentence == sentence:
            old.run()
            return
        self._remove(key)
        self.by_key[key] = Message(severity, sentence, details, subject, offers, lambda: self._dismiss(key), self)
        self.arrange()
        self.setAccessibleName(f"{severity}: {sentence}")  # PyQt has no call that announces; a changed name is reported

    def state(self, key: str, severity: Severity, sentence: str, subject: str = "") -> None:
        if sentence:
            self.show_message(key, severity, sentence, subject=subject)
        else:
            self.clear(key)

    @contextmanager
    def telling(self, key: str, subject: str = "") -> Iterator[None]:
        """Show the message of a `TactuneError` that ends the block."""
        try:
            yield
        except TactuneError as error:
            self.show_message(key, Severity.ERROR, str(error), subject=subject)

    def clear(self, key: str) -> None:
        self._remove(key)
        self.arrange()

    def clear_subject(self, subject: str) -> None:
        """Dismiss the messages of a subject, because what they speak of is no longer there."""
        for key in [key for key, message in self.by_key.items() if message.subject == subject]:
            self._remove(key)
        self.arrange()

    def dismiss_newest(self) -> bool:
        shown = self._shown()
        if shown:
            self._dismiss(shown[0])
        return bool(shown)

    def focus_newest(self) -> bool:
        """Give the message on top the focus, on its first button; return whether there is one."""
        shown = self._shown()
        if shown:
            message = self.by_key[shown[0]]
            buttons = [*message.findChildren(QPushButton), *message.findChildren(QToolButton)]
            buttons[0].setFocus(Qt.FocusReason.ShortcutFocusReason)
        return bool(shown)

    def pin(self, frame: QFrame) -> None:
        """Put a frame, such as the progress of a job, below the messages; it is there while it is not hidden."""
        _make_card(frame)
        hidden = frame.isHidden()
        self._pinned.append(frame)
        frame.setParent(self)
        frame.setHidden(hidden)
        frame.installEventFilter(self)

    def move_over(self, over: QWidget) -> None:
        """Show the messages over another widget of the window from now on."""
        self._over.removeEventFilter(self)
        self._over = over
        self.setParent(over)
        over.installEventFilter(self)
        self.arrange()

    def sentences(self) -> list[str]:
        return [message.sentence for message in self.by_key.values()]

    def eventFilter(self, watched: QObject | None, event: QEvent | None) -> bool:
        if not self.__dict__:  # Python has cleared a closed window, Qt still hides its parts
            return False
        kind = event.type() if event is not None else None
        if kind == QEvent.Type.Resize if watched is self._over else kind in _SHOWN_OR_HIDDEN:
            self.arrange()
        return False

    def event(self, event: QEvent | None) -> bool:
        if event is not None and event.type() == QEvent.Type.LayoutRequest:
            self.arrange()
        return super().event(event)

    def _shown(self) -> list[str]:
        return [key for key in reversed(self.by_key) if not self.by_key[key].isHidden()]

    def _dismiss(self, key: str) -> None:
        message = self.by_key.get(key)
        focus = QApplication.focusWidget()
        if message is not None and focus is not None and message.isAncestorOf(focus):
            self._over.setFocus()
        self.clear(key)

    def _remove(self, key: str) -> None:
        message = self.by_key.pop(key, None)
        if message is not None:
            message.hide()
            message.deleteLater()

    def arrange(self) -> None:
        """Show as many messages as there is room for, at the lower left."""
        newest = list(reversed(self.by_key.values()))
        pinned = [frame for frame in self._pinned if not frame.isHidden()]
        width = min(_WIDTH_PX, self._over.width() - 2 * _MARGIN_PX)
        bottom = self._over.height() - self._free() - 2 * _MARGIN_PX
        room = self._room_px or bottom
        shown = sorted(newest, key=lambda message: message.rank)[:LIMIT]  # stable: the newest first of each rank
        heights = {frame: _height(frame, width) + _GAP_PX for frame in (*shown, *pinned)}
        while len(shown) > 1 and sum(heights[frame] for frame in (*shown, *pinned)) > room:
            shown.pop()
        y = 0
        for frame in (*newest, *pinned):
            frame.setVisible(frame in shown or frame in pinned)
            if not frame.isHidden():
                frame.setGeometry(0, y, width, heights[frame] - _GAP_PX)
                y += heights[frame]
        self.setGeometry(_MARGIN_PX, bottom + _MARGIN_PX - y, width, y)
        self.setMask(self.childrenRegion())  # beside a narrow frame the mouse reaches what is below
        self.setVisible(y > 0)
        self.raise_()
        self.covers.emit(y + _MARGIN_PX if y else 0)


def _height(frame: QFrame, width: int) -> int:
    return frame.heightForWidth(width) if frame.hasHeightForWidth() else frame.sizeHint().height()
