"""A section with a header that folds it away."""

from __future__ import annotations

from PyQt6.QtCore import Qt, pyqtSignal
from PyQt6.QtGui import QFont, QPalette
from PyQt6.QtWidgets import QFrame, QHBoxLayout, QSizePolicy, QToolButton, QVBoxLayout, QWidget


class CollapsibleSection(QFrame):
    """A titled section: a header button that folds the body, and room for a few widgets beside the title.

    Signals
    -------
    collapsedChanged(bool)
    """

    collapsedChanged = pyqtSignal(bool)

    def __init__(self, title: str, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.title = title
        self._collapsed = False
        self.button = QToolButton()
        self.button.setText(title)
        self.button.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextBesideIcon)
        self.button.setArrowType(Qt.ArrowType.DownArrow)
        self.button.setAutoRaise(True)
        self.button.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.button.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.button.setAccessibleName(f"{title} section")
        self.button.setToolTip(f"Fold or unfold {title.lower()}")
        font = QFont(self.button.font())
        font.setBold(True)
        self.button.setFont(font)

        header = QFrame()
        header.setAutoFillBackground(True)
        header.setBackgroundRole(QPalette.ColorRole.AlternateBase)
        self._header_layout = QHBoxLayout(header)
        self._header_layout.setContentsMargins(2, 1, 4, 1)
        self._header_layout.setSpacing(4)
        self._header_layout.addWidget(self.button, 1)
        self.body = QWidget()
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(0)
        layout.addWidget(header)
        layout.addWidget(self.body)
        self.button.clicked.connect(lambda: self.set_collapsed(not self._collapsed))

    def add_header_widget(self, widget: QWidget) -> None:
        """Put a widget at the right end of the header, where it stays when the section is folded."""
        self._header_layout.addWidget(widget)

    @property
    def collapsed(self) -> bool:
        """Whether the body is folded away."""
        return self._collapsed

    def set_collapsed(self, collapsed: bool) -> None:
        """Fold or unfold the body."""
        if collapsed == self._collapsed:
            return
        self._collapsed = collapsed
        self.body.setVisible(not collapsed)
        self.button.setArrowType(Qt.ArrowType.RightArrow if collapsed else Qt.ArrowType.DownArrow)
        self.collapsedChanged.emit(collapsed)
