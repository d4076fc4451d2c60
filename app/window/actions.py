"""The window's actions with their shortcuts, and the menus that hold them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from PyQt6.QtCore import QObject
from PyQt6.QtGui import QAction, QActionGroup, QKeySequence, QUndoStack
from PyQt6.QtWidgets import QMenu, QMenuBar

from ...widgets.basics.icons import icon
from ..worker.playback import SPEEDS

StandardKey = QKeySequence.StandardKey
THEMES = ("system", "light", "dark")


def _action(
    parent: QObject,
    text: str,
    tip: str = "",
    shortcut: QKeySequence | StandardKey | str | None = None,
    icon_name: str = "",
    checkable: bool = False,
) -> QAction:
    made = QAction(text, parent)
    if shortcut is not None:
        made.setShortcut(QKeySequence(shortcut))
    if icon_name:
        made.setIcon(icon(icon_name, "recording" if icon_name == "record" else ""))
    made.setCheckable(checkable)
    plain = text.split("\t", maxsplit=1)
    keys = made.shortcut().toString() or (plain[1] if len(plain) > 1 else "")
    made.setToolTip(f"{tip or plain[0].replace('&', '').rstrip('…')}{f' ({keys})' if keys else ''}")
    return made


class Actions:
    """The actions by name; the window connects them.

    ``play`` has no shortcut: the widget with the focus (a check box, for example) gets the space bar first,
    and the window only if that widget does not use it.
    """

    def __init__(self, parent: QObject, undo_stack: QUndoStack) -> None:  # noqa: PLR0915  # one line for each action
        action = partial(_action, parent)
        self.new_preset = action("&New preset", "", StandardKey.New, "plus")
        self.open_preset = action("Open pre&set…", shortcut="Ctrl+Shift+O")
        self.save = action("&Save preset", "", StandardKey.Save, "content-save-outline")
        self.save_as = action("Save preset &as…", shortcut="Ctrl+Shift+S")
        self.details = action("Name and no&tes…", "Edit the preset's name and notes", "F2")
        self.export_patch = action(
            "&Export patch…", "Save the patch of this frame as a point cloud", "Ctrl+E", "tray-arrow-down"
        )
        self.export_recording = action(
            "Export recordin&g…", "Save the frames between the in and out marks, or all, as a recording", "Ctrl+Shift+E"
        )
        self.export_patches = action(
            "Export pa&tches…", "Save the patch of each frame between the in and out marks, or of all, as PLY files"
        )
        self.calibrate = action(
            "&Calibrate…", "Align both cameras: click points, check and save the result", "Ctrl+K", "crosshairs-gps"
        )
        self.recheck = action("&Re-check calibration", "Check the alignment on this frame", "Ctrl+Shift+K")
        self.open_source = action(
            "&Open…",
            "Open cameras, a recording, the simulator or another source",
            StandardKey.Open,
            "folder-open-outline",
        )
        self.watch_drift = action(
            "&Watch for drift",
            "Look once in 10 s whether a camera of a live source moved, the pressure changed or a lens is dirty, "
            "compared with the preset's untouched frame",
            checkable=True,
        )
        self.check_cameras = action("C&heck cameras…", "Depth quality, noise, skew and bias of both cameras", "F6")
        self.measure_noise = action(
            "&Measure noise and bias…", "Measure the noise of both cameras and the bias between them, for the preset"
        )
        self.findings = action(
            "&Findings…", "List what is wrong with this frame or preset, and what mends it", "Ctrl+F", "alert-outline"
        )
        self.capture_untouched = action(
            "Capture u&ntouched frame…",
            "Capture the untouched membrane, which some methods and the re-check need",
            "Ctrl+Shift+R",
        )
        self.cameras = action(
            "&Connect cameras…", "Choose the two cameras among those connected and open them", "F3", "camera-outline"
        )
        self.camera_settings = action(
            "Ca&mera settings…", "Exposure, laser and other settings, stored in the preset", "F4", "cog-outline"
        )
        self.record = action(
            "&Record", "Record every frame of the source, or finish the recording", "F9", "record", True
        )
        self.recordings_folder = action("Recordings fo&lder…", "Choose the folder for recordings")
        self.publish = action(
            "&Publish…", "Send patches live to Foxglove or ROS 2; off until you start it", "Ctrl+Shift+P"
        )
        self.quit = action("&Quit", shortcut="Ctrl+Q")
        undo = undo_stack.createUndoAction(parent, "&Undo")
        redo = undo_stack.createRedoAction(parent, "&Redo")
        assert undo is not None and redo is not None
        undo.setShortcut(QKeySequence(StandardKey.Undo))
        undo.setIconText("Undo")  # without the step that the text names
        redo.setIconText("Redo")
        undo.setIcon(icon("undo"))
        redo.setIcon(icon("redo"))
        redo.setShortcuts([QKeySequence("Ctrl+Shift+Z"), QKeySequence("Ctrl+Y")])
        self.undo, self.redo = undo, redo
        self.history = action(
            "&History…", "List every step; click one to go back or forward to it", "Ctrl+H", "history"
        )
        self.changes_since_save = action(
            "&What changed since save", "Compare the preset as it was saved with the present one", "Ctrl+D"
        )
        self.compare = action(
            "&Compare presets", "Show two presets side by side, or end the comparison", "Ctrl+B", checkable=True
        )
        self.next_side = action("&A, B or wipe", "While presets are compared: only A, only B, or both at the wipe", "C")
        self.patch_difference = action(
            "Patch &difference", "While presets are compared: both patches in one view, by colour", "D"
        )
        self.wipe_left = action("Wipe to the &left", "Show less of A", "Alt+Left")
        self.wipe_right = action("Wipe to the &right", "Show more of A", "Alt+Right")
        self.examples = action(
            "&Examples of contact…", "Mark untouched frames and paint contact, for better suggestions", "Ctrl+L"
        )
        self.suggest_all = action(
            "&Suggest all…", "Propose values for all sections, each with its evidence", "Ctrl+J", "lightbulb-outline"
        )
        self.play = action("&Play\tSpace", icon_name="play")
        self.previous = action("Pre&vious frame", "Pause and go one frame back", ",", "skip-previous")
        self.next = action("&Next frame", "Pause and go one frame forward", ".", "skip-next")
        self.first = action("&First frame", "Go to the first frame", "Ctrl+Home")
        self.loop = action("&Loop", "Repeat a recording when it ends", "L", "repeat", checkable=True)
        self.freeze = action("Free&ze", "Hold this frame while tuning; a live source continues", "F", "snowflake", True)
        self.go_to = action("&Go to…", "Type a frame number, or a time in seconds such as 12.4 s", "Ctrl+G")
        self.mark_in = action("&In mark", "Start the part to export, tune or record here", "I", "align-horizontal-left")
        self.mark_out = action(
            "&Out mark", "End the part to export, tune or record here", "O", "align-horizontal-right"
        )
        self.clear_marks = action("&Clear in and out", "Remove the in and out marks", "Shift+I", "close")
        self.add_marker = action("Add &marker", "Add a marker at this frame", "M", "flag-outline")
        self.next_marker = action("N&ext marker", "Go to the next marker", "N")
        self.previous_marker = action("Previous mar&ker", "Go to the marker before", "Shift+N")
        self.markers = action("M&arkers…", "List the markers: go to, rename, delete", "Ctrl+M", "format-list-bulleted")
        self.show_time = action(
            "&Time strip", "Show area, points, time or IoU over time", "Ctrl+Shift+T", checkable=True
        )
        self.show_strip = action("&Images", "Show the images below the views", "Ctrl+I", checkable=True)
        self.show_panel = action("Para&meters", "Show the parameter panel", "Ctrl+P", checkable=True)
        self.show_proximity = action("&Proximity view", shortcut="Ctrl+1", checkable=True)
        self.show_tactile = action("&Tactile view", shortcut="Ctrl+2", checkable=True)
        self.show_patch = action("Contact patch &view", shortcut="Ctrl+3", checkable=True)
        self.reset_view = action("&Reset views", "Look obliquely, with membrane and patch in view", "R")
        self.front_view = action("&Front view", "Look along the optical axis of the proximity camera", "V")
        self.top_view = action("T&op view", "Look from above", "T")
        self.side_view = action("&Side view", "Look from the side", "S")
        self.zoom_to_patch = action("&Zoom to patch", "Zoom in on the contact patch, keeping the direction", "Z")
        self.measure = action(
            "&Measure distance",
            "Take the marked point as an end of a distance; arrow keys in the images move the mark",
            "Shift+D",
        )
        self.copy_view = action(
            "&Copy view as picture",
            "Copy the view or image under the mouse, else the one with the focus, at its size on the screen",
            "Ctrl+Shift+C",
        )
        self.messages = action(
            "&Messages…",
            "Go to the message over the views, or list all messages of this start",
            "F12",
        )
        self.getting_started = action(
            "&Getting started", "Five steps from a source to a saved preset", icon_name="flag-outline"
        )
        self.documentation = action(
            "&Documentation", "Open the guide in the browser, without a network", "F1", "help-circle-outline"
        )
        self.shortcuts = action("&Shortcuts", "All keys and mouse gestures", "Shift+F1", "keyboard-outline")
        self.check_computer = action(
            "&Check this computer…", "Check packages, camera driver, USB, permissions and graphics, with remedies"
        )
        self.about = action("&About Tactune", icon_name="information-outline")
        for checkable in (self.loop, self.watch_drift, self.show_strip, self.show_time, self.show_panel):
            checkable.setChecked(True)
        for view in (self.show_proximity, self.show_tactile, self.show_patch):
            view.setChecked(True)

    def all(self) -> list[QAction]:
        """Return every action in the order of its definition."""
        return list(vars(self).values())


@dataclass(frozen=True)
class Menus:
    """The menus whose entries change while the window runs."""

    preset: QMenu
    recent_presets: QMenu
    shipped_presets: QMenu
    themes: QActionGroup
    speeds: QActionGroup


def make_menus(bar: QMenuBar, actions: Actions, tabs: Sequence[QAction]) -> Menus:
    """Fill the menu bar, and build the toolbar's menu of presets from the same actions; ``tabs`` open analysis tabs."""
    parent = bar
    preset = QMenu("Preset", parent)
    preset.addAction(actions.new_preset)
    shipped = _submenu(preset, "New from s&hipped preset")
    preset.addActions([actions.open_preset, actions.save, actions.save_as, actions.details])
    recent_presets = _submenu(preset, "&Recent presets")

    file_menu = _menu(bar, "&File")
    file_menu.addActions([actions.open_source, actions.cameras, actions.camera_settings])
    file_menu.addSeparator()
    file_menu.addAction(actions.new_preset)
    file_menu.addMenu(shipped)
    file_menu.addActions([actions.open_preset, actions.save, actions.save_as, actions.details])
    file_menu.addMenu(recent_presets)
    file_menu.addSeparator()
    file_menu.addActions([actions.export_patch, actions.export_patches, actions.export_recording])
    file_menu.addSeparator()
    file_menu.addAction(actions.quit)

    _fill_edit_menu(_menu(bar, "&Edit"), actions)

    view = _menu(bar, "&View")
    view.addActions(
        [actions.reset_view, actions.front_view, actions.top_view, actions.side_view, actions.zoom_to_patch]
    )
    view.addActions([actions.measure, actions.copy_view])
    view.addSeparator()
    view.addActions([actions.show_proximity, actions.show_tactile, actions.show_patch])
    view.addSeparator()
    view.addActions([actions.show_time, actions.show_strip, actions.show_panel])
    view.addSeparator()
    themes = _choices(_submenu(view, "T&heme"), [(theme.capitalize(), theme) for theme in THEMES])

    speeds = _fill_playback(_menu(bar, "&Playback"), actions)
    _menu(bar, "&Calibration").addActions(
        [actions.calibrate, actions.recheck, actions.watch_drift, actions.check_cameras, actions.measure_noise]
    )
    _menu(bar, "&Analysis").addActions([*tabs, actions.capture_untouched, actions.findings])
    _menu(bar, "C&onnect").addAction(actions.publish)
    guide = _menu(bar, "&Help")
    guide.addActions([actions.getting_started, actions.documentation, actions.shortcuts])
    guide.addSeparator()
    guide.addActions([actions.messages, actions.check_computer, actions.about])
    return Menus(preset, recent_presets, shipped, themes, speeds)


def _fill_edit_menu(menu: QMenu, actions: Actions) -> None:
    menu.addActions([actions.undo, actions.redo, actions.history])
    menu.addSeparator()
    menu.addActions([actions.suggest_all, actions.examples])
    menu.addSeparator()
    menu.addActions([actions.changes_since_save, actions.compare])
    menu.addSeparator()
    menu.addActions([actions.next_side, actions.patch_difference, actions.wipe_left, actions.wipe_right])


def _fill_playback(playback: QMenu, actions: Actions) -> QActionGroup:
    """Fill the Playback menu; return the choice of speeds."""
    playback.addActions([actions.play, actions.previous, actions.next, actions.first])
    playback.addSeparator()
    playback.addActions([actions.go_to, actions.loop, actions.freeze])
    playback.addSeparator()
    playback.addActions([actions.mark_in, actions.mark_out, actions.clear_marks])
    playback.addSeparator()
    playback.addActions([actions.add_marker, actions.previous_marker, actions.next_marker, actions.markers])
    playback.addSeparator()
    playback.addActions([actions.record, actions.recordings_folder])
    playback.addSeparator()
    return _choices(_submenu(playback, "S&peed"), [(f"{speed:g} x", speed) for speed in SPEEDS])


def _menu(bar: QMenuBar, title: str) -> QMenu:
    menu = bar.addMenu(title)
    assert menu is not None
    menu.setToolTipsVisible(True)
    return menu


def _submenu(menu: QMenu, title: str) -> QMenu:
    submenu = menu.addMenu(title)
    assert submenu is not None
    return submenu


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
