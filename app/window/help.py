"""The Help menu: the guide, and what the program is made of."""

from __future__ import annotations

import platform
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path

from PyQt6.QtCore import QT_VERSION_STR, Qt, QUrl
from PyQt6.QtGui import QDesktopServices
from PyQt6.QtWidgets import QMessageBox, QWidget

from ...widgets.basics.icons import app_icon
from ...widgets.basics.messages import Messages, Severity
from ..context import TASK


def guide_file(name: str) -> Path:
    """Return a page of the guide that ships with the package; `make guide` builds it."""
    return Path(str(files("tactune.app"))) / "guide" / f"{name}.html"


def open_guide(messages: Messages, name: str = "index") -> None:
    page = guide_file(name)
    if not page.is_file():
        sentence = f"The guide is not built: {page} is missing. Run make guide in the repository, or read docs/guide."
        messages.show_message("guide", Severity.WARNING, sentence, subject=TASK)
    elif not QDesktopServices.openUrl(QUrl.fromLocalFile(str(page))):
        sentence = f"No browser could be started: open {page} yourself."
        messages.show_message("guide", Severity.WARNING, sentence, subject=TASK)


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
