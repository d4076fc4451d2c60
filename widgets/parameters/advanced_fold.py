"""The fold with the advanced fields of a section."""

from __future__ import annotations

from PyQt6.QtWidgets import QGridLayout, QWidget

from ..basics.controls import FoldButton
from ..basics.layouts import vbox
from .parameter_row import ParameterRow


class AdvancedFold(QWidget):
    """A button *More* above rows that few people need; closed at first.

    It opens by itself when one of its values begins to differ from the default, so that no such value is overlooked.
    """

    def __init__(self, title: str) -> None:
        super().__init__()
        self.rows: list[ParameterRow] = []
        self._differs = False
        self.button = FoldButton(
            "More", f"More of {title.lower()}", f"Show or hide the fields of {title.lower()} that are seldom changed"
        )
        self.button.clicked.connect(lambda: self.set_open(not self.is_open))
        self._body = QWidget()
        self.grid = QGridLayout(self._body)
        self.grid.setContentsMargins(0, 0, 0, 0)
        vbox(self.button, self._body, within=self, margins=0, spacing=4)
        self.set_open(False)

    @property
    def is_open(self) -> bool:
        """Whether the rows are shown."""
        return not self._body.isHidden()

    def set_open(self, opened: bool) -> None:
        """Show or hide the rows."""
        self._body.setVisible(opened)
        self.button.show_folded(not opened)

    def add(self, row: ParameterRow) -> None:
        """Append a row."""
        row.add_to(self.grid)
        self.rows.append(row)

    def open_if_changed(self) -> None:
        """Open the fold if a value differs from the default now and none did before."""
        differs = any(row.editor.value() != row.spec.default for row in self.rows)
        if differs and not self._differs:
            self.set_open(True)
        self._differs = differs
