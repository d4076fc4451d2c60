"""Light and dark theme: Fusion with a palette, named colours for painting, and pyqtgraph settings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, cast

import pyqtgraph as pg
from PyQt6.QtCore import Qt
from PyQt6.QtGui import QColor, QPalette
from PyQt6.QtWidgets import QApplication

ThemeChoice = Literal["light", "dark", "system"]
ThemeName = Literal["light", "dark"]

#: The one accent colour: selections, slider grooves, the tolerance band. White text on it is readable.
ACCENT = "#1a72e0"


@dataclass(frozen=True)
class ThemeColors:
    """Named colours of a theme, as ``#rrggbb``.

    ``muted`` is for secondary text, ``accent_text`` for text in the accent's hue, ``error`` for refused values,
    ``warning`` for findings;
    ``outside`` paints what lies outside a band, ``accent`` what lies inside.
    """

    window: str
    base: str
    alternate: str
    button: str
    border: str
    text: str
    muted: str
    disabled: str
    accent_text: str
    error: str
    warning: str
    outside: str
    accent: str = ACCENT
    on_accent: str = "#ffffff"


_THEMES: dict[ThemeName, ThemeColors] = {
    "light": ThemeColors(
        window="#f3f4f6",
        base="#ffffff",
        alternate="#e9ebee",
        button="#e9ebee",
        border="#b4bac2",
        text="#1b2026",
        muted="#545d68",
        disabled="#8b939c",
        accent_text="#0b5bbd",
        error="#b3231b",
        warning="#8a5200",
        outside="#8f98a3",
    ),
    "dark": ThemeColors(
        window="#20242a",
        base="#16191e",
        alternate="#262b32",
        button="#2d333b",
        border="#4a525d",
        text="#e7eaee",
        muted="#a7b0bb",
        disabled="#747d88",
        accent_text="#78b0ff",
        error="#ff8a80",
        warning="#f2b950",
        outside="#7b8591",
    ),
}

#: Widgets with boxes to tick; they paint no background of their own.
_WITH_BOXES = ("QCheckBox", "QRadioButton", "QTableView")

_state: dict[str, ThemeName] = {"name": "light"}


def theme_name() -> ThemeName:
    """Return the current theme; "system" is resolved to light or dark."""
    return _state["name"]


def theme_colors(name: ThemeName | None = None) -> ThemeColors:
    """Return the colours of a theme, by default of the current one."""
    return _THEMES[name or theme_name()]


def apply_theme(app: QApplication, choice: ThemeChoice) -> ThemeName:
    """Apply a theme to the whole application and return the resolved one.

    Widgets that paint with `theme_colors` repaint on the ``PaletteChange`` event that follows.
    With ``"system"`` the theme follows the desktop, also when that changes later.
    """
    hints = app.styleHints()
    name: ThemeName = cast(ThemeName, choice)
    if choice == "system":
        name = "dark" if hints is not None and hints.colorScheme() == Qt.ColorScheme.Dark else "light"
    app.setProperty("tactune_theme_choice", choice)
    if hints is not None and not app.property("tactune_follows_desktop"):
        app.setProperty("tactune_follows_desktop", True)
        hints.colorSchemeChanged.connect(lambda _: _follow_desktop(app))
    _state["name"] = name
    colors = _THEMES[name]
    pg.setConfigOptions(background=colors.base, foreground=colors.text)
    if app.property("tactune_style") != "fusion":
        app.setStyle("Fusion")
        app.setProperty("tactune_style", "fusion")
    palette = make_palette(colors)
    app.setPalette(palette)
    # Fusion outlines boxes in a darker shade of the window's colour, which would hardly be seen.
    palette.setColor(QPalette.ColorRole.Window, QColor(colors.muted))
    for kind in _WITH_BOXES:
        app.setPalette(palette, kind)
    return name


def make_palette(colors: ThemeColors) -> QPalette:
    """Build the palette that Fusion paints a theme with."""
    role = QPalette.ColorRole
    palette = QPalette()
    for target, value in {
        role.Window: colors.window,
        role.Base: colors.base,
        role.AlternateBase: colors.alternate,
        role.Button: colors.button,
        role.Mid: colors.border,
        role.Dark: colors.border,
        role.Light: colors.alternate,
        role.Midlight: colors.alternate,
        role.Shadow: "#000000",
        role.ToolTipBase: colors.alternate,
        role.ToolTipText: colors.text,
        role.WindowText: colors.text,
        role.Text: colors.text,
        role.ButtonText: colors.text,
        role.BrightText: colors.error,
        role.PlaceholderText: colors.muted,
        role.Link: colors.accent_text,
        role.LinkVisited: colors.accent_text,
        role.Highlight: colors.accent,
        role.HighlightedText: colors.on_accent,
        role.Accent: colors.accent,
    }.items():
        palette.setColor(target, QColor(value))
    disabled = QPalette.ColorGroup.Disabled
    for target in (role.WindowText, role.Text, role.ButtonText):
        palette.setColor(disabled, target, QColor(colors.disabled))
    palette.setColor(disabled, role.Highlight, QColor(colors.border))
    palette.setColor(disabled, role.HighlightedText, QColor(colors.text))
    return palette


def _follow_desktop(app: QApplication) -> None:
    if app.property("tactune_theme_choice") == "system":
        apply_theme(app, "system")
