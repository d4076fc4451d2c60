"""Base of the tabs that measure the newest frame: status, messages, untouched frame, and export."""

from __future__ import annotations

from pathlib import Path

from PyQt6.QtGui import QImage
from PyQt6.QtWidgets import QHBoxLayout, QProgressBar, QPushButton, QSplitter, QVBoxLayout

from ...core.errors import ExportError
from ...core.model.files import atomic_path
from ...widgets.basics.elided_label import ElidedLabel
from ...widgets.basics.message_bar import MessageBar, Severity
from ..context import Context
from ..worker.jobs import Job
from ..worker.results import RateMeter, Result
from .tab import AnalysisTab
from .untouched_search import UntouchedSearch


def write_picture(picture: QImage | None, numbers: str, path: Path, what: str) -> str:
    """Write ``path`` as PNG and the numbers as CSV of the same name; without a picture, the numbers as ``path``.

    Parameters
    ----------
    picture : QImage or None
    numbers : str
        The text of the CSV.
    path : Path
    what : str
        Begins the sentence that is returned, such as ``"Frame 4 was"``.

    Raises
    ------
    ExportError
        The place cannot be written, or the CSV would replace a file that belongs to no such picture.
    """
    beside = path if picture is None else path.with_suffix(".csv")
    if picture is not None and beside.exists() and not path.exists():
        raise ExportError(f"{beside} exists already and would be replaced; choose another name")
    with atomic_path(beside) as temporary:
        temporary.write_text(numbers, encoding="utf-8")
    if picture is None:
        return f"{what} written to {path}."
    with atomic_path(path) as temporary:
        if not picture.save(str(temporary), "PNG"):
            raise ExportError(f"cannot write the picture {path}; choose another place")
    return f"{what} written to {path} and {beside.name}."


_FOLDER = "folder/export"


class MeasuringTab(AnalysisTab):
    """A row of controls with a status, messages, and a sheet that is exported as a picture with numbers beside it.

    Parameters
    ----------
    context : Context
    waiting : str
        The status before there is a frame.
    """

    def __init__(self, context: Context, waiting: str) -> None:
        super().__init__()
        self._settings = context.settings
        self._dialogs = context.dialogs.over(self)
        self._result: Result | None = None
        self._rate = RateMeter()
        self.untouched = UntouchedSearch(context.document, self)
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
        self.untouched.shut_down()
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
