"""How the window was left: size, splitters, what was folded or hidden, colours."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

from ...widgets.basics.theme import ThemeChoice
from ..settings import Settings
from .actions import THEMES

if TYPE_CHECKING:
    from .main_window import MainWindow

DEFAULT_SIZE = (1280, 800)
_TOGGLES = ("show_strip", "show_panel", "show_proximity", "show_tactile", "show_patch")
_FOLDED_AT_FIRST = "range,region"


def restore_layout(window: MainWindow, settings: Settings) -> None:
    """Bring the window to where it was left; what is missing or no longer fits takes its default."""
    if not window.restoreGeometry(settings.blob("window/geometry")):
        window.resize(*DEFAULT_SIZE)
    if not window.across.restoreState(settings.blob("window/across")):
        window.across.setSizes([DEFAULT_SIZE[0] - 360, 360])
    window.left.restoreState(settings.blob("window/left"))
    window.views.splitter.restoreState(settings.blob("window/views"))
    window.panel.set_collapsed_sections(settings.text("window/collapsed", _FOLDED_AT_FIRST).split(","))
    window.views.restore(settings.number("view/point_size", 2.0), settings.text("view/color_by"))
    hidden = settings.text("window/hidden").split(",")
    for name in _TOGGLES:
        getattr(window.actions_, name).setChecked(name not in hidden)
    theme = settings.text("theme", "system")
    window.set_theme(cast(ThemeChoice, theme if theme in THEMES else "system"), remember=False)


def remember_layout(window: MainWindow, settings: Settings) -> None:
    """Note how the window is being left."""
    settings.set("window/geometry", window.saveGeometry())
    settings.set("window/across", window.across.saveState())
    settings.set("window/left", window.left.saved_state())
    settings.set("window/views", window.views.splitter.saveState())
    settings.set("window/collapsed", ",".join(window.panel.collapsed_sections()))
    settings.set("view/point_size", window.views.point_size.value())
    settings.set("view/color_by", window.views.chosen_colors().value)
    hidden = [name for name in _TOGGLES if not getattr(window.actions_, name).isChecked()]
    settings.set("window/hidden", ",".join(hidden))
    settings.sync()
