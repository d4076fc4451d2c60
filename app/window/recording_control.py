"""Recording, as the person sees it: start, numbers while it runs, and what to do with the file."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from threading import Thread

from PyQt6.QtCore import QObject, QTimer, QUrl
from PyQt6.QtGui import QAction, QDesktopServices

from ...core.recording.writer import RecordingStatus
from ..settings import Settings, default_recordings_folder
from ..worker.playback import PlaybackState
from ..worker.recorder import RecordingEnd
from ..worker.results import SourceState
from ..worker.worker import Worker
from .message_bar import MessageBar, Offer, Severity
from .recording_bar import RecordingBar, duration, size

REFRESH_MS = 250
#: With less room than this on the disk nothing is begun, and with less than that nothing goes on.
ROOM_TO_BEGIN = 1_000_000_000
ROOM_TO_GO_ON = 200_000_000

_FOLDER = "folder/recordings"
_STANDS_STILL = "playback stands still, press Space to go on"


class RecordingControl(QObject):
    """Starts and stops recordings for one action, and tells how they go.

    Parameters
    ----------
    open_recording : callable
        Opens a finished file as the source.
    """

    def __init__(
        self,
        worker: Worker,
        settings: Settings,
        messages: MessageBar,
        action: QAction,
        bar: RecordingBar,
        open_recording: Callable[[Path], None],
    ) -> None:
        super().__init__(worker)
        self._worker, self._settings, self._messages = worker, settings, messages
        self._action, self._bar, self._open_recording = action, bar, open_recording
        self._path: Path | None = None
        self._started_s = 0.0
        self._hint = ""
        self._lost = self._lost_before = 0
        self._then: Callable[[], object] | None = None
        self._refresh = QTimer(self)
        self._refresh.setInterval(REFRESH_MS)
        self._refresh.timeout.connect(self._show_progress)
        action.triggered.connect(self._toggle)
        bar.stopRequested.connect(self.stop)
        worker.recordingStarted.connect(self._started)
        worker.recordingFailed.connect(self._failed)
        worker.recordingEnded.connect(self._ended)
        worker.playbackChanged.connect(self._playback_changed)
        worker.opened.connect(self._source_opened)
        worker.stateChanged.connect(self._source_changed)

    @property
    def running(self) -> bool:
        """Whether a file is being written or finished."""
        return self._path is not None

    @property
    def folder(self) -> Path:
        """Where recordings go."""
        return Path(self._settings.text(_FOLDER, str(default_recordings_folder())))

    def use_folder(self, folder: Path) -> None:
        """Put recordings into this folder from now on."""
        self._settings.set(_FOLDER, str(folder))
        self._messages.show_message("recording", Severity.INFO, f"Recordings go to {folder} from now on.")

    def start(self) -> None:
        """Begin a recording named by the date."""
        folder = self.folder
        try:
            folder.mkdir(parents=True, exist_ok=True)
            free = free_bytes(folder)
        except OSError as error:
            self._failed(f"Nothing can be recorded in {folder}: {error.strerror or error}; choose another folder.")
            return
        if free < ROOM_TO_BEGIN:
            self._failed(
                f"There are only {size(free)} left on the disk of {folder}, and a recording needs "
                f"{size(ROOM_TO_BEGIN)} to begin: make room, or choose another folder."
            )
            return
        self._messages.clear("recording")
        self._worker.start_recording(new_name(folder, datetime.now()))

    def stop(self) -> None:
        """Finish the recording."""
        if self._path is not None:
            self._bar.show_finishing(self._path.name)
        self._worker.stop_recording()

    def finish(self, then: Callable[[], object]) -> None:
        """Finish the recording and do something else once the file is complete."""
        self._then = then
        if self._path is not None:
            self._bar.show_finishing(self._path.name)
        # Not by an order to the worker, whose source may hang, nor here, where the disk may be behind.
        Thread(target=self._worker.recorder.stop, name="recording stopper").start()

    def _toggle(self) -> None:
        self._show_action()  # what it shows is what is, not what was asked for
        if self.running:
            self.stop()
        else:
            self.start()

    def _started(self, path: Path) -> None:
        self._path, self._started_s, self._lost_before = path, time.monotonic(), self._lost
        self._bar.show_start(path.name)
        self._bar.show_hint(path.name, self._hint)
        self._show_action()
        self._refresh.start()

    def _failed(self, sentence: str) -> None:
        self._show_action()
        self._messages.show_message("recording", Severity.ERROR, sentence)

    def _show_progress(self) -> None:
        status = self._worker.recorder.status()
        if status is None or self._path is None:
            return
        try:
            free = free_bytes(self._path.parent)
        except OSError:
            free = 0  # the disk is gone: what cannot be asked has no room
        self._bar.show_progress(self._with_lost(status), time.monotonic() - self._started_s, free)
        if status.error:
            self._worker.stop_recording()
        elif free < ROOM_TO_GO_ON:
            self._worker.stop_recording(f"only {size(free)} are left on the disk: make room, or choose another folder")

    def _ended(self, end: RecordingEnd) -> None:
        self._path = None
        self._refresh.stop()
        self._bar.hide()
        self._show_action()
        self._tell(end)
        then, self._then = self._then, None
        if then is not None:
            then()

    def _tell(self, end: RecordingEnd) -> None:
        """Say what there is now, why it ended if nobody asked, and offer to look at it."""
        status = self._with_lost(end.status)
        offers: list[Offer] = []
        if status.frames:
            count = f"{status.frames} frame{'' if status.frames == 1 else 's'}"
            sentence = f"Recorded {status.path.name}: {duration(status.seconds)}, {count}, {size(status.bytes)}."
            offers = [
                ("Open recording", lambda: self._open_recording(status.path)),
                ("Show in folder", lambda: show_in_folder(status.path)),
            ]
        else:
            sentence = f"Nothing was recorded: {status.error.rstrip('.') or 'no frame came'}."
        if status.dropped:
            sentence += (
                f" {status.dropped} frames are missing: the cameras or this computer lost them, they did not fit, "
                "or the disk was too slow."
            )
        if status.error and status.frames:
            sentence += f" {status.error[0].upper()}{status.error[1:]}."
        if end.reason:
            sentence += f" It ended because {end.reason.rstrip('.')}."
        well = not (status.dropped or status.error or end.reason)
        self._messages.show_message("recording", Severity.INFO if well else Severity.WARNING, sentence, offers)

    def _source_opened(self) -> None:
        self._lost = self._lost_before = 0

    def _source_changed(self, state: SourceState) -> None:
        self._lost = state.health.dropped

    def _with_lost(self, status: RecordingStatus) -> RecordingStatus:
        """Count also what never reached the recorder."""
        return replace(status, dropped=status.dropped + max(self._lost - self._lost_before, 0))

    def _playback_changed(self, state: PlaybackState) -> None:
        self._hint = _STANDS_STILL if state.seekable and not state.running else ""
        if self._path is not None and self._refresh.isActive():
            self._bar.show_hint(self._path.name, self._hint)

    def _show_action(self) -> None:
        self._action.setChecked(self.running)
        self._action.setText("Stop &recording" if self.running else "&Record")
        self._action.setIconText("Stop" if self.running else "Record")


def free_bytes(folder: Path) -> int:
    """Return the room on the disk of a folder.

    Raises
    ------
    OSError
        There is no such folder any more.
    """
    return shutil.disk_usage(folder).free


def new_name(folder: Path, moment: datetime) -> Path:
    """Return a file name by date and time that is not taken."""
    stem = f"session_{moment:%Y-%m-%d_%H-%M-%S}"
    path = folder / f"{stem}.mcap"
    number = 2
    while path.exists():
        path = folder / f"{stem}_{number}.mcap"
        number += 1
    return path


def show_in_folder(path: Path) -> None:
    """Open the folder of a file in the desktop's file manager."""
    QDesktopServices.openUrl(QUrl.fromLocalFile(str(path.parent)))
