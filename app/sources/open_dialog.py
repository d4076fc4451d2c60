"""The dialog *Open…*: pages for each kind of source above the name of the chosen one."""

from __future__ import annotations

from collections.abc import Sequence

from PyQt6.QtCore import QSignalBlocker, pyqtSignal
from PyQt6.QtWidgets import (
    QDialog,
    QDialogButtonBox,
    QLineEdit,
    QListWidget,
    QStackedWidget,
    QWidget,
)

from ...core.errors import SourceError
from ...widgets.basics.controls import NoteLabel, ProgressBar, caption, dialog_buttons
from ...widgets.basics.layouts import hbox, vbox
from .pages import SourcePage

_SIZE = (820, 560)


class OpenDialog(QDialog):
    """Asks for a source. A page and the name always show the same choice, whichever was edited last.

    The dialog stays open until the source is: it shows the progress, and an error as a sentence.

    Signals
    -------
    requested(name: str)
        Open this source; then call `show_progress`, `show_failure` or `accept`.
    """

    requested = pyqtSignal(str)

    def __init__(self, pages: Sequence[SourcePage], parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Open")
        self.pages = pages
        self.list = QListWidget()
        self.list.addItems([page.title for page in pages])
        self.list.setAccessibleName("Kinds of sources")
        self.list.setToolTip("Where the frames come from")
        self.list.setFixedWidth(150)
        self.list.setSpacing(4)
        self._stack = QStackedWidget()
        for page in pages:
            self._stack.addWidget(page)
            page.changed.connect(self._page_changed)
            page.activated.connect(self._open)
        self.name = QLineEdit()
        self.name.setAccessibleName("Name of the source")
        self.name.setToolTip("Name of the source, as “tactune run --source” takes it, or a path")
        self.name.setPlaceholderText("sim:cup?press=low, or a path")
        self.name.setClearButtonEnabled(True)
        self.note = NoteLabel(lines=2)
        self.progress = ProgressBar("Opening…")
        self.progress.setAccessibleName("Progress of opening")
        self.buttons = dialog_buttons(QDialogButtonBox.StandardButton.Open | QDialogButtonBox.StandardButton.Cancel)
        self._lay_out()
        self.list.currentRowChanged.connect(self._page_chosen)
        self.name.textEdited.connect(self._typed)
        self.name.textChanged.connect(lambda text: self._allow(bool(text.strip())))
        self.buttons.accepted.connect(self._open)
        self.buttons.rejected.connect(self.reject)
        for page in pages:
            self.finished.connect(page.stop)

    @property
    def page(self) -> SourcePage:
        """The page that is shown."""
        return self.pages[self._stack.currentIndex()]

    def start_with(self, name: str) -> None:
        """Show a name and its page, the last one if no other knows it."""
        self.name.setText(name)
        if self._typed(name):
            self.page.come_up()
        else:
            self._switch_to(self.pages[-1])
        self.list.setFocus()

    def start_on(self, page: SourcePage) -> None:
        """Show a page and its choice."""
        self.list.setCurrentRow(self.pages.index(page))
        self.list.setFocus()

    def show_progress(self, share: float, words: str) -> None:
        """Show how far the source is opened."""
        self.progress.setRange(0, 100 if share > 0 else 0)
        self.progress.show_share(share, words or "Opening…")

    def show_failure(self, sentence: str) -> None:
        """Say why the source was not opened."""
        self._set_busy(False)
        self._say(sentence, error=True)
        self.name.setFocus()

    def _lay_out(self) -> None:
        above = hbox(self.list, (self._stack, 1))
        below = hbox(caption("&Name", self.name), (self.name, 1))
        vbox((above, 1), below, self.note, self.progress, self.buttons, within=self)
        self.progress.hide()
        self._allow(False)
        button = self.buttons.button(QDialogButtonBox.StandardButton.Open)
        if button is not None:
            button.setDefault(True)
        self.resize(*_SIZE)

    def _page_chosen(self, row: int) -> None:
        self._stack.setCurrentIndex(row)
        self.page.come_up()
        self._show_choice()

    def _page_changed(self) -> None:
        if self.sender() is self.page:
            self._show_choice()

    def _show_choice(self) -> None:
        """Show the name and the note of the page."""
        self.name.setText(self.page.name)
        self._say(self.page.note)

    def _typed(self, text: str) -> bool:
        """Move the page to a typed name; return whether one knows it."""
        self._say("")
        for page in self.pages:
            try:
                with QSignalBlocker(page):
                    known = page.show_name(text.strip())
            except SourceError as error:
                self._say(str(error), error=True)
                known = True
            if known:
                self._switch_to(page)
                return True
        return False

    def _switch_to(self, page: SourcePage) -> None:
        """Show a page, and leave the name as it is."""
        row = self.pages.index(page)
        self._stack.setCurrentIndex(row)
        self.list.blockSignals(True)
        self.list.setCurrentRow(row)
        self.list.blockSignals(False)

    def _open(self) -> None:
        name = self.name.text().strip()
        if name and not self.progress.isVisible():
            self._say("")
            self._set_busy(True)
            self.show_progress(0.0, "")
            self.requested.emit(name)

    def _set_busy(self, busy: bool) -> None:
        self.progress.setVisible(busy)
        for widget in (self.list, self._stack, self.name):
            widget.setEnabled(not busy)
        self._allow(not busy)

    def _say(self, sentence: str, error: bool = False) -> None:
        self.note.say(sentence, error)

    def _allow(self, allowed: bool) -> None:
        button = self.buttons.button(QDialogButtonBox.StandardButton.Open)
        if button is not None:
            button.setEnabled(allowed)
