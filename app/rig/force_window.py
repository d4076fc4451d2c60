"""Measures the inflation from presses whose force a person reads off a scale, into the preset."""

from __future__ import annotations

from PyQt6.QtGui import QValidator
from PyQt6.QtWidgets import QDialog, QDoubleSpinBox

from ...core.errors import CalibrationError, as_sentence
from ...core.rig.inflation import Inflation, Press, fit_inflation
from ...widgets.basics.controls import NoteLabel, caption, push_button, wrapped_label
from ...widgets.basics.layouts import STRETCH, hbox, vbox
from ...widgets.basics.record_table import Column, RecordTable
from ..context import Context

_PROMPT = (
    "Press an object in the centre of the membrane against a scale, and hold still. Type what the scale reads; it was "
    "at zero before. One firm press is enough; more show how well the forces agree."
)
_COLUMNS = (
    Column("Frame", lambda press: press.frame, "Number of the frame", decimals=0, stretch=True),
    Column("Force, N", lambda press: press.force_n, "What the scale reads, newtons", decimals=2, stretch=True),
    Column(
        "Force / inflation, mm²",
        lambda press: press.area_mm2,
        "Force that the contact test finds, as a multiple of the inflation",
        decimals=0,
        sample="1,000,000",
    ),
    Column(
        "±", lambda press: press.area_sigma_mm2, "Its standard deviation, square millimetres", decimals=0, stretch=True
    ),
)
#: Standard gravity, m/s^2: kitchen scales read grams.
_GRAVITY = 9.80665


class NewtonField(QDoubleSpinBox):
    """A force in newtons; a comma is a point, where Qt takes it for a separator of thousands."""

    def __init__(self) -> None:
        super().__init__()
        self.setRange(0.0, 10_000.0)
        self.setDecimals(3)
        self.setSuffix(" N")
        self.setToolTip(f"Force that the scale reads now, newtons; 100 g are {0.1 * _GRAVITY:.3f} N")

    def validate(self, text: str | None, at: int) -> tuple[QValidator.State, str, int]:
        return super().validate((text or "").replace(",", "."), at)


class ForceWindow(QDialog):
    """A table of frames and forces, the pressure that fits them, and the button that puts it into the preset.

    It stays open beside the main window, where the frames are played. Presses of another source or another untouched
    frame are dropped.
    """

    def __init__(self, context: Context) -> None:
        super().__init__(context.window)
        self.setWindowTitle("Calibrate force")
        self._context = context
        self._presses: list[Press] = []
        self.found: Inflation | None = None
        self.force = NewtonField()
        self.add = push_button("&Add press", "Add the frame on the screen with this force (Ctrl+Return)", "Ctrl+Return")
        self.remove = push_button("&Remove", "Remove the selected presses (Del)")
        self.table = RecordTable(_COLUMNS, "Presses", "Presses with their forces", key=lambda press: press.frame)
        self.verdict, self.note = wrapped_label(verdict=True, selectable=True), NoteLabel(lines=2)
        self.apply = push_button("A&pply", "Put the inflation into the preset; Edit > Undo takes it back")
        leave = push_button("&Close", "Close this window (Esc)")
        typed = hbox(caption("&Force", self.force), self.force, self.add, STRETCH, self.remove)
        row = hbox(STRETCH, self.apply, leave)
        vbox(wrapped_label(_PROMPT), typed, self.note, (self.table, 1), self.verdict, row, within=self)
        self.resize(560, 480)
        self.add.clicked.connect(self._add)
        self.remove.clicked.connect(self._remove)
        self.table.deleteRequested.connect(self._remove)
        self.apply.clicked.connect(self._apply)
        leave.clicked.connect(self.close)
        context.worker.opened.connect(lambda _: self._drop("another source was opened"))
        self._untouched = context.document.preset.untouched
        context.document.presetChanged.connect(self._preset_changed)
        self._show([])

    def _add(self) -> None:
        result = self._context.result
        self.force.interpretText()
        try:
            if result is None or result.patch is None:
                raise CalibrationError("there is no patch yet; open a source first")
            press = Press.of(result.patch, result.frame_number, self.force.value())
        except CalibrationError as error:
            self.note.say(as_sentence(str(error)), error=True)
            return
        self.note.say("")
        self._show([each for each in self._presses if each.frame != press.frame] + [press])

    def _remove(self) -> None:
        chosen = self.table.selected_keys()
        self._show([press for press in self._presses if press.frame not in chosen])

    def _apply(self) -> None:
        assert self.found is not None
        self._context.document.edit_many(self.found.changes, title="Calibrate force")
        self.note.say("Applied. Save the preset to keep it.")

    def _preset_changed(self) -> None:
        untouched = self._context.document.preset.untouched
        if untouched != self._untouched:
            self._untouched = untouched
            self._drop("the untouched frame is another one")

    def _drop(self, why: str) -> None:
        if self._presses:
            self.note.say(f"The presses were removed, because {why}.")
        self._show([])

    def _show(self, presses: list[Press]) -> None:
        self._presses, self.found = presses, None
        self.table.set_records(presses)
        sentence = ""
        if presses:
            try:
                self.found = fit_inflation(presses)
                sentence = self.found.sentence
            except CalibrationError as error:
                sentence = str(error)
        self.verdict.setText(as_sentence(sentence) if sentence else "")
        self.apply.setEnabled(self.found is not None)
        self.remove.setEnabled(bool(presses))
