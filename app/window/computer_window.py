"""The checks of ``tactune doctor`` in a window."""

from __future__ import annotations

from PyQt6.QtWidgets import QDialog, QDialogButtonBox, QWidget

from ...widgets.basics.controls import copy_text, dialog_buttons, push_button, wrapped_label
from ...widgets.basics.dialogs import bring_up
from ...widgets.basics.layouts import vbox
from ...widgets.basics.record_table import Column, RecordTable
from ..doctor.checks import Check, State
from ..doctor.report import check_computer, report
from ..worker.jobs import Job

_WORDS = {State.OK: "✓ ok", State.WARN: "! warning", State.FAIL: "✕ failed"}
_COLORS = {State.OK: "", State.WARN: "warning", State.FAIL: "error"}
_COLUMNS = (
    Column("Check", lambda line: line.name, "What was checked"),
    Column("Result", lambda line: _WORDS[line.state], "As needed, or not", color=lambda line: _COLORS[line.state]),
    Column("Found, and what to do", lambda line: f"{line.found}\n{line.remedy}".strip(), "With a remedy", stretch=True),
)


class ComputerWindow(QDialog):
    """A table of what was checked and found, with a remedy for each problem. The checks run on another thread."""

    def __init__(self, parent: QWidget) -> None:
        super().__init__(parent)
        self.setWindowTitle("Check this computer")
        self._lines: list[Check] = []
        self._job = Job(self)
        self._job.done.connect(self._show)
        self._job.failed.connect(self._end)
        self.finished.connect(self._job.stop)  # each check ends by itself within its time limit
        self.status = wrapped_label()
        self.table = RecordTable(_COLUMNS, "Checks of this computer", "What was checked and found", wraps=True)
        self.again = push_button("Check &again", "Run all checks again")
        self.copy = push_button("&Copy as text", "Copy the report to the clipboard")
        self.again.clicked.connect(self.open)
        self.copy.clicked.connect(lambda: copy_text(report(self._lines)))
        buttons = dialog_buttons(QDialogButtonBox.StandardButton.Close)
        for button in (self.again, self.copy):
            buttons.addButton(button, QDialogButtonBox.ButtonRole.ActionRole)
        buttons.rejected.connect(self.close)
        vbox(self.status, self.table, buttons, within=self)
        self.resize(760, 560)

    def open(self) -> None:
        """Show the window and run all checks, unless they run already."""
        bring_up(self)
        if not self._job.busy:
            self._end("Checking packages, cameras and the display; this takes some seconds…", running=True)
            self._job.start(lambda _: check_computer())

    def _show(self, lines: list[Check]) -> None:
        self._lines = lines
        self.table.set_records(lines)
        self._end(report(lines).splitlines()[-1] + ". Warnings concern only some uses.")

    def _end(self, sentence: str, running: bool = False) -> None:
        self.status.setText(sentence)
        for button in (self.again, self.copy):
            button.setEnabled(not running)
