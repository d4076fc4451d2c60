"""The three modes of the window, in the order of work: the controls of each at the right, and its next step."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum

from PyQt6.QtCore import Qt, pyqtSignal
from PyQt6.QtGui import QAction, QActionGroup
from PyQt6.QtWidgets import QApplication, QStackedWidget, QToolButton, QWidget

from ...widgets.basics.controls import NoteLabel, action_button, heading, push_button
from ...widgets.basics.layouts import STRETCH, hbox, holding, vbox
from ..context import Context
from ..worker.results import SourceInfo
from .actions import Actions
from .publishing import PublishPanel
from .recording import RecordingBar
from .status import FrameDetails

#: Width of the controls, pixels: it is the same in every mode.
COLUMN_PX = 364


class Mode(StrEnum):
    """A mode, by the name of its action."""

    SET_UP = "set_up"
    TUNE = "tune"
    RUN = "run"


class RunPanel(QWidget):
    """The controls of *Record and run*."""

    def __init__(
        self,
        context: Context,
        actions: Actions,
        recording: RecordingBar,
        publishing: PublishPanel,
        details: FrameDetails,
    ) -> None:
        super().__init__()
        folder = hbox(action_button(actions.recordings_folder, with_text=True), STRETCH)
        self._live = holding(vbox(heading("Record"), folder, recording, 8, margins=0))
        self.play_live = push_button(
            "Play as &live", "Play this source as if cameras sent it, to try recording and a robot"
        )
        self.play_live.clicked.connect(lambda: context.sourceRequested.emit(f"live:{context.source_name}"))
        note = NoteLabel("To record, connect cameras, or play this source as if it were live.")
        self._no_live = holding(hbox((note, 1), self.play_live, margins=0))
        vbox(
            self._no_live,
            self._live,
            heading("Publish"),
            publishing,
            8,
            heading("Details"),
            details,
            STRETCH,
            within=self,
            margins=8,
        )
        self.setAccessibleName("Record and run")

    def show_source(self, info: SourceInfo) -> None:
        """Offer to record what is live; the next step of a recording is to export it."""
        self._live.setVisible(info.length is None)
        self._no_live.setVisible(info.length is not None)


class ModeColumn(QWidget):
    """Shows the next step and, below it, the controls of the mode."""

    modeChanged = pyqtSignal()

    def __init__(self, context: Context, actions: Actions, panels: Mapping[Mode, QWidget]) -> None:
        super().__init__()
        self._context, self._actions, self._panels = context, actions, panels
        self._info: SourceInfo | None = None
        self._sentence = NoteLabel(lines=2)
        self.button = QToolButton()
        self.button.setProperty("primary", True)
        self.button.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextOnly)
        self.button.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.stack = QStackedWidget()
        for panel in panels.values():
            self.stack.addWidget(panel)
        self._step = holding(hbox((self._sentence, 1), vbox(self.button, STRETCH), margins=(8, 4, 8, 4)))
        vbox(self._step, (self.stack, 1), within=self, margins=0, spacing=4)
        group = QActionGroup(self)
        for mode in Mode:
            action = self.action_of(mode)
            group.addAction(action)
            action.toggled.connect(lambda chosen, mode=mode: self._show_mode(mode) if chosen else None)
        document = context.document
        context.worker.opened.connect(self._opened)
        for changed in (document.presetChanged, document.fileChanged, actions.record.toggled):
            changed.connect(self._show_step)
        self._show_step()

    def action_of(self, mode: Mode) -> QAction:
        return self._actions.by_name()[mode.value]

    @property
    def mode(self) -> Mode:
        return next(mode for mode in Mode if self.action_of(mode).isChecked())

    def choose(self, name: str) -> None:
        """Show a mode by its name; an unknown one is the first."""
        self.action_of(Mode(name) if name in list(Mode) else Mode.SET_UP).setChecked(True)

    def _show_mode(self, mode: Mode) -> None:
        focus = QApplication.focusWidget()
        had_focus = focus is not None and self.stack.isAncestorOf(focus)
        self.stack.setCurrentWidget(self._panels[mode])
        if had_focus and (window := self.window()) is not None:  # else a heading would take the space bar, which plays
            window.setFocus()
        self._show_step()
        self.modeChanged.emit()

    def _opened(self, info: SourceInfo) -> None:
        self._info = info
        self._show_step()

    def _show_step(self) -> None:
        context = self._context
        recording = self._actions.record.isChecked()
        sentence, name = next_step(self.mode, self._info, context.document.dirty, recording)
        self._step.setVisible(self.mode is not Mode.SET_UP)  # its own panel names the next step
        self._sentence.setText(sentence)
        for shown in self.button.actions():
            self.button.removeAction(shown)
        self.button.setDefaultAction(self._actions.by_name()[name])


def next_step(mode: Mode, info: SourceInfo | None, dirty: bool, recording: bool) -> tuple[str, str]:
    """Return what to do next in a mode, in words, and the name of the action that does it."""
    live = info is not None and info.length is None
    steps = {
        Mode.TUNE: (
            (dirty, "Values were changed: save them in the preset.", "save"),
            (True, "Let the newest frames propose values for all sections.", "suggest_all"),
        ),
        Mode.RUN: (
            (recording, "Press the object, then press Stop.", "record"),
            (live, "Record every frame of the cameras.", "record"),
            (True, "Export patch, recording or animation; I and O mark a part.", "export"),
        ),
    }
    if info is None or mode is Mode.SET_UP:
        return "Open cameras, a recording or the simulator.", "open_source"
    return next((sentence, action) for wanted, sentence, action in steps[mode] if wanted)
