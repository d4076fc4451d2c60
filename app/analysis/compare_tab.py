"""The methods' patches side by side on the live frame."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .tab import AnalysisTab

if TYPE_CHECKING:
    from ..main_window import MainWindow


class CompareTab(AnalysisTab):
    """One view per method, in one grid."""

    def __init__(self, window: MainWindow) -> None:
        super().__init__()
        self._main = window
