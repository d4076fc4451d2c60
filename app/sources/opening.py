"""Opens the dialog *Open…* and answers it."""

from __future__ import annotations

from PyQt6.QtCore import QObject

from ..context import Context
from .cameras_page import CamerasPage
from .open_dialog import OpenDialog
from .pages import FilesPage, RecentPage
from .search import CameraSearch
from .simulator_page import SimulatorPage


class OpenControl(QObject):
    """Opens at most one dialog."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._context = context
        self.dialog: OpenDialog | None = None
        self._opening = ""
        context.worker.opening.connect(self._show_progress)
        context.worker.opened.connect(self._opened)

    def open(self) -> None:
        """Ask for a source, from the present one on."""
        result = self._context.result
        if self.dialog is None:
            self._make_dialog().start_with(result.source.name if result is not None else "sim:")

    def open_cameras(self) -> None:
        """Ask for two cameras."""
        if self.dialog is None:
            self._make_dialog().start_on(self._cameras)

    def take_failure(self, name: str, sentence: str) -> bool:
        """Show in the dialog why a source was not opened; return False if the dialog did not ask for it."""
        if self.dialog is None or name != self._opening:
            return False
        self._opening = ""
        self.dialog.show_failure(sentence)
        return True

    def close(self) -> None:
        """Close the dialog."""
        if self.dialog is not None:
            self.dialog.reject()

    def _make_dialog(self) -> OpenDialog:
        context = self._context
        self._cameras = CamerasPage(context.document.preset.cameras, CameraSearch(self))
        pages = [self._cameras, RecentPage(context.settings), SimulatorPage(), FilesPage(context.dialogs)]
        self.dialog = OpenDialog(pages, context.window)
        self.dialog.requested.connect(self._request)
        self.dialog.finished.connect(self._closed)
        self.dialog.open()
        return self.dialog

    def _request(self, name: str) -> None:
        if self.dialog is not None and self.dialog.page is self._cameras and self._cameras.serials is not None:
            proximity, tactile = self._cameras.serials
            self._context.document.edit_many({"cameras.proximity.serial": proximity, "cameras.tactile.serial": tactile})
        self._opening = name
        self._context.sourceRequested.emit(name)

    def _show_progress(self, name: str, share: float, words: str) -> None:
        if self.dialog is not None and name == self._opening:
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
