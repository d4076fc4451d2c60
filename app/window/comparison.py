"""Comparing two presets: the panel beside the views, the keys, and the wipe."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Any, Final

from PyQt6.QtCore import QObject, Qt, pyqtSignal
from PyQt6.QtWidgets import (
    QButtonGroup,
    QComboBox,
    QGridLayout,
    QLabel,
    QSizePolicy,
    QWidget,
)

from ...core.errors import TactuneError
from ...core.preset import Preset
from ...core.preset.file import shipped_presets
from ...core.sources.presets import load_preset
from ...widgets.basics.controls import AccentButton, caption, push_button, wrapped_label
from ...widgets.basics.layouts import hbox, vbox
from ...widgets.basics.messages import Severity
from ...widgets.basics.record_table import Column, RecordTable
from ..context import TASK, Context
from ..document.comparison import PRESENT, Side, Sides, differing_fields, take_over
from ..document.document import field_title, shown_value
from ..worker.results import ComparedFrame
from .actions import Actions
from .files import PRESET_FILTER
from .frame_presenter import FramePresenter

#: A side on offer: its name, and what makes it the chosen one.
Offer = tuple[str, Callable[[], None]]

#: Share of the width by which a key moves the wipe.
STEP: Final = 0.05
#: Interval between updates of the numbers while frames play, in seconds.
INTERVAL_S: Final = 0.2
#: Number of newest steps of the history that are offered.
_MAX_STEPS: Final = 40


class Shown(StrEnum):
    """What the views show of a comparison."""

    WIPE = "wipe"
    A = "A"
    B = "B"


_NEXT: Final = {Shown.WIPE: Shown.A, Shown.A: Shown.B, Shown.B: Shown.WIPE}
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
    "Time": "Time of the contact test on this frame; a cached step counts as when it was last computed",
    "Not in the other": "Area that only this preset finds",
    "IoU of the patches": "Intersection over union of both patches: 1 if they cover the same pixels",
}
#: How records are called in the table.
_RECORDS: Final[dict[str, Callable[[Any], str]]] = {
    "rig": lambda rig: f"{rig.proximity.model} + {rig.tactile.model}",
    "untouched": lambda record: str(record.sha256[:8]),
    "noise": lambda noise: f"bias {1e3 * noise.bias_m:.1f} mm",
}


class SideBox(QComboBox):
    """Chooses one side. Its entries are made when it opens: answer the signal ``opening()`` with `offer`."""

    opening = pyqtSignal()

    def __init__(self, letter: str) -> None:
        super().__init__()
        self.setAccessibleName(f"Preset {letter}")
        self.setToolTip(f"Preset {letter}: the present one, the saved one, a step of the history, or another preset")
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self.setMaxVisibleItems(25)
        self.activated.connect(lambda index: self.itemData(index)())

    def offer(self, groups: Sequence[Sequence[Offer]], chosen: Side) -> None:
        """Set the entries, group by group. A chosen side that is not among them comes first."""
        if chosen.name not in {name for group in groups for name, _ in group}:
            groups = [[(chosen.name, lambda: None)], *groups]
        self.clear()
        for group in groups:
            if self.count() and group:
                self.insertSeparator(self.count())
            for name, choose in group:
                self.addItem(name, choose)
        self.setCurrentIndex(self.findText(chosen.name))

    def showPopup(self) -> None:
        self.opening.emit()
        super().showPopup()


class ComparisonPanel(QWidget):
    """Shows which presets are compared, how they are shown, their numbers, and the fields in which they differ."""

    modeChosen = pyqtSignal(object)  # Shown
    swapRequested = pyqtSignal()
    useRequested = pyqtSignal(int)  # take over side A (0) or B (1)
    closeRequested = pyqtSignal()

    def __init__(self) -> None:
        super().__init__()
        self.boxes = SideBox("A"), SideBox("B")
        self.use = push_button("Use A", ""), push_button("Use B", "")
        self.modes = {mode: AccentButton(mode.value.capitalize(), _MODE_TIPS[mode]) for mode in Shown}
        self.numbers: dict[tuple[str, int], QLabel] = {}
        self.heading = QLabel()
        self.problem = wrapped_label()
        self.problem.setTextFormat(Qt.TextFormat.PlainText)
        self.problem.hide()
        self.table = RecordTable(
            _COLUMNS, "Fields in which the presets differ", "The value of each in A and B", key=lambda row: row[0]
        )
        self.table.setMinimumHeight(80)
        self.swap = push_button("Swap", "Exchange A and B")
        self.close_button = push_button("Close", "End the comparison (Esc)")
        self.swap.clicked.connect(self.swapRequested)
        self.close_button.clicked.connect(self.closeRequested)
        group = QButtonGroup(self)
        for mode, button in self.modes.items():
            button.setFocusPolicy(Qt.FocusPolicy.TabFocus)
            button.clicked.connect(lambda _, mode=mode: self.modeChosen.emit(mode))
            group.addButton(button)
        vbox(
            hbox((QLabel("<b>Compare presets</b>"), 1), self.swap, self.close_button),
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

    def _side_rows(self) -> QGridLayout:
        grid = QGridLayout()
        grid.setColumnStretch(1, 1)
        for index, (box, use, letter) in enumerate(zip(self.boxes, self.use, "AB", strict=True)):
            grid.addWidget(caption(letter, box), index, 0)
            grid.addWidget(box, index, 1)
            grid.addWidget(use, index, 2)
            use.clicked.connect(lambda _, index=index: self.useRequested.emit(index))
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

    def show_sides(self, sides: Sides) -> None:
        for button, side, letter in zip(self.use, sides, "AB", strict=True):
            button.setEnabled(not side.follows)
            button.setToolTip(
                f"Take over the values of {letter} ({side.name}) as one step that can be undone. "
                "Name, notes, rig and untouched frame stay."
            )
        presets = sides[0].preset, sides[1].preset
        paths = differing_fields(*presets)
        self.heading.setText(f"Fields that differ: {len(paths)}" if paths else "No field differs")
        self.table.set_records([(path, *presets) for path in paths])

    def show_frame(self, compared: ComparedFrame) -> None:
        """Show the numbers of a frame."""
        overlap = compared.overlap
        alone = (None, None) if overlap is None else (overlap.only_a_mm2, overlap.only_b_mm2)
        agreement = "–" if overlap is None else f"{overlap.iou:.3f}"
        for column, (side, area_mm2) in enumerate(zip((compared.a, compared.b), alone, strict=True)):
            texts = {"Not in the other": _square_cm(area_mm2), "IoU of the patches": agreement}
            if side.patch is not None:
                texts["Area"] = _square_cm(side.area_mm2)
                texts["Points"] = f"{len(side.patch.points):,}"
                texts["Time"] = f"{side.ms:.1f} ms"
            for name in [*_NUMBERS][1:]:
                self.numbers[name, column].setText(texts.get(name, "–"))
        sides = (("A", compared.a), ("B", compared.b))
        self.problem.setText("\n".join(f"{letter}: {side.problem}" for letter, side in sides if side.problem))
        self.problem.setVisible(bool(self.problem.text()))


def _value(path: str, preset: Preset) -> str:
    """Return a value as the panel of parameters shows it."""
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


def _square_cm(area_mm2: float | None) -> str:
    return "–" if area_mm2 is None else f"{area_mm2 / 100:.2f} cm²"


class ComparisonControl(QObject):
    """Connects `Context.comparison` with the worker, the views, the panel and the actions."""

    runningChanged = pyqtSignal(bool)

    def __init__(self, context: Context, actions: Actions, panel: ComparisonPanel, presenter: FramePresenter) -> None:
        super().__init__(context)
        self._context, self._document, self._comparison = context, context.document, context.comparison
        self._actions, self._panel, self._presenter = actions, panel, presenter
        self._mode = Shown.WIPE
        self._share = 0.5
        self._running = False
        self._last: Sides | None = None
        self._numbers_s = 0.0
        self._comparison.changed.connect(self._changed)
        context.frameShown.connect(self._show_numbers)
        panel.modeChosen.connect(self.show_mode)
        panel.swapRequested.connect(self._swap)
        panel.useRequested.connect(self._use)
        panel.closeRequested.connect(self._comparison.end)
        for index, box in enumerate(panel.boxes):
            box.opening.connect(partial(self._offer, index))
        actions.changes_since_save.triggered.connect(self.show_changes)
        actions.compare.triggered.connect(lambda wanted: self._start() if wanted else self._comparison.end())
        actions.next_side.triggered.connect(lambda: self.show_mode(_NEXT[self._mode]))
        actions.wipe_left.triggered.connect(lambda: self.move_wipe(self.share - STEP))
        actions.wipe_right.triggered.connect(lambda: self.move_wipe(self.share + STEP))
        self._enable(False)

    @property
    def share(self) -> float:
        """Share of the width that shows A."""
        return {Shown.A: 1.0, Shown.B: 0.0}.get(self._mode, self._share)

    def show_changes(self) -> None:
        self._comparison.show(self._comparison.saved, self._comparison.present)

    def move_wipe(self, share: float) -> None:
        """Put the wipe at a share of the width, 0 to 1."""
        self._share = min(max(share, 0.0), 1.0)
        self.show_mode(Shown.WIPE)

    def show_mode(self, mode: Shown) -> None:
        self._mode = mode
        self._panel.modes[mode].setChecked(True)
        self._presenter.set_wipe_share(self.share)

    def _enable(self, running: bool) -> None:
        actions = self._actions
        for action in (actions.next_side, actions.wipe_left, actions.wipe_right):
            action.setEnabled(running)
        actions.compare.setChecked(running)

    def _start(self) -> None:
        """Compare the same sides as last time; at first the saved preset with the present one."""
        if self._last is None:
            self.show_changes()
        else:
            self._comparison.show(*map(self._comparison.up_to_date, self._last))

    def _changed(self, sides: Sides | None) -> None:
        self._context.worker.set_compared(sides)
        if sides is not None:
            self._last = sides
            self._panel.show_sides(sides)
            for index in (0, 1):
                if self._panel.boxes[index].currentText() != sides[index].name:
                    self._offer(index)
        if (sides is not None) == self._running:
            return
        self._running = sides is not None
        self._enable(self._running)
        if self._running:
            self._share = 0.5
            self.show_mode(Shown.WIPE)
        self.runningChanged.emit(self._running)

    def _show_numbers(self) -> None:
        result = self._context.result
        if result is None or result.compared is None:
            return
        now = time.perf_counter()
        if not result.playback.playing or now - self._numbers_s >= INTERVAL_S:
            self._numbers_s = now
            self._panel.show_frame(result.compared)

    def _swap(self) -> None:
        if self._comparison.sides is not None:
            a, b = self._comparison.sides
            self._comparison.show(b, a)

    def _use(self, index: int) -> None:
        sides = self._comparison.sides
        if sides is not None and take_over(self._document, sides[index]):
            self._comparison.end()

    def _offer(self, index: int) -> None:
        """Fill the list of one side."""
        sides, comparison = self._comparison.sides, self._comparison
        if sides is None:
            return
        own: list[Offer] = [
            (PRESENT, lambda: self._choose(index, comparison.present)),
            (comparison.saved.name, lambda: self._choose(index, comparison.saved)),
        ]
        history = [
            Side(f"Step {number}: {text}" if number else "Step 0: as opened", preset)
            for number, (text, preset) in enumerate(self._document.history())
        ]
        steps = [(side.name, partial(self._choose, index, side)) for side in reversed(history[-_MAX_STEPS:])]
        others = [
            *((f"Shipped: {name}", partial(self._load, index, f"Shipped: {name}", name)) for name in shipped_presets()),
            ("File…", partial(self._ask_file, index)),
        ]
        self._panel.boxes[index].offer([own, steps if len(history) > 1 else [], others], sides[index])

    def _choose(self, index: int, side: Side) -> None:
        if self._comparison.sides is not None:
            a, b = self._comparison.sides
            self._comparison.show(*((a, side) if index else (side, b)))
            self._offer(index)

    def _load(self, index: int, name: str, place: Path | str) -> None:
        try:
            self._choose(index, Side(name, load_preset(place)))
        except TactuneError as error:
            self._context.messages.show_message("comparison", Severity.ERROR, str(error), subject=TASK)
            self._offer(index)

    def _ask_file(self, index: int) -> None:
        self._offer(index)
        self._context.dialogs.open_file(
            "preset", "Compare with a preset", PRESET_FILTER, lambda path: self._load(index, path.name, path)
        )
