"""What the main window needs to know of the camera checks: open them, pass frames on, close."""

from __future__ import annotations

from pathlib import Path

from PyQt6.QtCore import QObject

from ...core.sources.base import CameraOption
from ..context import Context
from .check_window import CheckWindow


class CameraChecks(QObject):
    """Keeps at most one window and feeds it."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._context = context
        self._options: tuple[CameraOption, ...] = ()
        self.window: CheckWindow | None = None
        context.worker.optionsChanged.connect(self._options_changed)
        context.frameShown.connect(self._frame_shown)

    def open(self) -> None:
        """Open the window on the present source, or bring it to the front."""
        if self.window is None:
            context = self._context
            folder = Path(context.settings.text("folder/export") or Path.home())
            self.window = CheckWindow(context.worker, context.document, context.dialogs, folder, context.window)
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
        result = self._context.result
        if self.window is not None and result is not None:
            self.window.show_result(result)
