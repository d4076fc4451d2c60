"""A finding beside its control: what is wrong, and the button that mends it."""

from __future__ import annotations

from dataclasses import dataclass

from PyQt6.QtCore import QEvent, Qt, pyqtSignal
from PyQt6.QtGui import QColor, QPalette
from PyQt6.QtWidgets import QLabel, QPushButton, QVBoxLayout, QWidget

from ..basics.theme import theme_colors


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

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._sentence = QLabel()
        self._sentence.setWordWrap(True)
        self.button = QPushButton()
        self.button.setAutoDefault(False)
        self.button.clicked.connect(self.pressed)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 4)
        layout.setSpacing(4)
        layout.addWidget(self._sentence)
        layout.addWidget(self.button, 0, Qt.AlignmentFlag.AlignRight)
        self.hide()
        self._recolor()

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

    def changeEvent(self, event: QEvent | None) -> None:
        """Follow the theme."""
        super().changeEvent(event)
        if event is not None and event.type() == QEvent.Type.PaletteChange:
            self._recolor()

    def _recolor(self) -> None:
        palette = QPalette()
        palette.setColor(QPalette.ColorRole.WindowText, QColor(theme_colors().warning))
        self._sentence.setPalette(palette)
