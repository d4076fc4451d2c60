"""A page of the *Open…* dialog: it offers sources of one kind and knows the name of the chosen one."""

from __future__ import annotations

from PyQt6.QtCore import pyqtSignal
from PyQt6.QtWidgets import QWidget


class SourcePage(QWidget):
    """Base of the pages.

    Attributes
    ----------
    title : str
        In the list of pages.
    name : str
        Name of the chosen source, as `tactune.core.sources.registry.open_source` takes it; empty if none is chosen.
    note : str
        A sentence about the choice; empty if there is nothing to say.

    Signals
    -------
    changed()
        The name or the note has changed.
    activated()
        The choice was double-clicked, or Enter was pressed on it: open it.
    """

    changed = pyqtSignal()
    activated = pyqtSignal()
    title = ""

    def __init__(self) -> None:
        super().__init__()
        self.name = ""
        self.note = ""

    def show_name(self, name: str) -> bool:
        """Show a name that was typed; return whether it belongs to this page.

        Raises
        ------
        SourceError
            It belongs to this page, but is wrong.
        """
        return False

    def come_up(self) -> None:
        """The page is shown."""

    def stop(self) -> None:
        """End what runs; the dialog is closed."""

    def _choose(self, name: str, note: str = "") -> None:
        self.name, self.note = name, note
        self.changed.emit()
