"""The search field of the mode bar: finds every action and every parameter by name, and runs or shows it."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from PyQt6.QtCore import QModelIndex, Qt, QTimer
from PyQt6.QtGui import QAction, QFocusEvent, QKeyEvent, QStandardItem, QStandardItemModel
from PyQt6.QtWidgets import QCompleter, QLineEdit, QToolTip

from ...widgets.basics.controls import named

#: What is found: its name, what is said beside it, and what choosing it does; None where it cannot be done now.
Entry = tuple[str, str, Callable[[], object] | None]

_DOES = Qt.ItemDataRole.UserRole + 1


class Search(QLineEdit):
    """Offers the entries whose names contain what is typed; Enter chooses the marked or first one; Esc leaves."""

    def __init__(self, entries: Callable[[], Iterable[Entry]], leave: Callable[[], object]) -> None:
        super().__init__()
        self._entries, self._leave = entries, leave
        self._model = QStandardItemModel(self)
        completer = self._completer = QCompleter(self._model, self)
        completer.setFilterMode(Qt.MatchFlag.MatchContains)
        completer.setCaseSensitivity(Qt.CaseSensitivity.CaseInsensitive)
        completer.setMaxVisibleItems(16)
        completer.activated[QModelIndex].connect(self._choose)
        self.setCompleter(completer)
        self.setPlaceholderText("Search (Ctrl+Shift+P)")
        named(self, "Search", "Find every action and parameter by name (Ctrl+Shift+P). Enter runs or shows the first")
        self.setClearButtonEnabled(True)
        self.setMinimumWidth(120)
        self.textEdited.connect(lambda _: QTimer.singleShot(0, self._tell_nothing_found))  # after the completer

    def begin(self) -> None:
        self.setFocus(Qt.FocusReason.ShortcutFocusReason)
        self.selectAll()

    def focusInEvent(self, event: QFocusEvent | None) -> None:
        """Read the entries now: their names and what is possible change."""
        if event is not None and event.reason() != Qt.FocusReason.PopupFocusReason:
            self._model.clear()
            for name, beside, act in self._entries():
                item = QStandardItem(f"{name}   {beside}".rstrip())
                item.setEnabled(act is not None)
                item.setData(act, _DOES)
                self._model.appendRow(item)
        super().focusInEvent(event)

    def keyPressEvent(self, event: QKeyEvent | None) -> None:
        key = None if event is None else event.key()
        if key in (Qt.Key.Key_Return, Qt.Key.Key_Enter) and self.text():
            popup, found = self._completer.popup(), self._completer.completionModel()
            rows = [] if found is None else [found.index(row, 0) for row in range(found.rowCount())]
            if popup is not None and popup.isVisible() and popup.currentIndex().isValid():
                rows = [popup.currentIndex()]  # the popup hands Enter on to this field
            chosen = next((row for row in rows if row.data(_DOES) is not None), None)
            if chosen is not None:
                self._choose(chosen)
        elif key == Qt.Key.Key_Escape:
            self.clear()
            self._leave()
        else:
            super().keyPressEvent(event)

    def _tell_nothing_found(self) -> None:
        nothing = self.text() and self._completer.completionCount() == 0
        words = f"No action or parameter is named “{self.text()}”." if nothing else ""
        QToolTip.showText(self.mapToGlobal(self.rect().bottomLeft()), words, self)

    def _choose(self, index: QModelIndex) -> None:
        act = index.data(_DOES)
        popup = self._completer.popup()
        if popup is not None:
            popup.hide()
        QTimer.singleShot(0, self.clear)  # the completer writes the chosen name after this
        self._leave()
        if act is not None:
            QTimer.singleShot(0, act)


def of_action(name: str, action: QAction) -> Entry:
    """Return the entry that triggers an action."""
    return name, action.shortcut().toString(), action.trigger if action.isEnabled() else None
