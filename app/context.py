"""What the main window offers to the windows and tabs that it opens."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from PyQt6.QtCore import QObject, pyqtSignal
from PyQt6.QtWidgets import QWidget

from ..widgets.basics.dialogs import Dialogs
from ..widgets.basics.messages import Messages
from .document.comparison import Comparison
from .document.document import Document
from .settings import Settings
from .worker.playback import PlaybackState
from .worker.results import Result
from .worker.worker import Worker

#: Subject of messages that speak of the open source: opening another one dismisses them.
SOURCE = "source"
#: Subject of messages on how a task ended, such as an export: the next task dismisses them.
TASK = "task"


class Context(QObject):
    """The preset, the newest frame and the services that all windows share.

    Windows and tabs get a context instead of the main window, so they depend on nothing above them.

    Attributes
    ----------
    result : Result or None
        The frame on the screen; None before the first frame of a source.
    playback : PlaybackState or None
        The newest state of playback; None before the first source.
    trim : (int, int) or None
        The frames between the in and out marks: the first, and the one behind the last; None without marks.
    """

    frameShown = pyqtSignal()  # `result` is on the screen
    saveRequested = pyqtSignal()  # emit it to save the preset, after asking for a file if it has none
    sourceRequested = pyqtSignal(str)  # emit it to open a source by its name

    def __init__(
        self,
        document: Document,
        worker: Worker,
        messages: Messages,
        dialogs: Dialogs,
        settings: Settings,
        data_folder: Path,  # of unsaved work
        window: QWidget,  # parent of other windows
    ) -> None:
        super().__init__(window)
        self.document, self.worker, self.messages, self.dialogs = document, worker, messages, dialogs
        self.settings, self.data_folder, self.window = settings, data_folder, window
        self.comparison = Comparison(document, self)
        self.result: Result | None = None
        self.playback: PlaybackState | None = None
        self.trim: tuple[int, int] | None = None
        worker.playbackChanged.connect(self._note_playback)

    @property
    def source_name(self) -> str:
        """The name of the source on the screen; empty before its first frame."""
        return "" if self.result is None else self.result.source.name

    def _note_playback(self, state: PlaybackState) -> None:
        """Note a change of all but the frame number, that of the frame shown: results overtake such changes."""
        self.playback = state if self.result is None else replace(state, index=self.result.playback.index)
