"""Everything of the window that judges the patch, connected to it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from PyQt6.QtCore import QObject

from ..analysis.launcher import AnalysisLauncher
from ..rig.untouched_launcher import UntouchedControls

if TYPE_CHECKING:
    from .main_window import MainWindow


class AnalysisControls(QObject):
    """Owns the windows of the Analysis menu."""

    def __init__(self, window: MainWindow) -> None:
        super().__init__(window)
        self.untouched = UntouchedControls(window)
        self.launcher = AnalysisLauncher(window)

    def close(self) -> None:
        """Close them."""
        self.launcher.close()
        self.untouched.close()
