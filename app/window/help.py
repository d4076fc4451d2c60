"""The Help menu: guide, shortcuts and what the program is made of."""

from __future__ import annotations

import platform
from collections.abc import Iterable
from html import escape
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path

from PyQt6.QtCore import QT_VERSION_STR, Qt, QUrl
from PyQt6.QtGui import QAction, QDesktopServices
from PyQt6.QtWidgets import QDialog, QDialogButtonBox, QMessageBox, QTextBrowser, QWidget

from ...widgets.basics.controls import dialog_buttons
from ...widgets.basics.icons import app_icon
from ...widgets.basics.layouts import vbox
from ...widgets.basics.messages import Messages, Severity
from ..context import TASK
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
    table = QTextBrowser()
    table.setHtml(f"<h3>Keys</h3><table>{keys}</table><h3>Mouse</h3><table>{mouse}</table>")
    buttons = dialog_buttons(QDialogButtonBox.StandardButton.Close)
    buttons.rejected.connect(dialog.close)
    vbox(table, buttons, within=dialog)
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
