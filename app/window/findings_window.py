"""The list of findings: each with its evidence, what its remedy changes, and its button."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from PyQt6.QtCore import Qt
from PyQt6.QtGui import QAction, QPalette
from PyQt6.QtWidgets import (
    QDialog,
    QFrame,
    QLabel,
    QToolButton,
    QVBoxLayout,
    QWidget,
)

from ...core.tuning.advice.proposal import Finding
from ...widgets.basics.controls import NoteLabel, push_button
from ...widgets.basics.layouts import STRETCH, hbox, scrolling, vbox
from ...widgets.parameters.form import ShownFinding

_NOTHING = "Nothing is wrong with this frame."
_NO_FRAME = "No frame was examined yet: open a source (Ctrl+O)."


class FindingsWindow(QDialog):
    """Lists the findings beside the main window; ``mend`` is called with the finding whose button was pressed."""

    def __init__(self, mend: Callable[[Finding], None], undo: QAction, parent: QWidget) -> None:
        super().__init__(parent)
        self.setWindowTitle("Findings – Tactune")
        self._mend = mend
        self.addAction(undo)
        self._cards = QVBoxLayout()
        self._cards.setSpacing(8)
        content = QWidget()
        vbox(self._cards, STRETCH, within=content, margins=4)
        scroll = scrolling(content)
        self._undo = QToolButton()
        self._undo.setDefaultAction(undo)
        self._undo.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        leave = push_button("Close", "Close this list (Esc)")
        leave.clicked.connect(self.reject)
        row = hbox(self._undo, STRETCH, leave)
        vbox((scroll, 1), row, within=self)
        self.resize(480, 460)

    def show_findings(self, findings: Sequence[tuple[Finding, ShownFinding]], examined: bool) -> None:
        """Show these findings instead of the former ones; without any, say whether a frame was examined."""
        while (item := self._cards.takeAt(0)) is not None:
            widget = item.widget()
            if widget is not None:
                widget.hide()
                widget.deleteLater()
        for finding, shown in findings:
            self._add(self._card(finding, shown))
        if not findings:
            self._add(QLabel(_NOTHING if examined else _NO_FRAME))

    def _add(self, widget: QWidget) -> None:
        self._cards.addWidget(widget)
        widget.show()  # at once, so that the list is never painted empty

    def _card(self, finding: Finding, shown: ShownFinding) -> QWidget:
        """Return what is known of a finding, with its button."""
        card = QFrame()
        card.setFrameShape(QFrame.Shape.StyledPanel)
        column = QVBoxLayout(card)
        said = NoteLabel(finding.sentence)
        font = said.font()
        font.setBold(True)
        said.setFont(font)
        column.addWidget(said)
        proposal = finding.proposal
        if proposal is not None:
            if proposal.evidence != finding.sentence:
                column.addWidget(NoteLabel(proposal.evidence))
            expected = NoteLabel(proposal.expected)
            expected.setForegroundRole(QPalette.ColorRole.PlaceholderText)
            column.addWidget(expected)
        if shown.button:
            button = push_button(shown.button, shown.tip)
            button.clicked.connect(lambda: self._mend(finding))
            row = hbox(button, STRETCH)
            column.addLayout(row)
        return card
