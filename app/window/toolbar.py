"""The mode bar at the top of the window, and the buttons of playback beside the time strip."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from PyQt6.QtCore import QSignalBlocker, Qt
from PyQt6.QtGui import QKeyEvent
from PyQt6.QtWidgets import QAbstractSpinBox, QMenu, QPushButton, QSpinBox, QWidget

from ...core.errors import counted
from ...widgets.basics.controls import action_button, named
from ...widgets.basics.icons import icon
from ...widgets.basics.layouts import hbox
from ..worker.playback import PlaybackState
from ..worker.results import SourceInfo
from .actions import Actions
from .modes import Mode


class FrameNumber(QSpinBox):
    """The frame on the screen, from 0. Enter goes to the typed number; Esc brings back the one on the screen."""

    def __init__(self) -> None:
        super().__init__()
        named(self, "Frame number", "Frame, from 0 as in files and commands. Type a number to go to it")
        self.setButtonSymbols(QAbstractSpinBox.ButtonSymbols.NoButtons)  # Previous and Next stand beside it
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)  # not by the wheel: while it has the focus it stands still
        self.setKeyboardTracking(False)
        self.setRange(0, 99_999_999)
        self.setFixedWidth(self.fontMetrics().horizontalAdvance("00000 / 00000") + 12)
        self.editingFinished.connect(self.clearFocus)

    def show_frame(self, index: int, length: int | None) -> None:
        """Show a frame; what a person types stays until it is finished."""
        if not self.hasFocus():
            suffix = f" / {length - 1}" if length is not None else ""
            with QSignalBlocker(self):
                if suffix != self.suffix():  # both of these lay out the whole window
                    self.setMaximum(99_999_999 if length is None else length - 1)
                    self.setSuffix(suffix)
                self.setValue(index)

    def keyPressEvent(self, event: QKeyEvent | None) -> None:
        if event is not None and event.key() == Qt.Key.Key_Escape:
            self.setValue(self.value())  # replaces the typed text
            self.clearFocus()
        else:
            super().keyPressEvent(event)


class Transport(QWidget):
    """The buttons of playback, and the number of the frame."""

    def __init__(self, actions: Actions) -> None:
        super().__init__()
        self._actions = actions
        self.setAutoFillBackground(True)  # else each frame number would paint all widgets behind it
        self.state = PlaybackState(length=1)
        self.position = FrameNumber()
        actions.go_to.triggered.connect(self._go_to)
        buttons = map(action_button, (actions.previous, actions.play, actions.next, actions.loop))
        hbox(*buttons, self.position, within=self, margins=0, spacing=4)
        self._show_mode()

    def show_state(self, state: PlaybackState) -> None:
        changed = replace(state, index=0) != replace(self.state, index=0)
        self.state = state
        if changed:
            self._show_mode()
        self.position.show_frame(state.index, state.length)

    def show_change(self, state: PlaybackState) -> None:
        """Show a change of all but the frame number. That of a result may be newer: results overtake such changes."""
        known = self.state.index >= 0 and state.length == self.state.length
        self.show_state(replace(state, index=self.state.index) if known else state)

    def _show_mode(self) -> None:
        state, actions = self.state, self._actions
        several = state.length is None or state.length > 1
        word = "Pause" if state.playing else "Play"
        actions.play.setIcon(icon(word.lower()))
        actions.play.setText(f"&{word}\tSpace")
        actions.play.setToolTip(f"{word} (Space)")
        actions.play.setEnabled(several)
        for control in (actions.previous, actions.next, actions.first, actions.loop, actions.go_to, self.position):
            control.setEnabled(state.seekable and several)
        actions.loop.setChecked(state.loop)

    def _go_to(self) -> None:
        self.position.setFocus(Qt.FocusReason.ShortcutFocusReason)
        self.position.selectAll()


class _NameButton(QPushButton):
    """A caption and a name, elided at its start, since its end tells paths apart. It keeps its width."""

    WIDTH = 184

    def __init__(self, caption: str) -> None:
        super().__init__()
        self._caption = caption
        self.setFixedWidth(self.WIDTH)
        self.setFlat(True)
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)

    def show_name(self, name: str, tip: str) -> None:
        live = "live:" if name.startswith("live:") else ""  # it stays: the rest is the name of a recording
        caption = f"{self._caption}: {live}"
        room = self.WIDTH - 28 - self.fontMetrics().horizontalAdvance(caption)
        elided = self.fontMetrics().elidedText(name.removeprefix(live), Qt.TextElideMode.ElideLeft, room)
        self.setText(_literal(caption + elided))
        self.setToolTip(tip)


class ModeBar(QWidget):
    """The modes, the search, and the names of source and preset, each always in its place."""

    def __init__(self, actions: Actions, preset_menu: QMenu, search: QWidget) -> None:
        super().__init__()
        self.source, self.preset = _NameButton("Source"), _NameButton("Preset")
        self.source.clicked.connect(actions.open_source.trigger)
        self.preset.setMenu(preset_menu)
        modes = [action_button(actions.by_name()[mode.value], "mode", with_text=True) for mode in Mode]
        names = 16, self.source, self.preset
        hbox(*modes, 16, (search, 1), *names, within=self, margins=(8, 4, 8, 4), spacing=4)
        self.show_source(None)

    def show_source(self, info: SourceInfo | None) -> None:
        name = details = "none"
        if info is not None:
            cameras = " + ".join(f"{camera.model} {camera.serial}".strip() for camera in info.rig.cameras)
            length = "" if info.length is None else f"{counted(info.length, 'frame')}, "
            name, details = info.name, f"{info.name}\n{length}{cameras}"
        self.source.show_name(name, f"Source of the frames; click to open another one (Ctrl+O)\n{details}")

    def show_preset(self, title: str, path: Path | None) -> None:
        self.preset.show_name(title, f"The preset being tuned\n{path or 'not saved to a file yet'}")


def fill_on_opening(menu: QMenu, entries: Callable[[], list[str]], choose: Callable[[str], None]) -> None:
    """Give a menu these entries each time it opens, and what choosing one does."""

    def fill() -> None:
        menu.clear()
        for name in entries():
            menu.addAction(_literal(name), lambda _=False, name=name: choose(name))
        if menu.isEmpty():
            menu.addAction("None yet").setEnabled(False)  # type: ignore[union-attr]

    menu.aboutToShow.connect(fill)


def _literal(text: str) -> str:
    """Double each &, which Qt would otherwise use as a mnemonic mark."""
    return text.replace("&", "&&")
