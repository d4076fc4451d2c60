"""The window's actions in one table: menus, toolbar, shortcut list and tooltips all come from it.

To add an action, write one row where it stands in its menu, and connect ``actions.<name>`` in the main window.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from PyQt6.QtCore import QObject
from PyQt6.QtGui import QAction, QActionGroup, QKeySequence, QUndoStack
from PyQt6.QtWidgets import QMenu, QMenuBar

from ...widgets.basics.icons import icon
from ..worker.playback import SPEEDS

THEMES = ("system", "light", "dark")


@dataclass(frozen=True)
class Row:
    """One action: name, text, keys (commas between), tip and icon; ``checked`` is None or the state at first."""

    name: str
    text: str
    keys: str = ""
    tip: str = ""
    icon: str = ""
    checked: bool | None = None


@dataclass(frozen=True)
class Submenu:
    """A menu inside a menu whose entries change while the window runs."""

    name: str
    text: str


_LINE: Final = None
_Entry = Row | Submenu | None

#: Menu by menu, in the order in which people see them. The play key has no shortcut of its own: the widget with the
#: focus (a check box, for example) gets the space bar first, and the window only if that widget does not use it.
TABLE: Final[dict[str, tuple[_Entry, ...]]] = {
    "&File": (
        Row("open_source", "&Open…", "Ctrl+O", "Open cameras, a recording or the simulator", "folder-open-outline"),
        Row("cameras", "&Connect cameras…", "F3", "Choose the two cameras among those connected", "camera-outline"),
        Row("camera_settings", "Ca&mera settings…", "F4", "Exposure, laser and others, kept in the preset"),
        _LINE,
        Row("new_preset", "&New preset", "Ctrl+N", icon="plus"),
        Submenu("shipped_presets", "New from s&hipped preset"),
        Row("open_preset", "Open pre&set…", "Ctrl+Shift+O"),
        Row("save", "&Save preset", "Ctrl+S", icon="content-save-outline"),
        Row("save_as", "Save preset &as…", "Ctrl+Shift+S"),
        Row("copy_command", "&Copy as command", tip="Copy the command that computes these patches without a window"),
        Row("copy_python", "Copy as P&ython", tip="Copy the Python program that computes these patches"),
        Submenu("recent_presets", "&Recent presets"),
        Row("reopen", "Open again at s&tart", tip="The next start opens this source and preset", checked=True),
        _LINE,
        Row(
            "export",
            "&Export…",
            "Ctrl+E",
            "Save patch, marked frames, their views or calibration for other tools",
            "tray-arrow-down",
        ),
        _LINE,
        Row("quit", "&Quit", "Ctrl+Q"),
    ),
    "&Edit": (
        Row("undo", "&Undo", "Ctrl+Z", icon="undo"),
        Row("redo", "&Redo", "Ctrl+Shift+Z, Ctrl+Y", icon="redo"),
        _LINE,
        Row("search", "Searc&h", "Ctrl+Shift+P", "Find every action and parameter by name"),
        _LINE,
        Row("suggest_all", "&Suggest all…", "Ctrl+J", "Propose values for all sections, each with its evidence"),
        _LINE,
        Row("compare", "&Compare presets", "Ctrl+B", "Saved and present preset, or any two; again: end", checked=False),
        _LINE,
        Row("next_side", "&A, B or wipe", "C", "While presets are compared: only A, only B, or both at the wipe"),
        Row("wipe_left", "Wipe to the &left", "Alt+Left", "Show less of A"),
        Row("wipe_right", "Wipe to the &right", "Alt+Right", "Show more of A"),
    ),
    "&View": (
        Row("set_up", "&1 Set up", "Ctrl+1", "Cameras or recording, untouched frame, alignment, noise", checked=True),
        Row("tune", "&2 Tune", "Ctrl+2", "Mask, contact test and limits", checked=False),
        Row("run", "&3 Record and run", "Ctrl+3", "Record, mark, export, publish", checked=False),
        _LINE,
        Row("reset_view", "&Reset views", "R", "Look obliquely, with membrane and patch in view"),
        Row("front_view", "&Front view", "V", "Look along the optical axis of the proximity camera"),
        Row("top_view", "T&op view", "T", "Look from above"),
        Row("side_view", "&Side view", "S", "Look from the side"),
        Row("zoom_to_patch", "&Zoom to patch", "Z", "Zoom in on the contact patch, keeping the direction"),
        _LINE,
        Row("show_proximity", "&Proximity view", "Alt+1", checked=True),
        Row("show_tactile", "&Tactile view", "Alt+2", checked=True),
        Row("show_patch", "Contact patch &view", "Alt+3", checked=True),
        _LINE,
        Row("show_strip", "&Images", "Ctrl+I", "Show the images below the views", checked=True),
        Row("show_panel", "Co&ntrols", "Ctrl+P", "Show the controls of the mode at the right", checked=True),
        _LINE,
        Submenu("themes", "T&heme"),
    ),
    "&Playback": (
        Row("play", "&Play\tSpace", icon="play"),
        Row("previous", "Pre&vious frame", ",", "Pause and go one frame back", "skip-previous"),
        Row("next", "&Next frame", ".", "Pause and go one frame forward", "skip-next"),
        Row("first", "&First frame", "Ctrl+Home", "Go to the first frame"),
        _LINE,
        Row("go_to", "&Go to…", "Ctrl+G", "Type a frame number"),
        Row("loop", "&Loop", "L", "Repeat a recording when it ends", "repeat", True),
        _LINE,
        Row("mark_in", "&In mark", "I", "Start the part to export or tune here"),
        Row("mark_out", "&Out mark", "O", "End the part to export or tune here"),
        Row("clear_marks", "&Clear in and out", "Shift+I", "Remove the in and out marks"),
        _LINE,
        Row("record", "&Record", "F9", "Record every frame of a live source, or stop", "record", False),
        Row("recordings_folder", "Recordings fo&lder…", tip="Choose the folder for recordings"),
        _LINE,
        Submenu("speeds", "S&peed"),
    ),
    "&Calibration": (
        Row("calibrate", "&Calibrate…", "Ctrl+K", "Align both cameras by clicked points", "crosshairs-gps"),
        Row("check_drift", "Check for &drift…", "Ctrl+Shift+K", "Check alignment and membrane on this frame"),
        Row("watch_drift", "&Watch for drift", tip="Warn when a camera moved or the pressure changed", checked=True),
        Row("measure_noise", "&Measure noise and bias…", "F6", "Measure both cameras' noise and bias, for the preset"),
        Row("calibrate_force", "Calibrate f&orce…", tip="Measure the inflation from presses on a scale, for newtons"),
    ),
    "&Analysis": (
        Submenu("tabs", ""),  # the analysis tabs stand here, without a menu of their own
        Row("capture_untouched", "Capture u&ntouched frame…", "Ctrl+Shift+R", "Capture the untouched membrane"),
        Row("findings", "&Findings…", "Ctrl+F", "List what is wrong with this frame or preset, and what mends it"),
    ),
    "C&onnect": (Row("publish", "&Publish", "F8", "Send patches live to Foxglove or ROS 2; off until you start it"),),
    "&Help": (
        Row("documentation", "&Documentation", "F1", "Open the guide in the browser", "help-circle-outline"),
        Row("shortcuts", "&Shortcuts", "Shift+F1", "Keys and mouse gestures: a page of the guide", "keyboard-outline"),
        _LINE,
        Row("messages", "&Messages", "F12", "Go to the newest message"),
        Row("about", "&About Tactune", icon="information-outline"),
    ),
}


#: What a rig with a tactile camera only does not have, and why.
_OF_TWO_CAMERAS: Final = ("calibrate", "show_proximity")
ONE_CAMERA: Final = "This rig has a tactile camera only; this needs two cameras"


class Actions:
    """The actions of `TABLE` by name, as in ``actions.save``."""

    def __init__(self, parent: QObject, undo_stack: QUndoStack) -> None:
        made = {
            "undo": undo_stack.createUndoAction(parent, "&Undo"),
            "redo": undo_stack.createRedoAction(parent, "&Redo"),
        }
        self._actions = {row.name: _set_up(made.get(row.name) or QAction(parent), row) for row in _rows()}

    def __getattr__(self, name: str) -> QAction:
        return self._actions[name]

    def set_two_cameras(self, two: bool) -> None:
        """Enable what needs two cameras, or say why it is disabled."""
        for row in _rows():
            if row.name in _OF_TWO_CAMERAS:
                action = self._actions[row.name]
                action.setEnabled(two)
                action.setToolTip(_tip(row) if two else ONE_CAMERA)

    def by_name(self) -> dict[str, QAction]:
        return dict(self._actions)


def _rows() -> list[Row]:
    return [row for entries in TABLE.values() for row in entries if isinstance(row, Row)]


def _tip(row: Row) -> str:
    plain, _, pressed = row.text.replace("&", "").partition("\t")
    keys = QKeySequence(row.keys.split(", ")[0]).toString() or pressed
    return f"{row.tip or plain.rstrip('…')}{f' ({keys})' if keys else ''}"


def _set_up(action: QAction, row: Row) -> QAction:
    action.setShortcuts([QKeySequence(key) for key in row.keys.split(", ")] if row.keys else [])
    if row.icon:
        action.setIcon(icon(row.icon, "recording" if row.name == "record" else ""))
    if row.name in ("undo", "redo"):  # Qt keeps their text: it names the step
        action.setIconText(row.text.replace("&", "").partition("\t")[0])
        return action
    action.setText(row.text)
    if row.checked is not None:
        action.setCheckable(True)
        action.setChecked(row.checked)
    action.setToolTip(_tip(row))
    return action


class Menus:
    """The menu bar, filled, and its menus whose entries change while the window runs; ``tabs`` open analysis tabs."""

    def __init__(self, bar: QMenuBar, actions: Actions, tabs: Sequence[QAction]) -> None:
        submenus: dict[str, QMenu] = {}
        for title, entries in TABLE.items():
            menu = bar.addMenu(title)
            assert menu is not None
            menu.setToolTipsVisible(True)
            for entry in entries:
                if entry is None:
                    menu.addSeparator()
                elif isinstance(entry, Row):
                    menu.addAction(getattr(actions, entry.name))
                elif entry.name == "tabs":
                    menu.addActions(tabs)
                else:
                    submenu = submenus[entry.name] = QMenu(entry.text, menu)
                    menu.addMenu(submenu)
        self.shipped_presets, self.recent_presets = submenus["shipped_presets"], submenus["recent_presets"]
        #: The menu of the button *Preset*, of the same actions.
        self.preset = QMenu("Preset", bar)
        self.preset.addAction(actions.new_preset)
        self.preset.addMenu(self.shipped_presets)
        copies = actions.copy_command, actions.copy_python
        self.preset.addActions([actions.open_preset, actions.save, actions.save_as, *copies])
        self.preset.addMenu(self.recent_presets)
        self.themes = _choices(submenus["themes"], [(theme.capitalize(), theme) for theme in THEMES])
        self.speeds = _choices(submenus["speeds"], [(f"{speed:g} x", speed) for speed in SPEEDS])


def _choices(menu: QMenu, entries: list[tuple[str, object]]) -> QActionGroup:
    group = QActionGroup(menu)
    for title, data in entries:
        entry = menu.addAction(title)
        assert entry is not None
        entry.setCheckable(True)
        entry.setData(data)
        group.addAction(entry)
    return group


def plain_text(action: QAction) -> str:
    """Return an action's text without mnemonic, shortcut and dots."""
    return action.iconText().partition("\t")[0].rstrip("…")
