"""Comparing two presets: the panel beside the views, the keys, and the wipe."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from PyQt6.QtCore import Qt, pyqtSignal
from PyQt6.QtWidgets import QButtonGroup, QComboBox, QGridLayout, QLabel, QSizePolicy, QWidget

from ...core.preset import Preset
from ...core.preset.file import shipped_presets
from ...core.sources.presets import load_preset
from ...widgets.basics.controls import NoteLabel, caption, choice_button, heading, named, push_button
from ...widgets.basics.layouts import hbox, vbox
from ...widgets.basics.record_table import Column, RecordTable
from ..context import TASK, Context
from ..document.comparison import PRESENT, Side, Sides, differing_fields, take_over
from ..document.document import field_title, shown_value
from ..worker.results import Pace
from .actions import Actions
from .files import PRESET_FILTER
from .frame_presenter import FramePresenter
from .status import INTERVAL_S

#: Share of the width by which a key moves the wipe.
STEP: Final = 0.05
#: Number of frames from which times are compared.
LEAST_TIMED: Final = 5


class Shown(StrEnum):
    """What the views show of a comparison."""

    WIPE = "wipe"
    A = "A"
    B = "B"


_NEXT: Final = {Shown.A: Shown.B, Shown.B: Shown.WIPE, Shown.WIPE: Shown.A}
_MODE_TIPS: Final = {
    Shown.WIPE: "A left and B right of a line that you drag (Alt + Left and Alt + Right move it)",
    Shown.A: "Show only A (C changes between A, B and the wipe)",
    Shown.B: "Show only B (C changes between A, B and the wipe)",
}
#: The rows of numbers, under a row with the letters.
_NUMBERS: Final = {
    "": "",
    "Area": "Area of the patch, projected along the optical axis",
    "Points": "Points of the patch",
    "Time": "Median time of the contact test on recent frames, while they play; ≈ where no difference shows",
}
#: How records are called in the table.
_RECORDS: Final[dict[str, Callable[[Any], str]]] = {
    "rig": lambda rig: " + ".join(camera.model for camera in rig.cameras),
    "untouched": lambda record: str(record.sha256[:8]),
    "noise": lambda noise: f"bias {1e3 * noise.bias_m:.1f} mm",
}


def _value(path: str, preset: Preset) -> str:
    value = preset.value(path)
    if path in _RECORDS:
        return "none" if value is None else _RECORDS[path](value)
    return shown_value(path, value)


#: A row is the path of a field and both presets.
_COLUMNS: Final = (
    Column("Field", lambda row: field_title(row[0]), "Field of the preset", hint=lambda row: row[0], stretch=True),
    Column("A", lambda row: _value(row[0], row[1]), "Its value in A", sample="0 to 0.0000"),
    Column("B", lambda row: _value(row[0], row[2]), "Its value in B", sample="0 to 0.0000"),
)


class ComparisonPanel(QWidget):
    """Shows and chooses which presets are compared, how they are shown, their numbers, and the fields that differ."""

    runningChanged = pyqtSignal(bool)

    def __init__(self, context: Context, actions: Actions, presenter: FramePresenter) -> None:
        super().__init__()
        self._context, self._comparison = context, context.comparison
        self._actions, self._presenter = actions, presenter
        self._mode = Shown.WIPE
        self._share = 0.5
        self._pace = Pace(INTERVAL_S)
        self.boxes = self._side_box(0), self._side_box(1)
        self.use = push_button("Use A", ""), push_button("Use B", "")
        self.modes = {mode: choice_button(mode.value.capitalize(), _MODE_TIPS[mode]) for mode in Shown}
        self.numbers: dict[tuple[str, int], QLabel] = {}
        self.heading = QLabel()
        self.problem = NoteLabel()
        self.problem.hide()
        self.table = RecordTable(
            _COLUMNS, "Fields in which the presets differ", "The value of each in A and B", key=lambda row: row[0]
        )
        self.table.setMinimumHeight(6 * (self.fontMetrics().height() + 8))  # five rows
        self.close_button = push_button("Close", "End the comparison (Esc)")
        self.close_button.clicked.connect(self._comparison.end)
        group = QButtonGroup(self)
        for mode, button in self.modes.items():
            button.setFocusPolicy(Qt.FocusPolicy.TabFocus)
            button.clicked.connect(lambda _, mode=mode: self.show_mode(mode))
            group.addButton(button)
        vbox(
            hbox((heading("Compare presets"), 1), self.close_button),
            self._side_rows(),
            hbox(*self.modes.values(), spacing=4),
            self._number_rows(),
            self.problem,
            self.heading,
            (self.table, 1),
            within=self,
            margins=4,
            spacing=4,
        )
        self.setAccessibleName("Comparison of two presets")
        self.setMinimumWidth(340)
        self.hide()
        self._comparison.changed.connect(self._changed)
        context.frameShown.connect(self._show_numbers)
        compared = self._comparison
        actions.compare.triggered.connect(
            lambda wanted: compared.show(compared.saved, compared.present) if wanted else compared.end()
        )
        actions.next_side.triggered.connect(lambda: self.show_mode(_NEXT[self._mode]))
        actions.wipe_left.triggered.connect(lambda: self.move_wipe(self.share - STEP))
        actions.wipe_right.triggered.connect(lambda: self.move_wipe(self.share + STEP))
        self._enable(False)

    def _side_box(self, index: int) -> QComboBox:
        name = f"Preset {'AB'[index]}"
        box = named(QComboBox(), name, f"{name}: the present one, the saved one, a shipped one or a file")
        box.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        box.setMaxVisibleItems(25)
        box.activated.connect(lambda row: self._choose(index, box.itemData(row)))
        return box

    def _side_rows(self) -> QGridLayout:
        grid = QGridLayout()
        grid.setColumnStretch(1, 1)
        for index, (box, use) in enumerate(zip(self.boxes, self.use, strict=True)):
            grid.addWidget(caption("AB"[index], box), index, 0)
            grid.addWidget(box, index, 1)
            grid.addWidget(use, index, 2)
            use.clicked.connect(lambda _, index=index: self._use(index))
        return grid

    def _number_rows(self) -> QGridLayout:
        grid = QGridLayout()
        grid.setVerticalSpacing(0)
        grid.setColumnStretch(0, 1)
        for row, (name, tip) in enumerate(_NUMBERS.items()):
            title = QLabel(name)
            title.setToolTip(tip)
            grid.addWidget(title, row, 0)
            for column in (0, 1):
                label = self.numbers[name, column] = QLabel("AB"[column] if not row else "")
                label.setAlignment(Qt.AlignmentFlag.AlignRight)
                label.setMinimumWidth(90)
                label.setAccessibleName(f"{name} of {'AB'[column]}")
                grid.addWidget(label, row, 1 + column)
        return grid

    @property
    def share(self) -> float:
        return {Shown.A: 1.0, Shown.B: 0.0}.get(self._mode, self._share)

    def move_wipe(self, share: float) -> None:
        self._share = min(max(share, 0.0), 1.0)
        self.show_mode(Shown.WIPE)

    def show_mode(self, mode: Shown) -> None:
        self._mode = mode
        self.modes[mode].setChecked(True)
        self._presenter.set_wipe_share(self.share)

    def _enable(self, running: bool) -> None:
        for action in (self._actions.next_side, self._actions.wipe_left, self._actions.wipe_right):
            action.setEnabled(running)
        self._actions.compare.setChecked(running)

    def _changed(self, sides: Sides | None) -> None:
        self._context.worker.set_compared(sides)
        if sides is not None:
            self._show_sides(sides)
        running = sides is not None
        if running != self._actions.next_side.isEnabled():
            self._enable(running)
            if running:
                self.move_wipe(0.5)
            self.setVisible(running)
            self.runningChanged.emit(running)

    def _show_sides(self, sides: Sides) -> None:
        for box, button, side, letter in zip(self.boxes, self.use, sides, "AB", strict=True):
            if box.currentText() != side.name:
                self._offer(box, side)
            button.setEnabled(not side.follows)
            button.setToolTip(
                f"Take over the values of {letter} ({side.name}) as one step that can be undone. "
                "Name, notes, rig and untouched frame stay."
            )
        presets = sides[0].preset, sides[1].preset
        paths = differing_fields(*presets)
        self.heading.setText(f"Fields that differ: {len(paths)}" if paths else "No field differs")
        self.table.set_records([(path, *presets) for path in paths])

    def _show_numbers(self) -> None:
        result = self._context.result
        if result is None or result.compared is None or not self._pace.due(result):
            return
        sides = (result.compared.a, result.compared.b)
        times = compared_times(*(side.times_ms for side in sides))
        for column, side in enumerate(sides):
            texts = {"Time": times[column]}
            if side.patch is not None:
                texts["Area"] = f"{side.area_mm2:,.0f} mm²"
                texts["Points"] = f"{len(side.patch.points):,}"
            for name in [*_NUMBERS][1:]:
                self.numbers[name, column].setText(texts.get(name, "–"))
        problems = [f"{letter}: {side.problem}" for letter, side in zip("AB", sides, strict=True) if side.problem]
        self.problem.setText("\n".join(problems))
        self.problem.setVisible(bool(problems))

    def _use(self, index: int) -> None:
        sides = self._comparison.sides
        if sides is not None and take_over(self._context.document, sides[index]):
            self._comparison.end()

    def _offer(self, box: QComboBox, chosen: Side) -> None:
        """Fill the list of one side; each entry's data makes the side, or is None to ask for a file."""
        entries: dict[str, Callable[[], Side] | None] = {
            chosen.name: lambda: chosen,
            PRESENT: lambda: self._comparison.present,
            self._comparison.saved.name: lambda: self._comparison.saved,
        }
        for name in shipped_presets():
            entries[f"Shipped: {name}"] = partial(_load, f"Shipped: {name}", name)
        entries["File…"] = None
        box.clear()
        for name, make in entries.items():
            box.addItem(name, make)
        box.setCurrentIndex(box.findText(chosen.name))

    def _choose(self, index: int, make: Callable[[], Side] | None) -> None:
        sides = self._comparison.sides
        if sides is None:
            return
        self._offer(self.boxes[index], sides[index])  # until the choice has succeeded
        if make is None:
            self._context.dialogs.open_file(
                "preset",
                "Compare with a preset",
                PRESET_FILTER,
                lambda path: self._choose(index, partial(_load, path.name, path)),
            )
            return
        with self._context.messages.telling("comparison", TASK):
            side = make()
            self._comparison.show(*((sides[0], side) if index else (side, sides[1])))


def compared_times(a_ms: Sequence[float], b_ms: Sequence[float]) -> tuple[str, str]:
    """Return the median times of two presets, marked ≈ where the middle halves of their times overlap."""
    if min(len(a_ms), len(b_ms)) < LEAST_TIMED:
        return "–", "–"
    (a_low, a, a_high), (b_low, b, b_high) = (np.percentile(ms, (25, 50, 75)) for ms in (a_ms, b_ms))
    if a_low <= b_high and b_low <= a_high:
        return f"≈ {a:.1f} ms", f"≈ {b:.1f} ms"
    return f"{a:.1f} ms", f"{b:.1f} ms"


def _load(name: str, place: Path | str) -> Side:
    return Side(name, load_preset(place))
