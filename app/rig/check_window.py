"""The window that checks the cameras (depth quality, skew, noise and bias), and its launcher."""

from __future__ import annotations

from PyQt6.QtCore import QObject
from PyQt6.QtWidgets import QDialog, QTabWidget, QWidget

from ...widgets.basics.controls import push_button
from ...widgets.basics.dialogs import bring_up
from ...widgets.basics.layouts import STRETCH, hbox, vbox
from ..context import Context
from ..document.document import Document
from ..worker.results import Result
from ..worker.worker import Worker
from .noise_tab import NoiseTab
from .quality_tab import QualityTab
from .skew_tab import SkewTab


class CheckWindow(QDialog):
    """Depth quality, skew, noise and bias on the source of the main window. A closed window takes no frames."""

    def __init__(self, worker: Worker, document: Document, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Check cameras – Tactune")
        self.quality = QualityTab(document)
        self.skew = SkewTab(worker, document)
        self.noise = NoiseTab(worker, document)
        self.tabs = QTabWidget()
        self.tabs.setDocumentMode(True)
        for tab, title, tip in (
            (self.quality, "&Quality", "Fill rate, noise, flatness and bias in a region"),
            (self.skew, "&Skew", "The delay between both cameras, from motion"),
            (self.noise, "&Noise and bias", "The noise of both cameras and the bias between them, for the preset"),
        ):
            self.tabs.setTabToolTip(self.tabs.addTab(tab, title), tip)
        # both watch the frames of the worker, one at a time
        self.skew.start.pressed.connect(self.noise.give_way)
        self.noise.start.pressed.connect(self.skew.give_way)
        leave = push_button("Close", "Close this window (Esc)")
        leave.clicked.connect(self.reject)
        self.finished.connect(self._end)
        row = hbox(STRETCH, leave)
        vbox((self.tabs, 1), row, within=self)
        self.resize(1040, 760)

    def show_result(self, result: Result) -> None:
        """Take a frame of the main window."""
        self.quality.show_result(result)
        self.skew.show_result(result)
        self.noise.show_result(result)

    def _end(self) -> None:
        """Stop all measurements."""
        self.quality.stop()
        self.skew.close_down()
        self.noise.close_down()


class CameraChecks(QObject):
    """Opens at most one window and passes frames to it."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._context = context
        self.window: CheckWindow | None = None
        context.frameShown.connect(self._frame_shown)

    def open_noise(self) -> None:
        """Open the window at the tab *Noise and bias*."""
        self.open()
        assert self.window is not None
        self.window.tabs.setCurrentWidget(self.window.noise)

    def open(self) -> None:
        """Open the window on the current source, or bring it to the front."""
        if self.window is None:
            context = self._context
            self.window = CheckWindow(context.worker, context.document, context.window)
        bring_up(self.window)
        self._frame_shown()

    def close(self) -> None:
        """Close the window."""
        if self.window is not None:
            self.window.close()

    def _frame_shown(self) -> None:
        result = self._context.result
        if self.window is not None and result is not None:
            self.window.show_result(result)
