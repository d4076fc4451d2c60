"""The Help menu: guide, shortcuts, the checks of ``tactune doctor`` and what the program is made of."""

from __future__ import annotations

import platform
from collections.abc import Iterable
from html import escape
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path

from PyQt6.QtCore import QT_VERSION_STR, Qt, QUrl
from PyQt6.QtGui import QAction, QDesktopServices
from PyQt6.QtWidgets import QDialog, QDialogButtonBox, QLabel, QMessageBox, QScrollArea, QWidget

from ...widgets.basics.controls import copy_text, dialog_buttons, push_button, wrapped_label
from ...widgets.basics.dialogs import bring_up
from ...widgets.basics.icons import app_icon
from ...widgets.basics.layouts import vbox
from ...widgets.basics.messages import Messages, Severity
from ...widgets.basics.record_table import Column, RecordTable
from ..context import TASK
from ..doctor.checks import Check, State
from ..doctor.computer import check_computer, report
from ..worker.jobs import Job
from .actions import plain_text


def guide_file() -> Path:
    """Return the first page of the guide that ships with the package; `make guide` builds it."""
    return Path(str(files("tactune.app"))) / "guide" / "index.html"


def open_guide(messages: Messages) -> None:
    page = guide_file()
    if not page.is_file():
        sentence = f"The guide is not built: {page} is missing. Run make guide in the repository, or read docs/guide."
        messages.show_message("guide", Severity.WARNING, sentence, subject=TASK)
    elif not QDesktopServices.openUrl(QUrl.fromLocalFile(str(page))):
        sentence = f"No browser could be started: open {page} yourself."
        messages.show_message("guide", Severity.WARNING, sentence, subject=TASK)


MOUSE = (
    ("Drag in a view", "orbit all views"),
    ("Shift + drag, middle button", "pan"),
    ("Wheel", "zoom, in views and images"),
    ("Double click in a view or image", "enlarge it, or go back"),
    ("Drag the line between A and B", "move the wipe while presets are compared"),
    ("Click or drag in the time strip", "seek"),
    ("Eyedropper, then click in the colour image", "set the mask to the prints' colour"),
    ("Drop a file or folder", "open a preset or a recording"),
)


def show_shortcuts(parent: QWidget, actions: Iterable[QAction]) -> None:
    rows = [(_keys(action), plain_text(action)) for action in actions]
    keys = "".join(_row(key, text) for key, text in rows if key)
    mouse = "".join(_row(gesture, meaning) for gesture, meaning in MOUSE)
    dialog = QDialog(parent)
    dialog.setWindowTitle("Keyboard shortcuts")
    label = QLabel(f"<h3>Keys</h3><table>{keys}</table><h3>Mouse</h3><table>{mouse}</table>")
    label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
    label.setContentsMargins(12, 4, 12, 12)
    scroll = QScrollArea()
    scroll.setWidget(label)
    scroll.setWidgetResizable(True)
    bar = scroll.verticalScrollBar()
    if bar is not None:  # the table is as wide as its longest row; it scrolls downwards only
        scroll.setMinimumWidth(label.sizeHint().width() + bar.sizeHint().width() + 2 * scroll.frameWidth())
    buttons = dialog_buttons(QDialogButtonBox.StandardButton.Close)
    buttons.rejected.connect(dialog.close)
    vbox(scroll, buttons, within=dialog)
    dialog.resize(520, 620)
    dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
    dialog.open()


def show_about(parent: QWidget) -> None:
    box = QMessageBox(parent)
    box.setWindowTitle("About Tactune")
    box.setIconPixmap(app_icon().pixmap(64, 64))
    box.setText(f"<b>Tactune {version('tactune')}</b>")
    box.setInformativeText(
        "Calibrate and tune a soft-membrane tactile sensor with two depth cameras, then run it headless.\n\n"
        "MIT licence. Qt and PyQt6: GPL v3. Icons: Material Design Icons, Apache License 2.0.\n\n"
        f"Python {platform.python_version()}, Qt {QT_VERSION_STR}; tactune doctor lists the packages."
    )
    box.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
    box.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
    box.open()


def _keys(action: QAction) -> str:
    keys = ", ".join(shortcut.toString() for shortcut in action.shortcuts())
    return keys or action.text().partition("\t")[2]


def _row(left: str, right: str) -> str:
    return f'<tr><td style="padding-right: 24px"><b>{escape(left)}</b></td><td>{escape(right)}</td></tr>'


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
