"""The toolbar: source, playback, preset, export; and the menus that are filled when they open."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from PyQt6.QtCore import Qt
from PyQt6.QtWidgets import QMenu, QPushButton, QSizePolicy, QToolBar, QToolButton, QWidget

from .actions import Actions, Menus
from .icons import icon
from .transport import Transport

_LONGEST_NAME = 28


class ToolBar(QToolBar):
    """One row above everything."""

    def __init__(self, actions: Actions, menus: Menus, transport: Transport, parent: QWidget | None = None) -> None:
        super().__init__("Main", parent)
        self.setObjectName("toolbar")
        self.setMovable(False)
        self.setContextMenuPolicy(Qt.ContextMenuPolicy.PreventContextMenu)
        self._menus = menus
        self.source = _menu_button(menus.source, "Where the frames come from")
        self.preset = _menu_button(menus.preset, "The preset being tuned")
        self.addWidget(self.source)
        self.addSeparator()
        self.addWidget(transport)
        transport.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Preferred)
        self.addSeparator()
        self.addWidget(self.preset)
        for action in (actions.record, actions.calibrate, actions.export_patch):
            button = QToolButton()
            button.setDefaultAction(action)
            button.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextBesideIcon)
            self.addWidget(button)
        self._name_extension()
        self.show_source("none")

    def _name_extension(self) -> None:
        """Draw and name Qt's button for what finds no room; its own arrow is black in every theme, and nameless."""
        extension = self.findChild(QToolButton, "qt_toolbar_ext_button")
        assert extension is not None
        extension.setIcon(icon("more"))
        extension.setToolTip("More actions")
        extension.setAccessibleName("More actions")

    def show_source(self, name: str) -> None:
        """Name the source on its button."""
        self.source.setText(f"Source: {_literal(_shortened(name))}")
        self.source.setToolTip(f"Where the frames come from\n{name}")

    def show_preset(self, title: str, path: Path | None) -> None:
        """Name the preset on its button, with the unsaved mark."""
        self.preset.setText(f"Preset: {_literal(_shortened(title))}")
        self.preset.setToolTip(f"The preset being tuned\n{path or 'not saved to a file yet'}")

    def fill_menus(
        self,
        *,
        shipped: Callable[[], list[str]],
        new: Callable[[str], None],
        recent_presets: Callable[[], list[str]],
        open_preset: Callable[[str], None],
        recent_sources: Callable[[], list[str]],
        open_source: Callable[[str], None],
    ) -> None:
        """Say what the menus with changing entries list, and what choosing one does."""
        menus = self._menus
        for menu, entries, choose in (
            (menus.shipped_presets, shipped, new),
            (menus.recent_presets, recent_presets, open_preset),
            (menus.recent_sources, recent_sources, open_source),
        ):
            menu.aboutToShow.connect(partial(_fill, menu, entries, choose))


def _fill(menu: QMenu, entries: Callable[[], list[str]], choose: Callable[[str], None]) -> None:
    menu.clear()
    names = entries()
    for name in names:
        entry = menu.addAction(_literal(name))
        if entry is not None:
            entry.triggered.connect(partial(_chosen, choose, name))
    if not names:
        nothing = menu.addAction("None yet")
        if nothing is not None:
            nothing.setEnabled(False)


def _chosen(choose: Callable[[str], None], name: str, _checked: bool = False) -> None:
    choose(name)


def _menu_button(menu: QMenu, tip: str) -> QPushButton:
    button = QPushButton()
    button.setMenu(menu)
    button.setToolTip(tip)
    button.setFocusPolicy(Qt.FocusPolicy.TabFocus)
    return button


def _shortened(text: str) -> str:
    """Keep the end of a long text: of a path, that is what tells it from others."""
    return text if len(text) <= _LONGEST_NAME else f"…{text[1 - _LONGEST_NAME :]}"


def _literal(text: str) -> str:
    """Double each &, which Qt would take for the mark of a key and not show."""
    return text.replace("&", "&&")
