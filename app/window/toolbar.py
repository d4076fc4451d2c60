"""The toolbar: source, playback controls, preset and export."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
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
from .actions import Actions


class FrameNumber(QSpinBox):
    """The frame on the screen, from 1. Enter goes to the typed number; Esc brings back the one on the screen."""

    def __init__(self) -> None:
        super().__init__()
        self.setAccessibleName("Frame number")
        self.setToolTip("Frame, from 1 (files and commands count from 0). Type a number to go to it")
        self.setPrefix("frame ")
        self.setButtonSymbols(QAbstractSpinBox.ButtonSymbols.NoButtons)  # Previous and Next stand beside it
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)  # not by the wheel: while it has the focus it stands still
        self.setKeyboardTracking(False)
        self.setRange(1, 99_999_999)
        self.editingFinished.connect(self.clearFocus)

    def show_frame(self, index: int, length: int | None) -> None:
        """Show a frame; what a person types stays until it is finished."""
        if not self.hasFocus():
            with QSignalBlocker(self):
                self.setMaximum(length or 99_999_999)
                self.setSuffix(f" of {length}" if length is not None else "")
                self.setValue(index + 1)

    def keyPressEvent(self, event: QKeyEvent | None) -> None:
        if event is not None and event.key() == Qt.Key.Key_Escape:
            self.setValue(self.value())  # replaces the typed text
            self.clearFocus()
        else:
            super().keyPressEvent(event)


class Transport(QWidget):
    """Playback buttons and the frame slider."""

    seekRequested = pyqtSignal(int)
    held = pyqtSignal(bool)  # the slider is held down; playback waits

    def __init__(self, actions: Actions) -> None:
        super().__init__()
        self._actions = actions
        self.state = PlaybackState(length=1)
        self.slider = QSlider(Qt.Orientation.Horizontal)
        self.slider.setAccessibleName("Frame")
        self.slider.setToolTip("Frame of the recording: drag or click to seek")
        self.slider.setMinimumWidth(90)
        self.slider.valueChanged.connect(self.seekRequested)
        self.slider.sliderPressed.connect(lambda: self.held.emit(True))
        self.slider.sliderReleased.connect(lambda: self.held.emit(False))
        self.position = FrameNumber()
        self.position.valueChanged.connect(lambda number: self.seekRequested.emit(number - 1))
        actions.go_to.triggered.connect(self._go_to)
        buttons = map(action_button, (actions.previous, actions.play, actions.next, actions.loop))
        hbox(*buttons, 4, (self.slider, 1), 4, self.position, within=self, margins=0, spacing=4)
        self._show_mode()

    def show_state(self, state: PlaybackState) -> None:
        """Show a state of playback; the slider does not move while it is dragged."""
        changed = replace(state, index=0) != replace(self.state, index=0)
        self.state = state
        if changed:
            self._show_mode()
        self.position.show_frame(state.index, state.length)
        if state.length is not None and not self.slider.isSliderDown():
            with QSignalBlocker(self.slider):
                self.slider.setRange(0, max(0, state.length - 1))
                self.slider.setValue(max(0, state.index))

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
        seeking = (actions.previous, actions.next, actions.first, actions.loop, actions.go_to)
        for control in (*seeking, self.slider, self.position):
            control.setEnabled(state.seekable and several)
        actions.loop.setChecked(state.loop)

    def _go_to(self) -> None:
        self.position.setFocus(Qt.FocusReason.ShortcutFocusReason)
        self.position.selectAll()


_MAX_NAME_LENGTH = 28


class _WholeButton(QPushButton):
    """Is never narrower than its text: the style sheet's ``min-width`` of buttons would let the toolbar cut it."""

    def __init__(self) -> None:
        super().__init__()
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)


class ToolBar(QToolBar):
    """The row of buttons below the menu bar."""

    def __init__(self, actions: Actions, preset_menu: QMenu, transport: Transport) -> None:
        super().__init__("Main")
        self.setObjectName("toolbar")
        self.setMovable(False)
        self.setContextMenuPolicy(Qt.ContextMenuPolicy.PreventContextMenu)
        self.source, self.preset = _WholeButton(), _WholeButton()
        self.source.clicked.connect(actions.open_source.trigger)
        self.preset.setMenu(preset_menu)
        self.addWidget(self.source)
        self.addSeparator()
        self.addWidget(transport)
        transport.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Preferred)
        self.addSeparator()
        self.addWidget(self.preset)
        for action in (actions.record, actions.calibrate, actions.export):
            button = QToolButton()
            button.setDefaultAction(action)
            button.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextBesideIcon)
            self.addWidget(button)
        extension = self.findChild(QToolButton, "qt_toolbar_ext_button")  # Qt's own, without name and theme
        assert extension is not None
        extension.setIcon(icon("chevron-double-right"))
        extension.setToolTip("More actions")
        extension.setAccessibleName("More actions")
        self.show_source("none")

    def show_source(self, name: str) -> None:
        self.source.setText(f"Source: {_literal(_shortened(name))}")
        self.source.setToolTip(f"Source of the frames; click to open another one (Ctrl+O)\n{name}")

    def show_preset(self, title: str, path: Path | None) -> None:
        self.preset.setText(f"Preset: {_literal(_shortened(title))}")
        self.preset.setToolTip(f"The preset being tuned\n{path or 'not saved to a file yet'}")


def fill_on_opening(menu: QMenu, entries: Callable[[], list[str]], choose: Callable[[str], None]) -> None:
    """Give a menu these entries each time it opens, and what choosing one does."""

    def fill() -> None:
        menu.clear()
        for name in entries():
            menu.addAction(_literal(name), lambda _=False, name=name: choose(name))
        if menu.isEmpty():
            menu.addAction("None yet").setEnabled(False)  # type: ignore[union-attr]

    menu.aboutToShow.connect(fill)


def _shortened(text: str) -> str:
    """Shorten a long text to its end, which distinguishes one path from another."""
    return text if len(text) <= _MAX_NAME_LENGTH else f"…{text[1 - _MAX_NAME_LENGTH :]}"


def _literal(text: str) -> str:
    """Double each &, which Qt would otherwise use as a mnemonic mark."""
    return text.replace("&", "&&")
