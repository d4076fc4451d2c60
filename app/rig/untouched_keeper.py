"""Follows the document's preset, so that recordings hold its untouched frame and a recorded one is not lost."""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from pathlib import Path

from PyQt6.QtCore import QObject, pyqtSignal

from ...core.errors import FrameError, PresetError
from ...core.model.frames import SensorFrame
from ...core.preset import Preset, UntouchedRecord
from ...core.rig.untouched import load_untouched
from ..document.document import Document
from ..document.untouched_store import UntouchedStore
from ..worker.jobs import Job, Progress
from ..worker.recorder import Recorder
from ..worker.results import SourceInfo


class UntouchedKeeper(QObject):
    """Reads the untouched frame of whichever preset is in use, on a thread of its own.

    A preset that came out of a recording has no folder: its untouched frame is taken from the recording into
    the store, from which it is saved.

    Signals
    -------
    changed()
        `frame` is another.
    """

    changed = pyqtSignal()

    def __init__(self, document: Document, recorder: Recorder, store: UntouchedStore, parent: QObject) -> None:
        super().__init__(parent)
        self._document, self._recorder, self._store = document, recorder, store
        self._info: SourceInfo | None = None
        self._key: object = None
        self._job = Job(self)
        self._job.done.connect(self._use)
        document.presetChanged.connect(self._look)
        document.fileChanged.connect(self._look)
        self._look()

    @property
    def frame(self) -> SensorFrame | None:
        """The untouched frame of the preset; None where it has none, or none that can be read, or not yet."""
        return self._recorder.untouched

    @property
    def busy(self) -> bool:
        """Whether the untouched frame is still being read."""
        return self._job.busy

    def source_opened(self, info: SourceInfo) -> None:
        """Look whether this source holds the preset's untouched frame."""
        self._info = info
        self._look()

    def close(self) -> None:
        """Stop, for good."""
        self._job.stop()

    def _look(self) -> None:
        preset, home = self._document.preset, self._document.untouched_home
        key = (preset.untouched, home, self._info)
        if key == self._key:
            return
        self._key = key
        self._job.cancel()  # what it finds is another preset's or source's
        if preset.untouched is not None:
            self._job.start(partial(_read, preset.untouched, preset, home, self._info, self._store))
        self._use(None)

    def _use(self, frame: SensorFrame | None) -> None:
        self._recorder.untouched = frame
        self.changed.emit()


def _read(
    record: UntouchedRecord,
    preset: Preset,
    home: Path | None,
    info: SourceInfo | None,
    store: UntouchedStore,
    progress: Progress,
) -> SensorFrame | None:
    """Return the preset's own untouched frame from where it lies, else from the recording that held both, else None."""
    if home is not None:
        with suppress(PresetError, FrameError):  # whoever needs it says so
            frame = load_untouched(record, home)
            if info is not None:
                frame.check_against(info.rig)
            return frame
    if info is None or info.preset is None or info.preset.untouched != record:
        return None
    found = info.find_untouched(preset, None, progress)
    if found.frame is None or found.warnings:
        return None
    store.keep(found.frame, record.frames)
    return found.frame
