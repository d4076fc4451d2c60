"""The panel that says how the patch compares with the scan, and how to repeat it."""

from __future__ import annotations

import math

from PyQt6.QtCore import Qt, pyqtSignal
from PyQt6.QtGui import QGuiApplication
from PyQt6.QtWidgets import QGridLayout, QHBoxLayout, QLabel, QLineEdit, QPushButton, QVBoxLayout

from ...widgets.basics.collapsible import CollapsibleSection
from .truth_work import Scores

_LINES = (
    ("symmetric_rmse_mm", "Average symmetric RMSE", "Mean of both directed RMS distances to the nearest point, mm"),
    ("hausdorff_mm", "Hausdorff distance", "The largest distance to the nearest point, of either direction, mm"),
    ("percentile_95_mm", "95th percentile", "95 % of the points lie nearer to the other cloud, mm"),
    ("scan_area", "Scan's contact", "Projected across the camera's axis, as patches are, mm²"),
    ("patch_area", "Patch", "Projected across the camera's axis, mm²"),
    ("area_error_mm2", "Area error", "How much larger the patch is than the scan's contact, mm² and per cent"),
)


class ResultPanel(CollapsibleSection):
    """Scores, the transform's file and the command line.

    Signals
    -------
    saveRequested(), loadRequested()
    copied()
        The command line was put on the clipboard.
    """

    saveRequested = pyqtSignal()
    loadRequested = pyqtSignal()
    copied = pyqtSignal()

    def __init__(self) -> None:
        super().__init__("Result")
        self.values = {name: QLabel("–") for name, _, _ in _LINES}
        self.save = QPushButton("&Save transform…")
        self.load = QPushButton("Load &transform…")
        self.command = QLineEdit()
        self.copy = QPushButton("Cop&y")
        self.note = QLabel()
        self._lay_out()
        self.save.clicked.connect(self.saveRequested)
        self.load.clicked.connect(self.loadRequested)
        self.copy.clicked.connect(self._copy)
        self.show_scores(None)
        self.show_command("", "")

    def _lay_out(self) -> None:
        self.save.setToolTip("Write T_proximity_scan as JSON, for tactune evaluate recording --transform")
        self.load.setToolTip("Take the scan's pose from a file: JSON or four lines of four numbers, metres")
        self.command.setReadOnly(True)
        self.command.setAccessibleName("Command line")
        self.command.setPlaceholderText("the command line, once the scan is aligned")
        self.copy.setToolTip("Copy the command line that repeats this result")
        self.note.setWordWrap(True)
        grid = QGridLayout()
        grid.setVerticalSpacing(2)
        grid.setColumnStretch(1, 1)
        for line, (name, title, tip) in enumerate(_LINES):
            label, value = QLabel(title), self.values[name]
            value.setAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
            value.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
            value.setAccessibleName(title)
            for widget in (label, value):
                widget.setToolTip(tip)
            grid.addWidget(label, line, 0)
            grid.addWidget(value, line, 1)
        files = QHBoxLayout()
        for button in (self.save, self.load, self.copy):
            button.setAutoDefault(False)
        for button in (self.save, self.load):
            files.addWidget(button)
        repeat = QHBoxLayout()
        repeat.addWidget(self.command, 1)
        repeat.addWidget(self.copy)
        layout = QVBoxLayout(self.body)
        layout.setContentsMargins(6, 4, 6, 6)
        layout.setSpacing(5)
        layout.addLayout(grid)
        layout.addLayout(files)
        layout.addLayout(repeat)
        layout.addWidget(self.note)

    def show_scores(self, scores: Scores | None) -> None:
        """Show how the patch compares; None: it does not yet."""
        if scores is None:
            for label in self.values.values():
                label.setText("–")
            return
        for name in ("symmetric_rmse_mm", "hausdorff_mm", "percentile_95_mm"):
            self.values[name].setText(_length(scores.values[name]))
        self.values["scan_area"].setText(f"{scores.scan_area_mm2:,.0f} mm²")
        self.values["patch_area"].setText(f"{scores.patch_area_mm2:,.0f} mm²")
        error = scores.values["area_error_mm2"]
        share = f" ({error / scores.scan_area_mm2:+.0%})" if scores.scan_area_mm2 > 0 else ""
        self.values["area_error_mm2"].setText(f"{error:+,.0f} mm²{share}")

    def show_command(self, command: str, note: str) -> None:
        """Show the command line, and what stands in the way of repeating it."""
        self.command.setText(command)
        self.command.setCursorPosition(0)
        self.command.setToolTip(command or "Align the scan first")
        self.copy.setEnabled(bool(command))
        self.note.setText(note)
        self.note.setVisible(bool(note))

    def _copy(self) -> None:
        clipboard = QGuiApplication.clipboard()
        if clipboard is not None:
            clipboard.setText(self.command.text())
            self.copied.emit()


def _length(millimetres: float) -> str:
    return f"{millimetres:.2f} mm" if math.isfinite(millimetres) else "– (one of both is empty)"
