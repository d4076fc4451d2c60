"""Starts the main window; on request takes a screenshot and ends."""

from __future__ import annotations

import os
import signal
import sys
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from platformdirs import user_config_dir, user_data_dir
from PyQt6.QtCore import QBuffer, QObject, QTimer
from PyQt6.QtWidgets import QApplication

from ..core.errors import ExportError, TactuneError
from ..core.model.files import atomic_path
from ..core.sources.presets import default_preset, load_preset
from ..widgets.basics.controls import timer
from ..widgets.basics.icons import app_icon
from ..widgets.basics.messages import Severity
from ..widgets.basics.style import use_style
from .settings import Settings
from .window.main_window import MainWindow
from .worker.threads import wait_for_abandoned

#: What the first window shows.
_SOURCE = "sim"
#: Longest wait for the frames of a screenshot, in ms; opening the source does not count.
MAX_WAIT_MS = 60_000
#: Longest wait for abandoned threads after the windows are closed, in seconds.
MAX_WAIT_S = 5.0
#: Interval at which an idle window lets Python notice a signal, in ms.
WAKE_MS = 200


def run_gui(source: str | None, preset: str | None, screenshot: Path | None, after: int = 30) -> int:
    """Open the window, run it until it is closed, or until a ``screenshot`` is saved; return the exit status."""
    application = make_application()
    with TemporaryDirectory(prefix="tactune-") as folder:
        # A screenshot neither depends on remembered settings nor changes them.
        settings = Settings(Path(folder if screenshot else user_config_dir("tactune")) / "window.json")
        data_folder = Path(folder if screenshot else user_data_dir("tactune"))
        window, name = show_window(source, preset, settings, data_folder)
        picture = None if screenshot is None else _Screenshot(window, screenshot, after)
        window.open_source(name) if picture is None else window.open_named(name)
        if picture is None:
            window.file_flows.offer_unsaved_work()
            _stop_on_interrupt(window, application)
        status = application.exec()
    if picture is not None and picture.problem:
        raise ExportError(picture.problem)
    # The interpreter's own exit can hang in a thread that computes, and it may destroy Qt's objects in an order that
    # crashes where a signal has ended the window: then the process ends here.
    if not wait_for_abandoned(MAX_WAIT_S) or status > 128:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)
    return status


def show_window(
    source: str | None, preset: str | None, settings: Settings, data_folder: Path
) -> tuple[MainWindow, str]:
    """Show the main window with a preset, and return it with the name of the source to open.

    What is not named is that of the last window, or else the simulator and the source's default preset.
    """
    last_source, last_preset = settings.last_opened()
    name = source or last_source or _SOURCE
    chosen, problem = default_preset(name) if preset is None else preset, ""
    if preset is None and last_preset and name == last_source:
        try:
            load_preset(last_preset)
            chosen = last_preset
        except TactuneError as error:
            problem = f"The preset of the last time was not opened: {error}."
    window = MainWindow(load_preset(chosen), settings, data_folder)
    path = Path(chosen)
    if path.is_file() and path.suffix != ".mcap":
        window.document.open(path)
    window.error_hook.install()
    window.show()
    if problem:
        window.messages.show_message("file", Severity.WARNING, problem)
    return window, name


def _stop_on_interrupt(window: MainWindow, application: QApplication) -> None:
    """End the window on SIGINT and SIGTERM; unsaved work is kept and offered at the next start."""

    def stop(number: int) -> None:
        window.autosave.flush()
        window.autosave.wait()
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
    timer(window, WAKE_MS, lambda: None).start()


def make_application() -> QApplication:
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


class _Screenshot(QObject):
    """Waits for enough frames, saves a picture of the window, and closes it."""

    def __init__(self, window: MainWindow, path: Path, after: int) -> None:
        super().__init__(window)
        self.problem = ""
        self._window, self._path, self._after = window, path, after
        late = partial(self._give_up, f"no {after} frames within {MAX_WAIT_MS // 1000} s")
        self._patience = timer(self, MAX_WAIT_MS, late, once=True)
        window.context.frameShown.connect(self._frame_shown)
        window.worker.opened.connect(lambda _: self._patience.start())
        window.worker.openFailed.connect(lambda _, sentence: self._give_up(sentence))
        window.worker.failed.connect(self._give_up)

    def _frame_shown(self) -> None:
        result = self._window.result
        if result is None or (result.patch is None and not result.problem):  # the contact test is being compiled
            self._patience.start()
        elif result.processed >= self._after or not result.playback.playing:
            self._window.context.frameShown.disconnect(self._frame_shown)
            self._patience.stop()
            self._window.worker.pause()
            self.problem = result.problem
            QTimer.singleShot(300, self._take)

    def _take(self) -> None:
        buffer = QBuffer()  # not the file: on a full disk the library of the format would write to the terminal
        buffer.open(QBuffer.OpenModeFlag.WriteOnly)
        self._window.grab().save(buffer, self._path.suffix[1:])
        try:
            with atomic_path(self._path) as temporary:
                temporary.write_bytes(buffer.data().data())
        except TactuneError as error:
            self.problem = str(error)
        self._window.close()

    def _give_up(self, problem: str) -> None:
        self.problem = f"no picture was taken: {problem}"
        self._window.close()
