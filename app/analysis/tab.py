"""What the analysis window asks of its tabs."""

from __future__ import annotations

from PyQt6.QtWidgets import QWidget

from ..worker.results import Result


class AnalysisTab(QWidget):
    """One way to judge the frames of the main window; work goes to threads of its own."""

    def show_result(self, result: Result) -> None:
        """Take a frame of the main window while this tab is visible; must return at once."""

    def shut_down(self) -> None:
        """Stop all threads, for good."""
