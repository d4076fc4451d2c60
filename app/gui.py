"""Starts the main window; on request takes a screenshot and ends."""

from __future__ import annotations

import os
import signal
import sys
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from PyQt6.QtCore import QObject, QTimer
from PyQt6.QtWidgets import QApplication

from ..core.errors import ExportError, TactuneError
from ..core.model.files import atomic_path
from ..core.preset import Preset
from ..core.sources.presets import load_preset
from ..widgets.basics.icons import app_icon
from ..widgets.basics.style import use_style
from .settings import Settings, default_data_folder, default_settings_file
from .window.main_window import MainWindow
from .worker.threads import wait_for_abandoned

#: Longest wait for the frames of a screenshot, in ms; opening the source does not count.
MAX_WAIT_MS = 60_000
#: Longest wait for abandoned threads after the windows are closed, in seconds.
MAX_WAIT_S = 5.0
#: Interval at which an idle window lets Python notice a signal, in ms.
WAKE_MS = 200


def run_gui(source: str, preset: str, screenshot: Path | None, after: int = 30) -> int:
    """Open the main window on a source, run it until it is closed, and return the program's exit status.

    With ``screenshot`` save a picture of it there once ``after`` frames have been processed, then end. Raise a
    `TactuneError` where preset or picture fail.
    """
    start_preset, preset_path = start_with(preset)
    application = make_application()
    if screenshot is None:
        window = MainWindow(start_preset, Settings(default_settings_file()), default_data_folder())
        _prepare(window, preset_path)
        window.open_source(source)
        window.file_flows.offer_unsaved_work()
        _stop_on_interrupt(window, application)
        return _ended(application.exec())
    # A screenshot neither depends on remembered settings nor changes them.
    with TemporaryDirectory(prefix="tactune-") as folder:
        window = MainWindow(start_preset, Settings(Path(folder) / "window.json"), Path(folder))
        _prepare(window, preset_path)
        picture = _Screenshot(window, screenshot, after)
        window.open_source(source)
        application.exec()
    if picture.problem:
        raise ExportError(picture.problem)
    return _ended(0)


def _ended(status: int) -> int:
    """Return the exit status after abandoned threads have ended; if one does not, end the process here."""
    if not wait_for_abandoned(MAX_WAIT_S):
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)  # the interpreter's own exit can hang in a thread that computes
    return status


def _stop_on_interrupt(window: MainWindow, application: QApplication) -> None:
    """End the window on SIGINT and SIGTERM; unsaved work is kept and offered at the next start."""

    def stop(number: int) -> None:
        window.autosave.flush()
        window.shut_down()
        application.exit(128 + number)  # as shells expect

    ends = (signal.SIGINT, signal.SIGTERM)

    def begin(number: int, _: object) -> None:
        for sent in ends:  # make and shells may send the same signal again
            signal.signal(sent, signal.SIG_IGN)
        QTimer.singleShot(0, partial(stop, number))

    for sent in ends:
        signal.signal(sent, begin)
    # Python handles a signal only while Python code runs, and an idle window runs none.
    wake = QTimer(window)
    wake.timeout.connect(lambda: None)
    wake.start(WAKE_MS)


def _prepare(window: MainWindow, preset_path: Path | None) -> None:
    if preset_path is not None:
        window.document.open(preset_path)
    window.error_hook.install()
    window.show()


def make_application() -> QApplication:
    """Return the application with Tactune's name, icon and style."""
    existing = QApplication.instance()
    if isinstance(existing, QApplication):
        return existing
    application = QApplication(sys.argv[:1])
    application.setApplicationName("tactune")
    application.setApplicationDisplayName("Tactune")
    application.setDesktopFileName("tactune")
    application.setWindowIcon(app_icon())
    use_style(application)
    return application


def start_with(name: str) -> tuple[Preset, Path | None]:
    """Return the first preset, and its file unless it is a shipped one."""
    path = Path(name)
    return load_preset(name), path if path.is_file() and path.suffix != ".mcap" else None


class _Screenshot(QObject):
    """Waits for enough frames, saves a picture of the window, and closes it."""

    def __init__(self, window: MainWindow, path: Path, after: int) -> None:
        super().__init__(window)
        self.problem = ""
        self._window = window
        self._path = path
        self._after = after
        self._patience = QTimer(self)
        self._patience.setSingleShot(True)
        self._patience.setInterval(MAX_WAIT_MS)
        self._patience.timeout.connect(
            lambda: self._give_up(f"no {after} frames arrived within {MAX_WAIT_MS // 1000} s")
        )
        window.context.frameShown.connect(self._frame_shown)
        window.worker.opened.connect(lambda _: self._patience.start())
        window.worker.openFailed.connect(lambda _, sentence: self._give_up(sentence))
        window.worker.failed.connect(self._give_up)
        window.error_hook.raised.connect(lambda sentence, details: self._give_up(f"{sentence}\n{details}"))

    def _frame_shown(self) -> None:
        result = self._window.result
        if result is None:
            return
        if result.patch is None and not result.problem:  # the contact test is being compiled
            self._patience.start()
            return
        still = not result.playback.playing
        if result.processed >= self._after or still:
            self._window.context.frameShown.disconnect(self._frame_shown)
            self._patience.stop()
            self._window.worker.pause()
            QTimer.singleShot(300, self._take)

    def _take(self) -> None:
        try:
            with atomic_path(self._path) as temporary:
                if not self._window.grab().save(str(temporary)):  # its suffix chooses the format
                    raise ExportError(f"cannot write {self._path}: Qt could not save the picture; choose another place")
        except TactuneError as error:
            self.problem = str(error)
        result = self._window.result
        if result is not None and result.problem:
            self.problem = self.problem or f"{self._path} shows a problem: {result.problem}"
        self._window.close()

    def _give_up(self, problem: str) -> None:
        self.problem = self.problem or f"no picture was taken: {problem}"
        self._window.close()
