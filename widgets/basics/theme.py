"""Light and dark theme: palette, named colours, three sizes of text, and one grid of 4 px."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

from PyQt6.QtCore import QObject, pyqtSignal
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
_TEXT_SIZES: Final[dict[TextSize, float]] = {"caption": 0.9, "body": 1.0, "title": 1.5}


@dataclass(frozen=True)
class ThemeColors:
    """Named colours of a theme, as ``#rrggbb``."""

    window: str
    base: str
    alternate: str
    button: str
    border: str  # separates areas
    outline: str  # bounds fields and grooves
    focus: str  # bounds the field with the keyboard
    knob: str  # fills a slider's handle
    text: str
    muted: str  # secondary text
    disabled: str
    accent_text: str  # text in the accent's hue
    error: str  # refused values
    warning: str  # findings
    outside: str  # what lies outside a band; accent: inside
    recording: str = "#d64545"
    accent: str = ACCENT
    on_accent: str = "#ffffff"


#: Field of `ThemeColors`: light, dark.
_COLORS: Final = {
    "window": ("#f3f4f6", "#20242a"),
    "base": ("#ffffff", "#16191e"),
    "alternate": ("#e9ebee", "#262b32"),
    "button": ("#ffffff", "#2d333b"),
    "border": ("#c9ced5", "#3d444d"),
    "outline": ("#767e88", "#78818d"),
    "focus": (ACCENT, "#78b0ff"),
    "knob": ("#ffffff", "#16191e"),
    "text": ("#1b2026", "#e7eaee"),
    "muted": ("#545d68", "#a7b0bb"),
    "disabled": ("#8b939c", "#747d88"),
    "accent_text": ("#0b5bbd", "#78b0ff"),
    "error": ("#b3231b", "#ff8a80"),
    "warning": ("#8a5200", "#f2b950"),
    "outside": ("#8f98a3", "#7b8591"),
}
_THEMES: Final[dict[ThemeName, ThemeColors]] = {
    "light": ThemeColors(**{name: light for name, (light, _) in _COLORS.items()}),
    "dark": ThemeColors(**{name: dark for name, (_, dark) in _COLORS.items()}),
}


class Theme(QObject):
    """The present theme: what was chosen, and the name to which "system" is resolved."""

    changed = pyqtSignal()  # all widgets have the new palette

    choice: ThemeChoice = "system"
    name: ThemeName = "light"


THEME: Final = Theme()


def theme_colors(name: ThemeName | None = None) -> ThemeColors:
    return _THEMES[name or THEME.name]


def text_font(size: TextSize, *, bold: bool = False) -> QFont:
    font = QApplication.font()
    font.setPointSizeF(font.pointSizeF() * _TEXT_SIZES[size])
    font.setBold(bold)
    return font


def make_palette(colors: ThemeColors) -> QPalette:
    role = QPalette.ColorRole
    palette = QPalette()
    for color, roles in (
        (colors.window, [role.Window]),
        (colors.base, [role.Base]),
        (colors.alternate, [role.AlternateBase, role.Light, role.Midlight, role.ToolTipBase]),
        (colors.button, [role.Button]),
        (colors.border, [role.Mid, role.Dark]),
        ("#000000", [role.Shadow]),
        (colors.text, [role.WindowText, role.Text, role.ButtonText, role.ToolTipText]),
        (colors.muted, [role.PlaceholderText]),
        (colors.error, [role.BrightText]),
        (colors.accent_text, [role.Link, role.LinkVisited]),
        (colors.accent, [role.Highlight, role.Accent]),
        (colors.on_accent, [role.HighlightedText]),
    ):
        for target in roles:
            palette.setColor(target, QColor(color))
    disabled = QPalette.ColorGroup.Disabled
    for target in (role.WindowText, role.Text, role.ButtonText):
        palette.setColor(disabled, target, QColor(colors.disabled))
    palette.setColor(disabled, role.Highlight, QColor(colors.border))
    palette.setColor(disabled, role.HighlightedText, QColor(colors.text))
    return palette
