"""The window that checks the cameras (depth quality, skew, noise and bias), and its launcher."""

from __future__ import annotations

from PyQt6.QtCore import QObject
from PyQt6.QtWidgets import QDialog, QTabWidget

from ...widgets.basics.controls import push_button
from ...widgets.basics.dialogs import bring_up
from ...widgets.basics.layouts import STRETCH, hbox, vbox
from ..context import Context
from .measure_tabs import NoiseTab, SkewTab
from .quality_tab import QualityTab


class CheckWindow(QDialog):
    """Depth quality, skew, noise and bias on the source of the main window. A closed window takes no frames."""

    def __init__(self, context: Context) -> None:
        super().__init__(context.window)
        self.setWindowTitle("Check cameras – Tactune")
        self.quality, self.skew, self.noise = QualityTab(context.document), SkewTab(context), NoiseTab(context)
        self.tabs = QTabWidget()
        self.tabs.setDocumentMode(True)
        for tab, title, tip in (
            (self.quality, "&Quality", "Fill rate and flatness in a region"),
            (self.skew, "&Skew", "The delay between both cameras, from motion"),
            (self.noise, "&Noise and bias", "The noise of both cameras and the bias between them, for the preset"),
        ):
            self.tabs.setTabToolTip(self.tabs.addTab(tab, title), tip)
        leave = push_button("Close", "Close this window (Esc)")
        leave.clicked.connect(self.reject)
        self.finished.connect(self._end)
        vbox((self.tabs, 1), hbox(STRETCH, leave), within=self)
        self.resize(1040, 760)

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
            self.window = CheckWindow(self._context)
        bring_up(self.window)
        self._frame_shown()

    def close(self) -> None:
        """Close the window."""
        if self.window is not None:
            self.window.close()

    def _frame_shown(self) -> None:
        result = self._context.result
        if self.window is not None and result is not None:
            self.window.quality.show_result(result)
