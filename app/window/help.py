"""Help: the list of shortcuts, made from the actions themselves, and about."""

from __future__ import annotations

from html import escape
from importlib.metadata import version

from PyQt6.QtCore import QT_VERSION_STR, Qt
from PyQt6.QtGui import QAction
from PyQt6.QtWidgets import QDialog, QDialogButtonBox, QLabel, QMessageBox, QScrollArea, QVBoxLayout, QWidget

from .actions import Actions

_MOUSE = (
    ("Drag in a view", "orbit; all views follow"),
    ("Shift + drag, middle button", "pan"),
    ("Wheel", "zoom, in views and images"),
    ("Double click in a view", "reset the view"),
    ("Eyedropper, then click in the colour image", "take the membrane's colour for the mask"),
    ("Drop a file or folder", "open a preset or a recording"),
)


def show_shortcuts(parent: QWidget, actions: Actions) -> None:
    """Show every key and what the mouse does."""
    rows = [(_keys(action), action.text()) for action in actions.all()]
    keys = "".join(_row(key, _plain(text)) for key, text in rows if key)
    mouse = "".join(_row(gesture, meaning) for gesture, meaning in _MOUSE)
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
    buttons = QDialogButtonBox(QDialogButtonBox.StandardButton.Close)
    buttons.rejected.connect(dialog.close)
    layout = QVBoxLayout(dialog)
    layout.addWidget(scroll)
    layout.addWidget(buttons)
    dialog.resize(520, 620)
    dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
    dialog.open()


def show_about(parent: QWidget) -> None:
    """Show what this is, its version and its licences."""
    box = QMessageBox(parent)
    box.setWindowTitle("About Tactune")
    box.setText(f"<b>Tactune {version('tactune')}</b>")
    box.setInformativeText(
        "Calibrate and tune a soft-membrane tactile sensor with two depth cameras, then run it headless.\n\n"
        f"MIT licence. This window uses Qt {QT_VERSION_STR} through PyQt6 (GPL v3)."
    )
    box.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
    box.open()


def _keys(action: QAction) -> str:
    keys = ", ".join(shortcut.toString() for shortcut in action.shortcuts())
    return keys or action.text().partition("\t")[2]


def _plain(text: str) -> str:
    return text.partition("\t")[0].replace("&", "").rstrip("…")


def _row(left: str, right: str) -> str:
    return f'<tr><td style="padding-right: 24px"><b>{escape(left)}</b></td><td>{escape(right)}</td></tr>'
