"""The window that checks the cameras, in three tabs."""

from __future__ import annotations

from pathlib import Path

from PyQt6.QtWidgets import QDialog, QHBoxLayout, QPushButton, QTabWidget, QVBoxLayout, QWidget

from ...core.sources.base import CameraOption
from ...widgets.basics.dialogs import Dialogs
from ..document.document import Document
from ..worker.results import Result
from ..worker.worker import Worker
from .interference_tab import InterferenceTab
from .quality_tab import QualityTab
from .skew_tab import SkewTab


class CheckWindow(QDialog):
    """Quality, skew and interference on the source of the main window; closed, it takes no frames."""

    def __init__(
        self, worker: Worker, document: Document, dialogs: Dialogs, folder: Path, parent: QWidget | None = None
    ) -> None:
        super().__init__(parent)
        self.setWindowTitle("Check cameras – Tactune")
        self.quality = QualityTab(document, dialogs.over(self), folder)
        self.skew = SkewTab(worker, document)
        self.interference = InterferenceTab(worker)
        self.tabs = QTabWidget()
        for tab, title, tip in (
            (self.quality, "&Quality", "Fill rate, noise, flatness and bias in a region"),
            (self.skew, "&Skew", "The delay between both cameras, from motion"),
            (self.interference, "&Interference", "Whether the proximity camera's laser disturbs the tactile camera"),
        ):
            self.tabs.setTabToolTip(self.tabs.addTab(tab, title), tip)
        leave = QPushButton("Close")
        leave.setToolTip("Close this window (Esc)")
        leave.setAutoDefault(False)
        leave.clicked.connect(self.reject)
        self.finished.connect(self._end)
        row = QHBoxLayout()
        row.addStretch(1)
        row.addWidget(leave)
        layout = QVBoxLayout(self)
        layout.addWidget(self.tabs, 1)
        layout.addLayout(row)
        self.resize(1040, 760)

    def show_result(self, result: Result) -> None:
        """Take a frame of the main window."""
        for tab in (self.quality, self.skew, self.interference):
            tab.show_result(result)

    def set_options(self, options: tuple[CameraOption, ...]) -> None:
        """Take the settings of the source's cameras."""
        self.interference.set_options(options)

    def _end(self) -> None:
        """End what is going on; the laser is put back."""
        self.quality.stop()
        self.skew.close_down()
        self.interference.close_down()
