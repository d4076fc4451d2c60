"""The playback controls: previous, play, next, loop, freeze, and the frame slider."""

from __future__ import annotations

from dataclasses import replace

from PyQt6.QtCore import QSignalBlocker, Qt, pyqtSignal
from PyQt6.QtWidgets import QHBoxLayout, QLabel, QToolButton, QWidget

from ...widgets.parameters.number_slider import JumpSlider
from ..worker.playback import PlaybackState
from .actions import Actions
from .icons import icon


class Transport(QWidget):
    """Shows where playback stands and says where the person wants it.

    Signals
    -------
    seekRequested(index: int)
    held(bool)
        The slider is held down: playback waits meanwhile.
    """

    seekRequested = pyqtSignal(int)
    held = pyqtSignal(bool)

    def __init__(self, actions: Actions, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._actions = actions
        self._state = PlaybackState(length=1)
        self.slider = JumpSlider()
        self.slider.setAccessibleName("Frame")
        self.slider.setToolTip("Frame of the recording: drag or click to seek")
        self.slider.setMinimumWidth(90)
        self.slider.valueChanged.connect(self.seekRequested)
        self.slider.sliderPressed.connect(lambda: self.held.emit(True))
        self.slider.sliderReleased.connect(lambda: self.held.emit(False))
        self._frame = QLabel()
        self._frame.setToolTip("Frame shown / number of frames (files, their names and commands count from 0)")
        self._frame.setMinimumWidth(self._frame.fontMetrics().horizontalAdvance("000 / 000"))
        layout = QHBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(2)
        for action in (actions.previous, actions.play, actions.next, actions.loop, actions.freeze):
            button = QToolButton()
            button.setDefaultAction(action)
            button.setAutoRaise(True)
            button.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonIconOnly)
            button.setFocusPolicy(Qt.FocusPolicy.TabFocus)
            layout.addWidget(button)
        layout.addSpacing(4)
        layout.addWidget(self.slider, 1)
        layout.addSpacing(4)
        layout.addWidget(self._frame)
        self._show_mode()

    @property
    def state(self) -> PlaybackState:
        """What is shown now."""
        return self._state

    def show_state(self, state: PlaybackState) -> None:
        """Show a state of playback; the slider stays put while the person drags it."""
        changed = replace(state, index=0) != replace(self._state, index=0)
        self._state = state
        if changed:
            self._show_mode()
        if state.length is None:
            self._frame.setText(f"{state.index + 1}" if state.index >= 0 else "")
            return
        last = max(0, state.length - 1)
        self._frame.setText(f"{max(0, state.index) + 1} / {last + 1}")
        if not self.slider.isSliderDown():
            with QSignalBlocker(self.slider):
                self.slider.setRange(0, last)
                self.slider.setValue(max(0, state.index))

    def _show_mode(self) -> None:
        """Show what can be done now; everything but the frame number."""
        state, actions = self._state, self._actions
        several = state.length is None or state.length > 1
        word = "Pause" if state.running else "Play"
        actions.play.setEnabled(several)
        actions.play.setIcon(icon(word.lower()))
        actions.play.setText(f"&{word}\tSpace")
        actions.play.setToolTip(f"{word} (Space)")
        for action in (actions.previous, actions.next, actions.first, actions.loop):
            action.setEnabled(state.seekable and several)
        actions.freeze.setEnabled(several)
        actions.freeze.setChecked(state.frozen)
        actions.loop.setChecked(state.loop)
        self.slider.setEnabled(state.seekable and several)
