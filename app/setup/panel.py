"""The controls of the mode *Set up*: what a rig needs before it is tuned, each with its state and its button."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

from PyQt6.QtGui import QAction, QPalette
from PyQt6.QtWidgets import QLabel, QWidget

from ...core.errors import counted
from ...core.preset import Preset
from ...widgets.basics.controls import NoteLabel, text_button
from ...widgets.basics.layouts import STRETCH, hbox, vbox
from ...widgets.basics.theme import text_font
from ..context import Context
from ..worker.results import SourceInfo


@dataclass(frozen=True)
class Task:
    """One thing to do: its title, what is said of its state, and the names of the actions that do it."""

    title: str
    state: Callable[[SourceInfo | None, Preset], str]
    actions: tuple[str, ...]


def _source(info: SourceInfo | None, _: Preset) -> str:
    if info is None:
        return "None open"
    length = "live" if info.length is None else counted(info.length, "frame")
    return f"{info.name}, {length}"


def _untouched(_: SourceInfo | None, preset: Preset) -> str:
    record = preset.untouched
    return "Not captured" if record is None else f"Captured, mean of {counted(record.frames, 'frame')}"


def _alignment(_: SourceInfo | None, preset: Preset) -> str:
    record = preset.alignment.calibration
    if record is None:
        return "Not calibrated"
    return f"Calibrated {record.date:%Y-%m-%d}, expected error {record.quality.alignment_px:.2f} px"


def _noise(_: SourceInfo | None, preset: Preset) -> str:
    noise = preset.noise
    return "Not measured" if noise is None else f"Measured, bias {1e3 * noise.bias_m:.1f} mm"


TASKS: Final = (
    Task("Cameras or recording", _source, ("open_source", "cameras", "camera_settings")),
    Task("Untouched frame", _untouched, ("capture_untouched",)),
    Task("Alignment", _alignment, ("calibrate", "check_drift")),
    Task("Noise and bias", _noise, ("measure_noise",)),
)


class SetUpPanel(QWidget):
    """Lists the tasks in their order. It starts windows by the main window's own actions."""

    def __init__(self, context: Context, actions: Mapping[str, QAction]) -> None:
        super().__init__()
        self._context = context
        self._info: SourceInfo | None = None
        self.states: list[QLabel] = []
        vbox(*(self._make_task(task, actions) for task in TASKS), STRETCH, within=self, margins=8, spacing=16)
        self.setAccessibleName("Set up")
        context.worker.opened.connect(self._opened)
        context.document.presetChanged.connect(lambda _: self._show())
        self._show()

    def _make_task(self, task: Task, actions: Mapping[str, QAction]) -> QWidget:
        title, state = QLabel(task.title), NoteLabel()
        title.setFont(text_font("body", bold=True))
        state.setForegroundRole(QPalette.ColorRole.PlaceholderText)
        self.states.append(state)
        made = QWidget()
        buttons = [text_button(actions[name]) for name in task.actions]
        vbox(title, state, hbox(*buttons, STRETCH), within=made, margins=0, spacing=4)
        return made

    def _opened(self, info: SourceInfo) -> None:
        self._info = info
        self._show()

    def _show(self) -> None:
        preset = self._context.document.preset
        for task, label in zip(TASKS, self.states, strict=True):
            label.setText(task.state(self._info, preset))
