"""The checks of ``tactune doctor`` in a window."""

from __future__ import annotations

from PyQt6.QtCore import Qt
from PyQt6.QtGui import QColor
from PyQt6.QtWidgets import (
    QDialog,
    QDialogButtonBox,
    QHeaderView,
    QTableWidget,
    QTableWidgetItem,
    QWidget,
)

from ...widgets.basics.controls import copy_text, dialog_buttons, push_button, read_only_table, wrapped_label
from ...widgets.basics.layouts import vbox
from ...widgets.basics.theme import theme_colors
from ..doctor.checks import Check, State
from ..doctor.report import check_computer, report
from ..worker.jobs import Job

_WORDS = {State.OK: "✓ ok", State.WARN: "! warning", State.FAIL: "✕ failed"}
_CHECKING = "Checking packages, cameras and graphics; this takes some seconds…"


class ComputerWindow(QDialog):
    """A table of what was checked and found, with a remedy for each problem. The checks run on another thread."""

    def __init__(self, parent: QWidget) -> None:
        super().__init__(parent)
        self.setWindowTitle("Check this computer")
        self._lines: list[Check] = []
        self._job = Job(self)
        self._job.done.connect(self._show)
        self._job.failed.connect(self._fail)
        self.finished.connect(self._job.stop)  # each check ends by itself within its time limit
        self.status = wrapped_label()
        self.table = QTableWidget(0, 3)
        self.table.setHorizontalHeaderLabels(["Check", "Result", "Found, and what to do"])
        header, rows = read_only_table(
            self.table, "Checks of this computer", "What was checked, the result, and what to do"
        )
        self.table.setWordWrap(True)
        header.setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        header.setSectionResizeMode(2, QHeaderView.ResizeMode.Stretch)
        header.setDefaultAlignment(Qt.AlignmentFlag.AlignLeft)
        rows.setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        self.again = push_button("Check &again", "Run all checks again")
        self.copy = push_button("&Copy as text", "Copy the report to the clipboard, for a question or a report")
        self.again.clicked.connect(self.check)
        self.copy.clicked.connect(self._copy)
        buttons = dialog_buttons(QDialogButtonBox.StandardButton.Close)
        for button in (self.again, self.copy):
            buttons.addButton(button, QDialogButtonBox.ButtonRole.ActionRole)
        buttons.rejected.connect(self.close)
        vbox(self.status, self.table, buttons, within=self)
        self.resize(760, 560)

    def check(self) -> None:
        """Run all checks, unless they run already."""
        if self._job.busy:
            return
        self.status.setText(_CHECKING)
        self._allow(False)
        self._job.start(lambda _: check_computer())

    def _show(self, lines: list[Check]) -> None:
        self._lines = lines
        colors = theme_colors()
        shades = {State.WARN: colors.warning, State.FAIL: colors.error}
        self.table.setRowCount(len(lines))
        for row, line in enumerate(lines):
            words = (line.name, _WORDS[line.state], "\n".join(filter(None, (line.found, line.remedy))))
            for column, text in enumerate(words):
                item = QTableWidgetItem(text)
                item.setTextAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignTop)
                if column == 1 and line.state in shades:
                    item.setForeground(QColor(shades[line.state]))
                self.table.setItem(row, column, item)
        self.status.setText(report(lines).splitlines()[-1] + ". Warnings concern only some uses.")
        self._allow(True)

    def _fail(self, sentence: str) -> None:
        self.status.setText(sentence)
        self._allow(True)

    def _allow(self, done: bool) -> None:
        for button in (self.again, self.copy):
            button.setEnabled(done)

    def _copy(self) -> None:
        copy_text(report(self._lines))
