"""Recording: start and stop, the numbers while it runs, and what to do with the finished file."""

from __future__ import annotations

import itertools
import shutil
import time
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime
from functools import partial
from pathlib import Path
from threading import Thread

from platformdirs import user_documents_dir
from PyQt6.QtCore import QLocale, QUrl
from PyQt6.QtGui import QAction, QDesktopServices
from PyQt6.QtWidgets import QFrame

from ...core.errors import as_sentence, counted
from ...core.output.writer import RecordingStatus
from ...widgets.basics.controls import ElidedLabel, TintedLabel, keep_place, number_label, timer
from ...widgets.basics.layouts import STRETCH, hbox, vbox
from ...widgets.basics.messages import Offer, Severity
from ..context import TASK, Context
from ..sources.pages import RECENT
from ..worker.results import SourceInfo, SourceState
from ..worker.worker import NOT_LIVE

REFRESH_MS = 250
#: Free space that a recording needs to start and to continue, in bytes.
MIN_FREE = 500_000_000

_FOLDER = "folder/recordings"


class RecordingBar(QFrame):
    """Starts and stops recordings with one action; shows the numbers of the one that runs."""

    def __init__(self, context: Context, action: QAction) -> None:
        super().__init__()
        self._context, self._action, self._tip = context, action, action.toolTip()
        self._worker, self._settings, self._messages = context.worker, context.settings, context.messages
        self._live = self._finishing = False
        self._path: Path | None = None
        self._started_s = 0.0
        self._lost = self._lost_before = 0
        self._then: Callable[[], object] | None = None
        dot = TintedLabel("●", "error")
        dot.setAccessibleName("Recording")
        self._name = ElidedLabel()
        self._written = number_label("0:00:00   000000 frames   000.0 GB", "Time, frames in the file and its size")
        self._dropped = number_label(
            "0000 missing", "Frames missing in the file: lost by the cameras, this computer or a slow disk"
        )
        self._room = number_label("000.0 GB free", "Free disk space")
        vbox(
            hbox(dot, (self._name, 1)),
            self._written,
            hbox(self._dropped, self._room, STRETCH),
            within=self,
            margins=0,
            spacing=4,
        )
        keep_place(self)
        self.hide()
        self._refresh = timer(self, REFRESH_MS, self._show_progress)
        worker = self._worker
        action.triggered.connect(self._toggle)
        worker.opened.connect(self._opened)
        worker.recordingStarted.connect(self._started)
        worker.recordingFailed.connect(self._failed)
        worker.recordingEnded.connect(self._ended)
        worker.stateChanged.connect(self._source_changed)
        self._show_action()

    @property
    def running(self) -> bool:
        return self._path is not None

    def use_folder(self, folder: Path) -> None:
        self._settings.set(_FOLDER, str(folder))
        self._messages.show_message("recording", Severity.INFO, f"New recordings will be written to {folder}.")

    def start(self) -> None:
        folder = Path(self._settings.text(_FOLDER) or Path(user_documents_dir(), "Tactune"))
        try:
            folder.mkdir(parents=True, exist_ok=True)
            free = free_bytes(folder)
        except OSError as error:
            self._failed(f"Cannot record in {folder}: {error.strerror or error}; choose another folder.")
            return
        if free < MIN_FREE:
            self._failed(f"Only {size(free)} are free on the disk of {folder}: free some, or choose another folder.")
            return
        self._messages.clear_subject(TASK)
        self._worker.start_recording(new_name(folder, datetime.now()))

    def stop(self) -> None:
        self._show_finishing()
        self._worker.stop_recording()

    def finish(self, then: Callable[[], object]) -> None:
        """Finish the recording and call ``then`` when the file is complete."""
        self._then = then
        self._show_finishing()
        # On its own thread: the worker may hang in its source, and this thread must not wait for the disk.
        Thread(target=self._worker.recorder.stop, name="recording stopper").start()

    def _toggle(self) -> None:
        self._show_action()  # undo the toggle: the action shows the actual state
        if self.running:
            self.stop()
        else:
            self.start()

    def _started(self, path: Path) -> None:
        self._path, self._started_s, self._lost_before = path, time.monotonic(), self._lost
        self._name.setText(f"Recording {path.name}")
        for label in (self._written, self._dropped, self._room):
            label.setText("")
        self.show()
        self._show_action()
        self._refresh.start()

    def _failed(self, sentence: str) -> None:
        self._show_action()
        self._messages.show_message("recording", Severity.ERROR, sentence, subject=TASK)

    def _show_finishing(self) -> None:
        if self._path is not None:
            self._name.setText(f"Finishing {self._path.name}…")
            self._finishing = True
            self._show_action()

    def _show_progress(self) -> None:
        status = self._worker.recorder.status()
        if status is None or self._path is None:
            return
        try:
            free = free_bytes(self._path.parent)
        except OSError:
            free = 0  # the disk is gone
        status, elapsed_s = self._with_lost(status), time.monotonic() - self._started_s
        self._written.setText(f"{clock(elapsed_s)}   {counted(status.frames, 'frame')}   {size(status.bytes)}")
        self._dropped.setText(f"{status.dropped} missing")
        self._dropped.tint("error" if status.dropped else "")
        self._room.setText(f"{size(free)} free")
        if status.error:
            self._worker.stop_recording()
        elif free < MIN_FREE:
            self._worker.stop_recording(f"only {size(free)} are free: free some space, or choose another folder")

    def _ended(self, status: RecordingStatus, reason: str) -> None:
        self._path, self._finishing = None, False
        self._refresh.stop()
        self.hide()
        self._show_action()
        self._tell(self._with_lost(status), reason)
        then, self._then = self._then, None
        if then is not None:
            then()

    def _tell(self, status: RecordingStatus, reason: str) -> None:
        """Report the finished file, the reason if it stopped by itself, and offer to open it."""
        name = f"mcap:{status.path}"
        offers: list[Offer] = []
        if status.frames:
            self._settings.add_recent(RECENT, name)
            frames = counted(status.frames, "frame")
            sentence = f"Recorded {status.path.name}: {clock(status.seconds)}, {frames}, {size(status.bytes)}."
            if status.error:
                sentence += f" {as_sentence(status.error)}"
            offers = [
                ("Open recording", lambda: self._context.sourceRequested.emit(name)),
                ("Show in folder", partial(QDesktopServices.openUrl, QUrl.fromLocalFile(str(status.path.parent)))),
            ]
        else:
            sentence = f"Nothing was recorded: {status.error.rstrip('.') or 'no frame came'}."
        if status.dropped:
            sentence += f" Not recorded: {counted(status.dropped, 'frame')}, lost by cameras, computer or a slow disk."
        if reason:
            sentence += f" It ended because {reason.rstrip('.')}."
        well = not (status.dropped or status.error or reason)
        self._messages.show_message(
            "recording", Severity.INFO if well else Severity.WARNING, sentence, offers, subject=TASK
        )

    def _source_changed(self, state: SourceState) -> None:
        if self._finishing:  # the frames that come now are not of the recording
            return
        self._lost = state.health.dropped
        self._lost_before = min(self._lost_before, self._lost)  # another source counts anew

    def _with_lost(self, status: RecordingStatus) -> RecordingStatus:
        """Add the frames that were lost before they reached the recorder."""
        return replace(status, dropped=status.dropped + self._lost - self._lost_before)

    def _opened(self, info: SourceInfo) -> None:
        self._live = info.length is None
        self._show_action()

    def _show_action(self) -> None:
        self._action.setEnabled((self._live or self.running) and not self._finishing)
        self._action.setToolTip(self._tip if self._live or self.running else NOT_LIVE)
        self._action.setChecked(self.running)
        self._action.setText("Stop &recording" if self.running else "&Record")
        self._action.setIconText("Stop" if self.running else "Record")


def clock(seconds: float) -> str:
    """Return a time as 0:07, 12:30 or 75:03."""
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"


def size(count: float) -> str:
    """Return a number of bytes such as 850.0 kB or 12.3 MB."""
    return QLocale.c().formattedDataSize(int(count), 1, QLocale.DataSizeFormat.DataSizeSIFormat)


def free_bytes(folder: Path) -> int:
    """Return the free bytes on the disk of a folder; `OSError` if it does not exist any more."""
    return shutil.disk_usage(folder).free


def new_name(folder: Path, moment: datetime) -> Path:
    """Return an unused file name by date and time."""
    stem = f"session_{moment:%Y-%m-%d_%H-%M-%S}"
    names = (f"{stem}{'' if number == 1 else f'_{number}'}.mcap" for number in itertools.count(1))
    return next(path for path in map(folder.joinpath, names) if not path.exists())
