"""The untouched membrane that methods compare with: the preset's own, or what the source has."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from PyQt6.QtCore import QObject, pyqtSignal

from ...core.model.frames import SensorFrame
from ...core.preset import Preset, UntouchedRecord
from ...core.rig.untouched import FoundUntouched
from ..document.document import Document
from ..worker.jobs import Job
from ..worker.results import Result, SourceInfo

CAPTURE = "Capture the untouched frame while nothing touches the membrane: Ctrl+Shift+R"
_SEARCHING = "Compares with the untouched membrane, which is being prepared…"
_MISSING = f"Compares with the untouched membrane, which this source does not keep. {CAPTURE}"
_CANCELLED = f"Compares with the untouched membrane; preparing it was cancelled. Try again above. {CAPTURE}"


class UntouchedSearch(QObject):
    """Finds the untouched frame of whatever is shown, on a thread of its own.

    Parameters
    ----------
    document : Document
        Knows beside which file the preset's own lies; asked when another preset, file or source is shown, since it
        looks at the disk.
    parent : QObject, optional

    Signals
    -------
    changed()
        `searching`, `frame`, `sentence` or `warning` is another.
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
        #: Why there is none, with the next step.
        self.sentence = ""
        #: Why the preset's own is not used.
        self.warning = ""
        self.searching = False
        self.cancelled = False
        self._job = Job(self)
        self._job.done.connect(self._found)
        self._job.failed.connect(self._failed)
        self._job.progress.connect(lambda share, _words: self.progress.emit(share))

    def look(self, result: Result) -> None:
        """Find the untouched frame that belongs to a frame and the preset's file, unless that is known already."""
        key = result.source, result.preset.untouched, self._document.path
        if self._key is None or key[0] is not self._key[0] or key[1:] != self._key[1:]:
            self._key, self._preset = key, result.preset
            self.retry()

    def retry(self) -> None:
        """Look for it anew."""
        if self._key is None:
            return
        info = self._key[0]
        self.frame, self.sentence, self.warning = None, _SEARCHING, ""
        self.searching, self.cancelled = True, False
        self._job.cancel()
        self._job.start(partial(info.find_untouched, self._preset, self._document.untouched_home))
        self.changed.emit()

    def cancel(self) -> None:
        """Do without."""
        self.cancelled = True
        self._job.cancel()

    def shut_down(self) -> None:
        """Stop, for good."""
        self._job.stop()

    def _found(self, found: FoundUntouched) -> None:
        self.searching = False
        self.frame, self.sentence = found.frame, "" if found.frame is not None else _MISSING
        self.warning = " ".join(found.warnings)
        self.changed.emit()

    def _failed(self, sentence: str) -> None:
        if not sentence and not self.cancelled:
            return  # given up for another one
        self.searching, self.sentence = False, sentence or _CANCELLED
        self.changed.emit()
