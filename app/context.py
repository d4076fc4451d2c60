"""What the main window offers to the windows and tabs that it opens."""

from __future__ import annotations

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
    document : Document
        The preset being edited, its file and its undo history.
    worker : Worker
        Playback, camera settings and recording. `result` is its newest frame.
    messages : Messages
        The messages over the main window's views.
    dialogs : Dialogs
        File dialogs and questions over the main window.
    settings : Settings
        Values remembered between starts.
    data_folder : Path
        Folder for unsaved work.
    window : QWidget
        The parent of other windows.
    comparison : Comparison
        The two presets that the views compare.
    result : Result or None
        The frame on the screen; None before the first frame of a source.
    playback : PlaybackState or None
        The newest state of playback; None before the first source.
    trim : (int, int) or None
        The frames between the in and out marks, for work on a part of the recording: the first, and the one behind
        the last, as in ``range``; None without marks.

    Signals
    -------
    frameShown()
        `result` is on the screen.
    trimChanged()
        The in or out mark was set, moved or cleared, or another source was opened.
    saveRequested()
        Emit it to save the preset to its file, after asking for one if it has none.
    sourceRequested(name: str)
        Emit it to open another source, named as `tactune.core.sources.registry.open_source` takes it.
    """

    frameShown = pyqtSignal()
    trimChanged = pyqtSignal()
    saveRequested = pyqtSignal()
    sourceRequested = pyqtSignal(str)

    def __init__(
        self,
        document: Document,
        worker: Worker,
        messages: Messages,
        dialogs: Dialogs,
        settings: Settings,
        data_folder: Path,
        window: QWidget,
    ) -> None:
        super().__init__(window)
        self.document, self.worker, self.messages, self.dialogs = document, worker, messages, dialogs
        self.settings, self.data_folder, self.window = settings, data_folder, window
        self.comparison = Comparison(document, self)
        self.result: Result | None = None
        self.playback: PlaybackState | None = None
        self.trim: tuple[int, int] | None = None
        worker.playbackChanged.connect(self._note_playback)

    def _note_playback(self, state: PlaybackState) -> None:
        self.playback = state
