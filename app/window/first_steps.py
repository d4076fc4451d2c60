"""The card of the first start: five steps from a source to a saved preset, which tick themselves off."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from PyQt6.QtCore import QObject, Qt, pyqtSignal
from PyQt6.QtWidgets import QGridLayout, QLabel, QPushButton

from ...core.preset import Preset
from ...widgets.basics.controls import close_button
from ...widgets.basics.messages import Card
from ..context import Context
from ..worker.results import SourceInfo

#: What *Find contact…* is about.
_CONTACT_SECTIONS = ("contact_test", "tolerance", "membrane", "outliers")
_CLOSED, _DONE = "first_steps/closed", "first_steps/done"
#: Name, text of the button, and what the step is for.
_STEPS = (
    ("source", "&1  Open a source…", "Your cameras or a recording"),
    ("calibrate", "&2  Calibrate…", "Align both cameras on this sensor"),
    ("mask", "&3  Set the mask", "Remove the prints by their colour"),
    ("contact", "&4  Find contact…", "Suggest values of the contact test"),
    ("save", "&5  Save preset", "The file that a robot runs"),
)


class FirstStepsCard(Card):
    """A heading, five buttons with their ticks, and a cross.

    Signals
    -------
    pressed(step: str)
    closed()
        Esc or the cross was pressed.
    """

    pressed = pyqtSignal(str)

    def __init__(self) -> None:
        super().__init__()
        self.setAccessibleName("Getting started")
        self.buttons: dict[str, QPushButton] = {}
        self.ticks: dict[str, QLabel] = {}
        grid = QGridLayout(self)
        grid.setContentsMargins(8, 4, 4, 8)
        grid.setVerticalSpacing(4)
        grid.setSizeConstraint(QGridLayout.SizeConstraint.SetFixedSize)  # it covers no more of the views than it must
        grid.addWidget(QLabel("<b>Getting started</b>"), 0, 0, 1, 2)
        self.cross = close_button("Close getting started", "Close for good; Help > Getting started shows it again")
        self.cross.clicked.connect(self.closed)
        grid.addWidget(self.cross, 0, 2)
        for row, (name, text, what) in enumerate(_STEPS, start=1):
            tick = self.ticks[name] = QLabel()
            tick.setFixedWidth(16)
            button = self.buttons[name] = QPushButton(text)
            button.setAutoDefault(False)
            button.setFocusPolicy(Qt.FocusPolicy.TabFocus)
            button.setToolTip(what)
            button.clicked.connect(partial(self._press, name))
            grid.addWidget(tick, row, 0)
            grid.addWidget(button, row, 1, 1, 2)
        self.hide()

    def show_done(self, done: set[str]) -> None:
        """Tick these steps."""
        for name, text, _ in _STEPS:
            tick, ticked = self.ticks[name], name in done
            tick.setText("✓" if ticked else "")
            words = text.partition("  ")[2].rstrip("…")
            self.buttons[name].setAccessibleName(f"{words}: done" if ticked else words)

    def _press(self, name: str, _checked: bool) -> None:
        self.pressed.emit(name)


class FirstSteps(QObject):
    """Shows the card until it is closed for good, and ticks each step once it has truly happened.

    Parameters
    ----------
    context : Context
    card : FirstStepsCard
    acts : mapping of step to function
        What the buttons do.
    """

    def __init__(self, context: Context, card: FirstStepsCard, acts: Mapping[str, Callable[[], object]]) -> None:
        super().__init__(context)
        self._context, self._card, self._acts = context, card, acts
        self._done = {name for name in context.settings.text(_DONE).split(",") if name}
        self._first_source = ""
        self._preset, self._saved = context.document.preset, not context.document.dirty
        card.show_done(self._done)
        self._look()
        card.pressed.connect(lambda name: self._acts[name]())
        card.closed.connect(self._close)
        context.worker.opened.connect(self._opened)
        context.document.presetChanged.connect(self._look)
        context.document.fileChanged.connect(self._look)

    def offer(self) -> None:
        """Show the card over the first frame, unless it was closed for good."""
        if not self._context.settings.text(_CLOSED):
            self._context.frameShown.connect(self._show_first)

    def show(self) -> None:
        """Show the card again, with the focus on the first step that is not done."""
        self._context.settings.set(_CLOSED, "")
        self._card.show()
        todo = next((name for name, *_ in _STEPS if name not in self._done), "source")
        self._card.buttons[todo].setFocus(Qt.FocusReason.OtherFocusReason)

    def take_kept(self, section: str) -> None:
        """Note that suggestions keep the values of a section."""
        if section in _CONTACT_SECTIONS:
            self._tick("contact")

    def _show_first(self) -> None:
        self._context.frameShown.disconnect(self._show_first)
        self._card.show()

    def _close(self) -> None:
        self._context.settings.set(_CLOSED, "yes")
        self._card.hide()

    def _opened(self, info: SourceInfo) -> None:
        """A source counts if it is no simulator, or another one than that of the start."""
        self._first_source = self._first_source or info.name
        if not info.name.startswith("sim") or info.name != self._first_source:
            self._tick("source")

    def _look(self) -> None:
        """Tick what the preset shows to have happened."""
        document = self._context.document
        preset, saved = document.preset, document.path is not None and not document.dirty
        if preset is self._preset and saved and not self._saved:
            self._tick("save")
        self._preset, self._saved = preset, saved
        if preset.alignment.calibration is not None:
            self._tick("calibrate")
        if document.dirty and preset.mask.enabled and preset.mask != document.baseline.mask:
            self._tick("mask")
        if document.dirty and _contact(preset) != _contact(document.baseline):
            self._tick("contact")

    def _tick(self, name: str) -> None:
        if name not in self._done:
            self._done.add(name)
            self._context.settings.set(_DONE, ",".join(sorted(self._done)))
            self._card.show_done(self._done)


def _contact(preset: Preset) -> tuple[Any, ...]:
    return tuple(getattr(preset, name) for name in _CONTACT_SECTIONS)
