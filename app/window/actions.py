"""The window's actions with their shortcuts, and the menus that hold them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

from PyQt6.QtCore import QObject
from PyQt6.QtGui import QAction, QActionGroup, QKeySequence, QUndoStack
from PyQt6.QtWidgets import QMenu, QMenuBar

from ...widgets.basics.icons import icon
from ..worker.playback import SPEEDS

StandardKey = QKeySequence.StandardKey
THEMES = ("system", "light", "dark")


@dataclass(frozen=True)
class Actions:
    """The actions by name.

    ``play`` has no shortcut: the widget with the focus (a check box, for example) gets the space bar first,
    and the window only if that widget does not use it.
    """

    new_preset: QAction
    open_preset: QAction
    save: QAction
    save_as: QAction
    details: QAction
    export_patch: QAction
    export_recording: QAction
    export_patches: QAction
    calibrate: QAction
    recheck: QAction
    watch_drift: QAction
    check_cameras: QAction
    measure_noise: QAction
    findings: QAction
    capture_untouched: QAction
    open_source: QAction
    cameras: QAction
    camera_settings: QAction
    record: QAction
    recordings_folder: QAction
    publish: QAction
    quit: QAction
    undo: QAction
    redo: QAction
    history: QAction
    changes_since_save: QAction
    compare: QAction
    next_side: QAction
    patch_difference: QAction
    wipe_left: QAction
    wipe_right: QAction
    suggest_all: QAction
    examples: QAction
    play: QAction
    previous: QAction
    next: QAction
    first: QAction
    loop: QAction
    freeze: QAction
    go_to: QAction
    mark_in: QAction
    mark_out: QAction
    clear_marks: QAction
    add_marker: QAction
    next_marker: QAction
    previous_marker: QAction
    markers: QAction
    show_strip: QAction
    show_time: QAction
    show_panel: QAction
    show_proximity: QAction
    show_tactile: QAction
    show_patch: QAction
    reset_view: QAction
    front_view: QAction
    top_view: QAction
    side_view: QAction
    zoom_to_patch: QAction
    copy_view: QAction
    messages: QAction
    getting_started: QAction
    documentation: QAction
    shortcuts: QAction
    check_computer: QAction
    about: QAction

    def all(self) -> list[QAction]:
        """Return every action in the order of the fields."""
        return [getattr(self, field.name) for field in fields(self)]


def make_actions(parent: QObject, undo_stack: QUndoStack) -> Actions:
    """Create the actions; the window connects them."""

    def action(
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

    undo = undo_stack.createUndoAction(parent, "&Undo")
    redo = undo_stack.createRedoAction(parent, "&Redo")
    assert undo is not None and redo is not None
    undo.setShortcut(QKeySequence(StandardKey.Undo))
    undo.setIcon(icon("undo"))
    redo.setIcon(icon("redo"))
    redo.setShortcuts([QKeySequence("Ctrl+Shift+Z"), QKeySequence("Ctrl+Y")])
    made = Actions(
        new_preset=action("&New preset", "", StandardKey.New, "plus"),
        open_preset=action("Open pre&set…", shortcut="Ctrl+Shift+O"),
        save=action("&Save preset", "", StandardKey.Save, "content-save-outline"),
        save_as=action("Save preset &as…", shortcut="Ctrl+Shift+S"),
        details=action("Name and no&tes…", "Edit the preset's name and notes", "F2"),
        export_patch=action(
            "&Export patch…", "Save the patch of this frame as a point cloud", "Ctrl+E", "tray-arrow-down"
        ),
        export_recording=action(
            "Export recordin&g…", "Save the frames between the in and out marks, or all, as a recording", "Ctrl+Shift+E"
        ),
        export_patches=action(
            "Export pa&tches…", "Save the patch of each frame between the in and out marks, or of all, as PLY files"
        ),
        calibrate=action(
            "&Calibrate…", "Align both cameras: click points, check and save the result", "Ctrl+K", "crosshairs-gps"
        ),
        recheck=action("&Re-check calibration", "Check the alignment on this frame", "Ctrl+Shift+K"),
        open_source=action(
            "&Open…",
            "Open cameras, a recording, the simulator or another source",
            StandardKey.Open,
            "folder-open-outline",
        ),
        watch_drift=action(
            "&Watch for drift",
            "Look once in 10 s whether a camera of a live source moved, the pressure changed or a lens is dirty, "
            "compared with the preset's untouched frame",
            checkable=True,
        ),
        check_cameras=action("C&heck cameras…", "Depth quality, noise, skew and bias of both cameras", "F6"),
        measure_noise=action(
            "&Measure noise and bias…", "Measure the noise of both cameras and the bias between them, for the preset"
        ),
        findings=action(
            "&Findings…", "List what is wrong with this frame or preset, and what mends it", "Ctrl+F", "alert-outline"
        ),
        capture_untouched=action(
            "Capture u&ntouched frame…",
            "Capture the untouched membrane, which some methods and the re-check need",
            "Ctrl+Shift+R",
        ),
        cameras=action(
            "&Connect cameras…", "Choose the two cameras among those connected and open them", "F3", "camera-outline"
        ),
        camera_settings=action(
            "Ca&mera settings…", "Exposure, laser and other settings, stored in the preset", "F4", "cog-outline"
        ),
        record=action("&Record", "Record every frame of the source, or finish the recording", "F9", "record", True),
        recordings_folder=action("Recordings fo&lder…", "Choose the folder for recordings"),
        publish=action("&Publish…", "Send patches live to Foxglove or ROS 2; off until you start it", "Ctrl+Shift+P"),
        quit=action("&Quit", shortcut="Ctrl+Q"),
        undo=undo,
        redo=redo,
        history=action("&History…", "List every step; click one to go back or forward to it", "Ctrl+H", "history"),
        changes_since_save=action(
            "&What changed since save", "Compare the preset as it was saved with the present one", "Ctrl+D"
        ),
        compare=action(
            "&Compare presets", "Show two presets side by side, or end the comparison", "Ctrl+B", checkable=True
        ),
        next_side=action("&A, B or wipe", "While presets are compared: only A, only B, or both at the wipe", "C"),
        patch_difference=action(
            "Patch &difference", "While presets are compared: both patches in one view, by colour", "D"
        ),
        wipe_left=action("Wipe to the &left", "Show less of A", "Alt+Left"),
        wipe_right=action("Wipe to the &right", "Show more of A", "Alt+Right"),
        examples=action(
            "&Examples of contact…", "Mark untouched frames and paint contact, for better suggestions", "Ctrl+L"
        ),
        suggest_all=action(
            "&Suggest all…", "Propose values for all sections, each with its evidence", "Ctrl+J", "lightbulb-outline"
        ),
        play=action("&Play\tSpace", icon_name="play"),
        previous=action("Pre&vious frame", "Pause and go one frame back", ",", "skip-previous"),
        next=action("&Next frame", "Pause and go one frame forward", ".", "skip-next"),
        first=action("&First frame", "Go to the first frame", "Ctrl+Home"),
        loop=action("&Loop", "Repeat a recording when it ends", "L", "repeat", checkable=True),
        freeze=action("Free&ze", "Hold this frame while tuning; a live source continues", "F", "snowflake", True),
        go_to=action("&Go to…", "Type a frame number, or a time in seconds such as 12.4 s", "Ctrl+G"),
        mark_in=action("&In mark", "Start the part to export, tune or record here", "I", "align-horizontal-left"),
        mark_out=action("&Out mark", "End the part to export, tune or record here", "O", "align-horizontal-right"),
        clear_marks=action("&Clear in and out", "Remove the in and out marks", "Shift+I", "close"),
        add_marker=action("Add &marker", "Add a marker at this frame", "M", "flag-outline"),
        next_marker=action("N&ext marker", "Go to the next marker", "N"),
        previous_marker=action("Previous mar&ker", "Go to the marker before", "Shift+N"),
        markers=action("M&arkers…", "List the markers: go to, rename, delete", "Ctrl+M", "format-list-bulleted"),
        show_time=action("&Time strip", "Show area, points, time or IoU over time", "Ctrl+Shift+T", checkable=True),
        show_strip=action("&Images", "Show the images below the views", "Ctrl+I", checkable=True),
        show_panel=action("Para&meters", "Show the parameter panel", "Ctrl+P", checkable=True),
        show_proximity=action("&Proximity view", shortcut="Ctrl+1", checkable=True),
        show_tactile=action("&Tactile view", shortcut="Ctrl+2", checkable=True),
        show_patch=action("Contact patch &view", shortcut="Ctrl+3", checkable=True),
        reset_view=action("&Reset views", "Look obliquely, with membrane and patch in view", "R"),
        front_view=action("&Front view", "Look along the optical axis of the proximity camera", "V"),
        top_view=action("T&op view", "Look from above", "T"),
        side_view=action("&Side view", "Look from the side", "S"),
        zoom_to_patch=action("&Zoom to patch", "Zoom in on the contact patch, keeping the direction", "Z"),
        copy_view=action(
            "&Copy view as picture",
            "Copy the view or image under the mouse, else the one with the focus, at its size on the screen",
            "Ctrl+Shift+C",
        ),
        messages=action(
            "&Messages…",
            "Go to the message over the views, or list all messages of this start",
            "F12",
        ),
        getting_started=action(
            "&Getting started", "Five steps from a source to a saved preset", icon_name="flag-outline"
        ),
        documentation=action(
            "&Documentation", "Open the guide in the browser, without a network", "F1", "help-circle-outline"
        ),
        shortcuts=action("&Shortcuts", "All keys and mouse gestures", "Shift+F1", "keyboard-outline"),
        check_computer=action(
            "&Check this computer…", "Check packages, camera driver, USB, permissions and graphics, with remedies"
        ),
        about=action("&About Tactune", icon_name="information-outline"),
    )
    for checkable in (made.loop, made.watch_drift, made.show_strip, made.show_time, made.show_panel):
        checkable.setChecked(True)
    for view in (made.show_proximity, made.show_tactile, made.show_patch):
        view.setChecked(True)
    return made


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
    view.addAction(actions.copy_view)
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
    return action.text().partition("\t")[0].replace("&", "").rstrip("…")
