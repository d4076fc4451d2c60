"""What the main window needs to know of the camera checks: open them, pass frames on, close."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from PyQt6.QtCore import QObject

from ...core.sources.base import CameraOption
from .check_window import CheckWindow

if TYPE_CHECKING:
    from ..window.main_window import MainWindow


class CameraChecks(QObject):
    """Keeps at most one window and feeds it."""

    def __init__(self, window: MainWindow) -> None:
        super().__init__(window)
        self._main = window
        self._options: tuple[CameraOption, ...] = ()
        self.window: CheckWindow | None = None
        window.worker.optionsChanged.connect(self._options_changed)
        window.frameShown.connect(self._frame_shown)
        window.actions_.check_cameras.triggered.connect(self.open)

    def open(self) -> None:
        """Open the window on the present source, or bring it to the front."""
        if self.window is None:
            main = self._main
            folder = Path(main.settings.text("folder/export") or Path.home())
            self.window = CheckWindow(main.worker, main.document, main.dialogs, folder, main)
            self.window.set_options(self._options)
        self.window.show()
        self.window.raise_()
        self.window.activateWindow()
        self._frame_shown()

    def close(self) -> None:
        """Close the window; a laser that was switched off is put back."""
        if self.window is not None:
            self.window.close()

    def _options_changed(self, options: tuple[CameraOption, ...]) -> None:
        self._options = options
        if self.window is not None:
            self.window.set_options(options)

    def _frame_shown(self) -> None:
        result = self._main.result
        if self.window is not None and result is not None:
            self.window.show_result(result)
