"""Light and dark theme: palette, named colours, three sizes of text, and one grid of 4 px."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

from PyQt6.QtGui import QColor, QFont, QPalette
from PyQt6.QtWidgets import QApplication

ThemeChoice = Literal["light", "dark", "system"]
ThemeName = Literal["light", "dark"]
TextSize = Literal["caption", "body", "title"]

#: The one accent colour: selections, slider grooves, the tolerance band. White text on it is readable.
ACCENT = "#1a72e0"

#: Dark outline of a light line that is drawn on any image.
CASING: Final = QColor(0, 0, 0, 170)
#: Spacings and margins are multiples of this, in px.
GRID: Final = 4

#: The three sizes of text, as shares of the desktop's.
_TEXT_SIZES: Final[dict[TextSize, float]] = {"caption": 0.9, "body": 1.0, "title": 1.2}


@dataclass(frozen=True)
class ThemeColors:
    """Named colours of a theme, as ``#rrggbb``.

    ``muted`` is for secondary text, ``accent_text`` for text in the accent's hue, ``error`` for refused values,
    ``warning`` for findings, ``recording`` for the dot of a recording.
    ``border`` separates areas; ``outline`` bounds fields and grooves, ``focus`` the one with the keyboard, and ``knob``
    fills a slider's handle. ``outside`` paints what lies outside a band, ``accent`` what lies inside.
    """

    window: str
    base: str
    alternate: str
    button: str
    border: str
    outline: str
    focus: str
    knob: str
    text: str
    muted: str
    disabled: str
    accent_text: str
    error: str
    warning: str
    outside: str
    recording: str = "#d64545"
    accent: str = ACCENT
    on_accent: str = "#ffffff"


_THEMES: dict[ThemeName, ThemeColors] = {
    "light": ThemeColors(
        window="#f3f4f6",
        base="#ffffff",
        alternate="#e9ebee",
        button="#ffffff",
        border="#c9ced5",
        outline="#767e88",
        focus=ACCENT,
        knob="#ffffff",
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
        border="#3d444d",
        outline="#78818d",
        focus="#78b0ff",
        knob="#16191e",
        text="#e7eaee",
        muted="#a7b0bb",
        disabled="#747d88",
        accent_text="#78b0ff",
        error="#ff8a80",
        warning="#f2b950",
        outside="#7b8591",
    ),
}

_state: dict[str, ThemeName] = {"name": "light"}


def theme_name() -> ThemeName:
    """Return the current theme; "system" is resolved to light or dark."""
    return _state["name"]


def theme_colors(name: ThemeName | None = None) -> ThemeColors:
    return _THEMES[name or theme_name()]


def text_font(size: TextSize, *, bold: bool = False) -> QFont:
    font = QApplication.font()
    font.setPointSizeF(font.pointSizeF() * _TEXT_SIZES[size])
    font.setBold(bold)
    return font


def set_theme(name: ThemeName) -> ThemeColors:
    _state["name"] = name
    return _THEMES[name]


def make_palette(colors: ThemeColors) -> QPalette:
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
