"""The dialog *Open…*: cameras, files and recent sources, above the name of the chosen one."""

from __future__ import annotations

from collections.abc import Sequence

from PyQt6.QtCore import QObject, QSignalBlocker, pyqtSignal
from PyQt6.QtWidgets import QDialog, QDialogButtonBox, QLineEdit, QPushButton, QTabWidget, QWidget

from ...core.sources.base import split_topics
from ...widgets.basics.controls import NoteLabel, ProgressBar, caption, dialog_buttons, named
from ...widgets.basics.layouts import hbox, vbox
from ..context import Context
from .cameras_page import CAMERAS, CamerasPage
from .pages import FilesPage, SourcePage

_SIZE = (820, 560)
#: Places of the pages.
_CAMERAS, _FILES = range(2)


class OpenDialog(QDialog):
    """Asks for a source, on a page or by its name, and stays open, with progress and errors, until the source is."""

    requested = pyqtSignal(str)  # name of the source to open

    def __init__(self, pages: Sequence[SourcePage], parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Open")
        self.pages = pages
        self.tabs = QTabWidget()
        for page in pages:
            self.tabs.addTab(page, page.title)
            page.changed.connect(self._page_changed)
            page.activated.connect(self._open)
            self.finished.connect(page.stop)
        tip = "Name of the source, as “tactune run --source” takes it, or a path"
        self.name = named(QLineEdit(), "Name of the source", tip)
        self.name.setPlaceholderText("sim:cup?press=low, or a path")
        self.name.setClearButtonEnabled(True)
        self.note = NoteLabel(lines=2)
        self.progress = ProgressBar("Opening…")
        self.progress.setAccessibleName("Progress of opening")
        self.buttons = dialog_buttons(QDialogButtonBox.StandardButton.Open | QDialogButtonBox.StandardButton.Cancel)
        name = hbox(caption("&Name", self.name), (self.name, 1))
        vbox((self.tabs, 1), name, self.note, self.progress, self.buttons, within=self)
        self.progress.hide()
        self._button = self.buttons.button(QDialogButtonBox.StandardButton.Open) or QPushButton()
        self._button.setDefault(True)
        self._button.setEnabled(False)
        self.resize(*_SIZE)
        self.tabs.currentChanged.connect(self._page_chosen)
        self.name.textEdited.connect(lambda _: self.note.say(""))
        self.name.textChanged.connect(lambda text: self._button.setEnabled(bool(text.strip())))
        self.buttons.accepted.connect(self._open)
        self.buttons.rejected.connect(self.reject)

    @property
    def page(self) -> SourcePage:
        return self.pages[self.tabs.currentIndex()]

    def start_on(self, index: int) -> None:
        with QSignalBlocker(self.tabs):
            self.tabs.setCurrentIndex(index)
        self._page_chosen()
        self.name.setFocus()  # what is typed now is a name, in place of the chosen one
        self.name.selectAll()

    def show_progress(self, share: float, words: str) -> None:
        self.progress.show_share(share, words or "Opening…")

    def show_failure(self, sentence: str) -> None:
        self._set_busy(False)
        self.note.say(sentence, error=True)
        self.name.setFocus()

    def _page_chosen(self) -> None:
        self.page.come_up()
        self._show_choice()

    def _page_changed(self) -> None:
        if self.sender() is self.page:
            self._show_choice()

    def _show_choice(self) -> None:
        self.name.setText(self.page.name)
        self.note.say(self.page.note)

    def _open(self) -> None:
        name = self.name.text().strip()
        if name and not self.progress.isVisible():
            self.note.say("")
            self._set_busy(True)
            self.show_progress(0.0, "")
            self.requested.emit(name)

    def _set_busy(self, busy: bool) -> None:
        self.progress.setVisible(busy)
        for widget in (self.tabs, self.name, self._button):
            widget.setEnabled(not busy)


class OpenControl(QObject):
    """Opens at most one dialog, and answers it."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._context = context
        self.dialog: OpenDialog | None = None
        self._opening = ""
        context.worker.opening.connect(self._show_progress)
        context.worker.opened.connect(self._opened)

    def open(self) -> None:
        if self.dialog is None:
            live = self._context.source_name.startswith(CAMERAS)
            self._make_dialog().start_on(_CAMERAS if live else _FILES)

    def open_cameras(self) -> None:
        if self.dialog is None:
            self._make_dialog().start_on(_CAMERAS)

    def take_failure(self, name: str, sentence: str) -> bool:
        """Show in the dialog why a source was not opened; return False if the dialog did not ask for it."""
        if self.dialog is None or split_topics(name)[0] != self._opening:
            return False
        self._opening = ""
        self.dialog.show_failure(sentence)
        return True

    def close(self) -> None:
        if self.dialog is not None:
            self.dialog.reject()

    def _make_dialog(self) -> OpenDialog:
        context = self._context
        self._cameras = CamerasPage(context.document.preset.cameras)
        pages = [self._cameras, FilesPage(context.settings, context.dialogs)]
        self.dialog = OpenDialog(pages, context.window)
        self.dialog.requested.connect(self._request)
        self.dialog.finished.connect(self._closed)
        self.dialog.open()
        return self.dialog

    def _request(self, name: str) -> None:
        if self.dialog is not None and self.dialog.page is self._cameras and self._cameras.serials is not None:
            proximity, tactile = self._cameras.serials
            self._context.document.edit_many({"cameras.proximity.serial": proximity, "cameras.tactile.serial": tactile})
        self._opening = split_topics(name)[0]
        self._context.sourceRequested.emit(name)

    def _show_progress(self, name: str, share: float, words: str) -> None:
        if self.dialog is not None and split_topics(name)[0] == self._opening:
            self.dialog.show_progress(share, words)

    def _opened(self) -> None:
        if self.dialog is not None and self._opening:
            self._opening = ""
            self.dialog.accept()

    def _closed(self) -> None:
        if self._opening:
            self._opening = ""
            self._context.worker.cancel_open()
        if self.dialog is not None:
            self.dialog.deleteLater()
            self.dialog = None
