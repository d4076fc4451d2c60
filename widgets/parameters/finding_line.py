"""A finding beside its control: what is wrong, and the button that mends it."""

from __future__ import annotations

from dataclasses import dataclass

from PyQt6.QtCore import Qt, pyqtSignal
from PyQt6.QtWidgets import QWidget

from ..basics.controls import TintedLabel, push_button
from ..basics.layouts import vbox


@dataclass(frozen=True)
class ShownFinding:
    """A finding as it is shown: the sentence, and text and tooltip of its button; without a text there is none."""

    sentence: str
    button: str = ""
    tip: str = ""


class FindingLine(QWidget):
    """A sentence in the colour of warnings and the button below it; hidden while there is no finding.

    Signals
    -------
    pressed()
        The button was pressed.
    """

    pressed = pyqtSignal()

    def __init__(self) -> None:
        super().__init__()
        self._sentence = TintedLabel(color="warning")
        self._sentence.setWordWrap(True)
        self.button = push_button("", "")
        self.button.clicked.connect(self.pressed)
        layout = vbox(self._sentence, within=self, margins=(0, 0, 0, 4), spacing=4)
        layout.addWidget(self.button, 0, Qt.AlignmentFlag.AlignRight)
        self.hide()

    @property
    def sentence(self) -> str:
        """What is wrong; empty while there is no finding."""
        return self._sentence.text()

    def show_finding(self, finding: ShownFinding | None) -> None:
        """Show a finding, or hide with None."""
        shown = finding or ShownFinding("")
        self._sentence.setText(shown.sentence)
        self.button.setText(shown.button)
        self.button.setToolTip(shown.tip)
        self.button.setVisible(bool(shown.button))
        self.setVisible(finding is not None)
