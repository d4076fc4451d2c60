"""The Help menu: guide, shortcuts, checks of this computer, and what the program is made of."""

from __future__ import annotations

import platform
import re
from collections.abc import Iterable
from contextlib import suppress
from html import escape
from importlib.metadata import PackageNotFoundError, requires, version
from importlib.resources import files
from pathlib import Path

from PyQt6.QtCore import QT_VERSION_STR, Qt, QUrl
from PyQt6.QtGui import QAction, QDesktopServices
from PyQt6.QtWidgets import QDialog, QDialogButtonBox, QLabel, QMessageBox, QScrollArea, QWidget

from ...widgets.basics.controls import dialog_buttons
from ...widgets.basics.icons import app_icon
from ...widgets.basics.layouts import vbox
from ...widgets.basics.messages import Messages, Severity
from ..context import TASK
from .actions import plain_text

#: The extras that running needs; the others are for development.
_RUNS = re.compile(r'extra == "(gui|realsense|open3d|tune|live)"')


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
    ("Shift + click two points in a view", "measure their distance; Esc clears it"),
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
    """Show name, version, licences and the versions of what this window runs with."""
    box = QMessageBox(parent)
    box.setWindowTitle("About Tactune")
    box.setIconPixmap(app_icon().pixmap(64, 64))
    box.setText(f"<b>Tactune {version('tactune')}</b>")
    box.setInformativeText(
        "Calibrate and tune a soft-membrane tactile sensor with two depth cameras, then run it headless.\n\n"
        "MIT licence. Qt and PyQt6: GPL v3. Icons: Material Design Icons, Apache License 2.0.\n\n" + versions()
    )
    box.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
    box.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
    box.open()


def versions() -> str:
    """Return the versions of Python, Qt and the packages that Tactune runs with, as far as they are installed."""
    needed = [line for line in requires("tactune") or () if "extra" not in line or _RUNS.search(line)]
    names = sorted({re.split(r"[^\w.-]", line, maxsplit=1)[0] for line in needed}, key=str.lower)
    found = [f"Python {platform.python_version()}", f"Qt {QT_VERSION_STR}"]
    for name in names:
        with suppress(PackageNotFoundError):
            found.append(f"{name} {version(name)}")
    return ", ".join(found) + "."


def _keys(action: QAction) -> str:
    keys = ", ".join(shortcut.toString() for shortcut in action.shortcuts())
    return keys or action.text().partition("\t")[2]


def _row(left: str, right: str) -> str:
    return f'<tr><td style="padding-right: 24px"><b>{escape(left)}</b></td><td>{escape(right)}</td></tr>'
