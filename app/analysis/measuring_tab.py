"""Base of the tabs that measure the newest frame: status, messages, untouched frame, and export."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from PyQt6.QtCore import QObject, pyqtSignal
from PyQt6.QtGui import QImage
from PyQt6.QtWidgets import QLayout, QPushButton, QSplitter

from ...core.errors import ExportError
from ...core.model.files import atomic_path
from ...core.model.frames import SensorFrame
from ...core.preset import Preset, UntouchedRecord
from ...core.rig.untouched import FoundUntouched
from ...widgets.basics.controls import ElidedLabel, ProgressBar
from ...widgets.basics.layouts import vbox
from ...widgets.basics.messages import Messages, Severity
from ..context import Context
from ..document.document import Document
from ..worker.jobs import Job
from ..worker.results import RateMeter, Result, SourceInfo
from .tab import AnalysisTab

CAPTURE = "Capture the untouched frame while nothing touches the membrane: Ctrl+Shift+R"
_SEARCHING = "Needs the untouched frame, which is being prepared…"
_MISSING = f"Needs an untouched frame, which this source does not have. {CAPTURE}"
_CANCELLED = f"Needs the untouched frame; preparing it was cancelled. Try again above. {CAPTURE}"


class UntouchedSearch(QObject):
    """Finds the untouched frame for the frame on the screen, on its own thread.

    Parameters
    ----------
    document : Document
        Knows the folder of the preset's untouched frame. It is asked only after a change of preset, file or
        source, because it reads the disk.
    parent : QObject, optional

    Signals
    -------
    changed()
        `searching`, `frame`, `sentence` or `warning` changed.
    progress(share: float)
        0 to 1.
    """

    changed = pyqtSignal()
    progress = pyqtSignal(float)

    def __init__(self, document: Document, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._document = document
        self._key: tuple[SourceInfo, UntouchedRecord | None, Path | None] | None = None
        self._preset = Preset()
        self.frame: SensorFrame | None = None
        #: The reason why there is no frame, and what to do.
        self.sentence = ""
        #: The reason why the preset's own untouched frame is not used.
        self.warning = ""
        self.searching = False
        self.cancelled = False
        self._job = Job(self)
        self._job.done.connect(self._found)
        self._job.failed.connect(self._failed)
        self._job.progress.connect(lambda share, _words: self.progress.emit(share))

    def look(self, result: Result) -> None:
        """Find the untouched frame for a result, unless source, preset and file are the same as before."""
        key = result.source, result.preset.untouched, self._document.path
        if self._key is None or key[0] is not self._key[0] or key[1:] != self._key[1:]:
            self._key, self._preset = key, result.preset
            self.retry()

    def retry(self) -> None:
        """Search again."""
        if self._key is None:
            return
        info = self._key[0]
        self.frame, self.sentence, self.warning = None, _SEARCHING, ""
        self.searching, self.cancelled = True, False
        self._job.cancel()
        self._job.start(partial(info.find_untouched, self._preset, self._document.untouched_home))
        self.changed.emit()

    def cancel(self) -> None:
        """Cancel the search."""
        self.cancelled = True
        self._job.cancel()

    def shut_down(self) -> None:
        """Stop the thread for good."""
        self._job.stop()

    def _found(self, found: FoundUntouched) -> None:
        self.searching = False
        self.frame, self.sentence = found.frame, "" if found.frame is not None else _MISSING
        self.warning = " ".join(found.warnings)
        self.changed.emit()

    def _failed(self, sentence: str) -> None:
        if not sentence and not self.cancelled:
            return  # replaced by another search
        self.searching, self.sentence = False, sentence or _CANCELLED
        self.changed.emit()


def write_picture(picture: QImage | None, numbers: str, path: Path, what: str) -> str:
    """Write ``path`` as PNG and the numbers as a CSV file of the same name; without a picture, only the CSV.

    Parameters
    ----------
    picture : QImage or None
    numbers : str
        The text of the CSV.
    path : Path
    what : str
        Start of the returned sentence, such as ``"Frame 4 was"``.

    Raises
    ------
    ExportError
        The files cannot be written, or the CSV would replace a file that does not belong to such a picture.
    """
    beside = path if picture is None else path.with_suffix(".csv")
    if picture is not None and beside.exists() and not path.exists():
        raise ExportError(f"{beside} already exists and would be replaced; choose another name")
    if picture is None:
        with atomic_path(path) as temporary:
            temporary.write_text(numbers, encoding="utf-8")
        return f"{what} written to {path}."
    # The picture gets its name first: a table without its picture would be refused the next time.
    with atomic_path(beside) as table, atomic_path(path) as temporary:
        table.write_text(numbers, encoding="utf-8")
        if not picture.save(str(temporary), "PNG"):
            raise ExportError(f"cannot write the picture {path}; choose another place")
    return f"{what} written to {path} and {beside.name}."


class MeasuringTab(AnalysisTab):
    """A row of controls with a status, messages, and a sheet that is exported as PNG and CSV.

    Parameters
    ----------
    context : Context
    waiting : str
        The status before the first frame.
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
        self.messages = Messages(self)
        self.progress = ProgressBar("Preparing the untouched frame")
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

    def _lay_out_around(self, sheet: QSplitter, row: QLayout) -> None:
        vbox(row, (sheet, 1), within=self, margins=0)

    def _write(self, picture: QImage | None, numbers: str, path: Path, what: str) -> None:
        """Call `write_picture` on another thread."""
        self._writing.start(lambda _: write_picture(picture, numbers, path, what))

    def _say(self, sentence: str) -> None:
        self.messages.show_message("done", Severity.INFO, sentence)

    def _complain(self, sentence: str) -> None:
        if sentence:
            self.messages.show_message("failed", Severity.ERROR, sentence)
