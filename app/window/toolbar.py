"""The toolbar: source, playback controls, preset and export. Menus with changing entries are filled on opening."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from PyQt6.QtCore import QSignalBlocker, Qt, pyqtSignal
from PyQt6.QtGui import QKeyEvent
from PyQt6.QtWidgets import (
    QAbstractSpinBox,
    QMenu,
    QPushButton,
    QSizePolicy,
    QSlider,
    QSpinBox,
    QToolBar,
    QToolButton,
    QWidget,
)

from ...widgets.basics.controls import action_button
from ...widgets.basics.icons import icon
from ...widgets.basics.layouts import hbox
from ..worker.playback import PlaybackState
from .actions import Actions, Menus


class FrameNumber(QSpinBox):
    """The frame on the screen, from 1. Enter goes to the number that is typed; Esc brings back the one on the screen.

    Signals
    -------
    sought(index: int)
    """

    sought = pyqtSignal(int)

    def __init__(self) -> None:
        super().__init__()
        self._index, self._length = 0, 1  # type: int, int | None
        self.setAccessibleName("Frame number")
        self.setToolTip("Frame, from 1 (files and commands count from 0). Type a number to go to it")
        self.setPrefix("frame ")
        self.setButtonSymbols(QAbstractSpinBox.ButtonSymbols.NoButtons)  # Previous and Next stand beside it
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)  # not by the wheel: while it has the focus it stands still
        self.setKeyboardTracking(False)  # a number counts once it is finished
        self._show()
        self.valueChanged.connect(lambda number: self.sought.emit(number - 1))

    def show_frame(self, index: int, length: int | None) -> None:
        """Show a frame; what a person types stays until it is finished."""
        known = length == self._length
        self._index, self._length = index, length
        if not (known and self.hasFocus()):
            self._show()

    def keyPressEvent(self, event: QKeyEvent | None) -> None:
        """Leave with Enter or Esc, and follow the frames again."""
        key = event.key() if event is not None else 0
        if key == Qt.Key.Key_Escape:
            self._show()
        elif key in (Qt.Key.Key_Return, Qt.Key.Key_Enter):
            before = self.value()
            self.interpretText()
            if self.value() == before:  # that of a frame shown before, perhaps: others came since
                self.sought.emit(before - 1)
        else:
            super().keyPressEvent(event)
            return
        self.clearFocus()

    def _show(self) -> None:
        with QSignalBlocker(self):
            self.setRange(1, self._length or 99_999_999)
            self.setSuffix(f" of {self._length}" if self._length is not None else "")
            self.setValue(self._index + 1)


class Transport(QWidget):
    """Playback buttons and the frame slider.

    Signals
    -------
    seekRequested(index: int)
    held(bool)
        The slider is held down; playback waits.
    """

    seekRequested = pyqtSignal(int)
    held = pyqtSignal(bool)

    def __init__(self, actions: Actions) -> None:
        super().__init__()
        self._actions = actions
        self._state = PlaybackState(length=1)
        self.slider = QSlider(Qt.Orientation.Horizontal)
        self.slider.setAccessibleName("Frame")
        self.slider.setToolTip("Frame of the recording: drag or click to seek")
        self.slider.setMinimumWidth(90)
        self.slider.valueChanged.connect(self.seekRequested)
        self.slider.sliderPressed.connect(lambda: self.held.emit(True))
        self.slider.sliderReleased.connect(lambda: self.held.emit(False))
        self.position = FrameNumber()
        self.position.sought.connect(self.seekRequested)
        actions.go_to.triggered.connect(self._go_to)
        buttons = map(action_button, (actions.previous, actions.play, actions.next, actions.loop, actions.freeze))
        hbox(*buttons, 4, (self.slider, 1), 4, self.position, within=self, margins=0, spacing=4)
        self._show_mode()

    @property
    def state(self) -> PlaybackState:
        return self._state

    def show_state(self, state: PlaybackState) -> None:
        """Show a state of playback; the slider does not move while it is dragged."""
        changed = replace(state, index=0) != replace(self._state, index=0)
        self._state = state
        if changed:
            self._show_mode()
        self.position.show_frame(state.index, state.length)
        if state.length is None:
            return
        last = max(0, state.length - 1)
        if not self.slider.isSliderDown():
            with QSignalBlocker(self.slider):
                self.slider.setRange(0, last)
                self.slider.setValue(max(0, state.index))

    def show_change(self, state: PlaybackState) -> None:
        """Show a change of all but the frame number. That of a result may be newer: results overtake such changes."""
        known = self._state.index >= 0 and state.length == self._state.length
        self.show_state(replace(state, index=self._state.index) if known else state)

    def _show_mode(self) -> None:
        """Enable what is possible now; everything but the frame number."""
        state, actions = self._state, self._actions
        several = state.length is None or state.length > 1
        word = "Pause" if state.running else "Play"
        actions.play.setEnabled(several)
        actions.play.setIcon(icon(word.lower()))
        actions.play.setText(f"&{word}\tSpace")
        actions.play.setToolTip(f"{word} (Space)")
        for action in (actions.previous, actions.next, actions.first, actions.loop, actions.go_to):
            action.setEnabled(state.seekable and several)
        actions.freeze.setEnabled(several)
        actions.freeze.setChecked(state.frozen)
        actions.loop.setChecked(state.loop)
        for part in (self.slider, self.position):
            part.setEnabled(state.seekable and several)

    def _go_to(self) -> None:
        self.position.setFocus(Qt.FocusReason.ShortcutFocusReason)
        self.position.selectAll()


_MAX_NAME_LENGTH = 28


class ToolBar(QToolBar):
    """The row of buttons below the menu bar."""

    def __init__(self, actions: Actions, menus: Menus, transport: Transport) -> None:
        super().__init__("Main")
        self.setObjectName("toolbar")
        self.setMovable(False)
        self.setContextMenuPolicy(Qt.ContextMenuPolicy.PreventContextMenu)
        self._menus = menus
        self.source = _WholeButton()
        self.source.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.source.clicked.connect(actions.open_source.trigger)
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
        """Give Qt's button for hidden actions an icon that follows the theme, and a name."""
        extension = self.findChild(QToolButton, "qt_toolbar_ext_button")
        assert extension is not None
        extension.setIcon(icon("chevron-double-right"))
        extension.setToolTip("More actions")
        extension.setAccessibleName("More actions")

    def show_source(self, name: str) -> None:
        self.source.setText(f"Source: {_literal(_shortened(name))}")
        self.source.setToolTip(f"Source of the frames; click to open another one (Ctrl+O)\n{name}")

    def show_preset(self, title: str, path: Path | None) -> None:
        self.preset.setText(f"Preset: {_literal(_shortened(title))}")
        self.preset.setToolTip(f"The preset being tuned\n{path or 'not saved to a file yet'}")

    def fill_menus(
        self,
        *,
        shipped: Callable[[], list[str]],
        new: Callable[[str], None],
        recent_presets: Callable[[], list[str]],
        open_preset: Callable[[str], None],
    ) -> None:
        """Set the entries of the menus that are filled on opening, and what choosing one does."""
        menus = self._menus
        for menu, entries, choose in (
            (menus.shipped_presets, shipped, new),
            (menus.recent_presets, recent_presets, open_preset),
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


class _WholeButton(QPushButton):
    """Is never narrower than its text: the style sheet's ``min-width`` of buttons would let the toolbar cut it."""


def _menu_button(menu: QMenu, tip: str) -> QPushButton:
    button = _WholeButton()
    button.setMenu(menu)
    button.setToolTip(tip)
    button.setFocusPolicy(Qt.FocusPolicy.TabFocus)
    return button


def _shortened(text: str) -> str:
    """Shorten a long text to its end, which distinguishes one path from another."""
    return text if len(text) <= _MAX_NAME_LENGTH else f"…{text[1 - _MAX_NAME_LENGTH :]}"


def _literal(text: str) -> str:
    """Double each &, which Qt would otherwise use as a mnemonic mark."""
    return text.replace("&", "&&")
