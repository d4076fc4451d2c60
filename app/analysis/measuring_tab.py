"""What the tabs that measure the newest frame beside the window have in common."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from PyQt6.QtGui import QImage
from PyQt6.QtWidgets import QHBoxLayout, QProgressBar, QPushButton, QSplitter, QVBoxLayout

from ...widgets.basics.elided_label import ElidedLabel
from ..window.message_bar import MessageBar, Severity
from ..worker.jobs import Job
from ..worker.results import RateMeter, Result
from .compare_reference import Reference
from .picture_export import write_picture
from .tab import AnalysisTab

if TYPE_CHECKING:
    from ..window.main_window import MainWindow

_FOLDER = "folder/export"


class MeasuringTab(AnalysisTab):
    """A row of controls with a status, messages, and a sheet that is exported as a picture with numbers beside it.

    Parameters
    ----------
    window : MainWindow
    waiting : str
        The status before there is a frame.
    """

    def __init__(self, window: MainWindow, waiting: str) -> None:
        super().__init__()
        self._settings = window.settings
        self._dialogs = window.dialogs.over(self)
        self._result: Result | None = None
        self._rate = RateMeter()
        self.reference = Reference(window.document, self)
        self._writing = Job(self)
        self.status = ElidedLabel(waiting)
        self.messages = MessageBar()
        self.progress = QProgressBar()
        self.progress.setRange(0, 100)
        self.progress.setFormat("Preparing the untouched membrane: %p %")
        self.progress.hide()
        self.export = QPushButton("&Export…")
        self.export.setShortcut("Ctrl+E")
        self.export.setAutoDefault(False)
        self.export.setEnabled(False)
        self._writing.done.connect(self._say)
        self._writing.failed.connect(self._complain)

    def shut_down(self) -> None:
        """Stop all threads, for good."""
        self.reference.shut_down()
        self._writing.stop()

    def _lay_out_around(self, sheet: QSplitter, row: QHBoxLayout) -> None:
        sheet.setChildrenCollapsible(False)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addLayout(row)
        layout.addWidget(self.messages)
        layout.addWidget(sheet, 1)

    def _export_folder(self) -> Path:
        return Path(self._settings.text(_FOLDER) or Path.home())

    def _write(self, picture: QImage | None, numbers: str, path: Path, what: str) -> None:
        """Write as `write_picture` does, beside the window, and remember the folder."""
        self._settings.set(_FOLDER, str(path.parent))
        self._writing.start(lambda _: write_picture(picture, numbers, path, what))

    def _say(self, sentence: str) -> None:
        self.messages.show_message("done", Severity.INFO, sentence)

    def _complain(self, sentence: str) -> None:
        if sentence:
            self.messages.show_message("failed", Severity.ERROR, sentence)
