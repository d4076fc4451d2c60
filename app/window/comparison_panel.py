"""The panel of a comparison: which presets, how they are shown, their numbers, and the fields in which they differ."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import StrEnum
from typing import Any, Final

from PyQt6.QtCore import Qt, pyqtSignal
from PyQt6.QtWidgets import (
    QAbstractItemView,
    QButtonGroup,
    QComboBox,
    QGridLayout,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QSizePolicy,
    QTableWidget,
    QTableWidgetItem,
    QWidget,
)

from ...core.errors import minus
from ...core.preset import Preset
from ...widgets.basics.controls import AccentButton, caption, push_button, read_only_table, wrapped_label
from ...widgets.basics.fields import FieldSpec, field_spec, format_number
from ...widgets.basics.layouts import vbox
from ..document.comparison import Side, Sides, differing_fields
from ..document.document import field_title, format_value
from ..worker.results import ComparedFrame, ComparedSide

#: A side on offer: its name, and what makes it the chosen one.
Offer = tuple[str, Callable[[], None]]


class Shown(StrEnum):
    """What the views show of a comparison."""

    WIPE = "wipe"
    A = "A"
    B = "B"
    DIFFERENCE = "difference"


_MODE_TIPS: Final = {
    Shown.WIPE: "A left and B right of a line that you drag (Alt + Left and Alt + Right move it)",
    Shown.A: "Show only A (C changes between A, B and the wipe)",
    Shown.B: "Show only B (C changes between A, B and the wipe)",
    Shown.DIFFERENCE: "Colour the patch view by which preset finds contact: both, only A, or only B (D)",
}
_NUMBERS: Final = {
    "Area": "Area of the patch, projected along the optical axis",
    "Points": "Points of the patch",
    "Time": "Time of the contact test on this frame; a cached step counts as when it was last computed",
    "Not in the other": "Area that only this preset finds",
}


#: How records are called in the table.
_RECORDS: Final[dict[str, Callable[[Any], str]]] = {
    "rig": lambda rig: f"{rig.proximity.model} + {rig.tactile.model}",
    "untouched": lambda record: str(record.sha256[:8]),
    "noise": lambda noise: f"bias {1e3 * noise.bias_m:.1f} mm",
}
#: Width of a column of values, in pixels.
_VALUE_WIDTH: Final = 84


class SideBox(QComboBox):
    """Chooses one side; its entries are made when it opens.

    Signals
    -------
    opening()
        Answer with `offer`.
    """

    opening = pyqtSignal()

    def __init__(self, letter: str) -> None:
        super().__init__()
        self._offers: list[Offer] = []
        self.setAccessibleName(f"Preset {letter}")
        self.setToolTip(f"Preset {letter}: the present one, the saved one, a step of the history, or another preset")
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
        self.setMaxVisibleItems(25)
        self.activated.connect(lambda index: self._offers[index][1]())

    def offer(self, groups: Sequence[Sequence[Offer]], chosen: Side) -> None:
        """Set the entries, group by group. A chosen side that is not among them comes first."""
        known = {name for group in groups for name, _ in group}
        if chosen.name not in known:
            groups = [[(chosen.name, lambda: None)], *groups]
        self.clear()
        self._offers = []
        for group in groups:
            if self._offers and group:
                self.insertSeparator(self.count())
                self._offers.append(("", lambda: None))
            for name, choose in group:
                self.addItem(name)
                self._offers.append((name, choose))
        self.setCurrentIndex(self.findText(chosen.name))

    def showPopup(self) -> None:
        """Make the entries and open the list."""
        self.opening.emit()
        super().showPopup()


class ComparisonPanel(QWidget):
    """Shows a comparison beside the views.

    Signals
    -------
    modeChosen(Shown)
    swapRequested()
    useRequested(index: int)
        Take over side A (0) or B (1).
    closeRequested()
    """

    modeChosen = pyqtSignal(object)
    swapRequested = pyqtSignal()
    useRequested = pyqtSignal(int)
    closeRequested = pyqtSignal()

    def __init__(self) -> None:
        super().__init__()
        self.boxes = SideBox("A"), SideBox("B")
        self.use = tuple(
            push_button(f"Use {letter}", f"Take over the values of {letter} as one step that can be undone")
            for letter in "AB"
        )
        self.modes = {mode: self._mode_button(mode) for mode in Shown}
        self.numbers: dict[tuple[str, int], QLabel] = {}
        self.agreement = QLabel()
        self.heading = QLabel()
        self.problem = wrapped_label()
        self.problem.setTextFormat(Qt.TextFormat.PlainText)
        self.problem.hide()
        self.table = self._make_table()
        vbox(
            self._title_row(),
            self._side_rows(),
            self._mode_row(),
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

    def show_sides(self, sides: Sides) -> None:
        """Show which presets are compared and in which fields they differ."""
        for button, side, letter in zip(self.use, sides, "AB", strict=True):
            button.setEnabled(not side.follows)
            button.setToolTip(
                f"{letter} is the present preset already"
                if side.follows
                else f"Take over the values of {letter} ({side.name}) as one step that can be undone. "
                "Name, notes, rig and untouched frame stay."
            )
        presets = sides[0].preset, sides[1].preset
        paths = differing_fields(*presets)
        many = "" if len(paths) == 1 else "s"
        self.heading.setText(f"{len(paths)} field{many} differ{'' if many else 's'}" if paths else "No field differs")
        self.table.setRowCount(len(paths))
        for row, path in enumerate(paths):
            self._fill_row(row, path, presets)

    def show_mode(self, mode: Shown) -> None:
        """Show what the views show."""
        self.modes[mode].setChecked(True)

    def show_frame(self, compared: ComparedFrame) -> None:
        """Show the numbers of a frame."""
        overlap = compared.overlap
        alone = (None, None) if overlap is None else (overlap.only_a_mm2, overlap.only_b_mm2)
        for column, (side, area_mm2) in enumerate(zip((compared.a, compared.b), alone, strict=True)):
            for name, text in zip(_NUMBERS, (*_numbers_of(side), _square_cm(area_mm2)), strict=True):
                self.numbers[name, column].setText(text)
                self.numbers[name, column].setToolTip(side.problem or _NUMBERS[name])
        self.agreement.setText("–" if overlap is None else f"{overlap.iou:.3f}")
        sides = (("A", compared.a), ("B", compared.b))
        problems = [f"{letter}: {side.problem}" for letter, side in sides if side.problem]
        self.problem.setText("\n".join(problems))
        self.problem.setVisible(bool(problems))

    # Building

    def _mode_button(self, mode: Shown) -> AccentButton:
        button = AccentButton(mode.value.capitalize(), _MODE_TIPS[mode])
        button.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        button.clicked.connect(lambda: self.modeChosen.emit(mode))
        return button

    def _title_row(self) -> QHBoxLayout:
        row = QHBoxLayout()
        title = QLabel("<b>Compare presets</b>")
        self.swap = push_button("Swap", "Exchange A and B")
        self.swap.clicked.connect(self.swapRequested)
        self.close_button = push_button("Close", "End the comparison (Esc)")
        self.close_button.clicked.connect(self.closeRequested)
        row.addWidget(title, 1)
        row.addWidget(self.swap)
        row.addWidget(self.close_button)
        return row

    def _side_rows(self) -> QGridLayout:
        grid = QGridLayout()
        grid.setColumnStretch(1, 1)
        for index, (box, use, letter) in enumerate(zip(self.boxes, self.use, "AB", strict=True)):
            grid.addWidget(caption(letter, box), index, 0)
            grid.addWidget(box, index, 1)
            grid.addWidget(use, index, 2)
            use.clicked.connect(lambda _, index=index: self.useRequested.emit(index))
        return grid

    def _mode_row(self) -> QHBoxLayout:
        row = QHBoxLayout()
        row.setSpacing(4)
        group = QButtonGroup(self)
        for button in self.modes.values():
            group.addButton(button)
            row.addWidget(button)
        return row

    def _number_rows(self) -> QGridLayout:
        grid = QGridLayout()
        grid.setVerticalSpacing(0)
        for column in (1, 2):
            grid.setColumnStretch(column, 1)
            grid.addWidget(_right_aligned(QLabel("AB"[column - 1])), 0, column)
        for row, (name, tip) in enumerate(_NUMBERS.items(), start=1):
            title = QLabel(name)
            title.setToolTip(tip)
            grid.addWidget(title, row, 0)
            for column in (0, 1):
                label = self.numbers[name, column] = _right_aligned(QLabel("–"))
                label.setAccessibleName(f"{name} of {'AB'[column]}")
                grid.addWidget(label, row, 1 + column)
        last = len(_NUMBERS) + 1
        title = QLabel("IoU of the patches")
        for label in (title, self.agreement):
            label.setToolTip("Intersection over union of both patches: 1 if they cover the same pixels")
        grid.addWidget(title, last, 0)
        grid.addWidget(_right_aligned(self.agreement), last, 2)
        return grid

    def _make_table(self) -> QTableWidget:
        table = QTableWidget(0, 3)
        table.setHorizontalHeaderLabels(["Field", "A", "B"])
        columns, _ = read_only_table(
            table, "Fields in which the presets differ", "Fields in which the presets differ, with the value of each"
        )
        table.setSizeAdjustPolicy(QAbstractItemView.SizeAdjustPolicy.AdjustToContents)
        table.setMinimumHeight(80)
        columns.setSectionResizeMode(0, QHeaderView.ResizeMode.Stretch)
        for column in (1, 2):
            table.setColumnWidth(column, _VALUE_WIDTH)
        return table

    def _fill_row(self, row: int, path: str, presets: tuple[Preset, Preset]) -> None:
        spec = _spec_of(path)
        unit = spec.suffix.strip() if spec is not None else ""
        title = field_title(path) + (f" ({unit})" if unit else "")
        values = [preset.value(path) for preset in presets]
        for column, text in enumerate((title, *(_in_words(path, spec, value) for value in values))):
            item = QTableWidgetItem(text)
            whole = text if path in _RECORDS else str(values[column - 1])
            item.setToolTip(whole if column else f"{path}\n{spec.description if spec else ''}".strip())
            self.table.setItem(row, column, item)


def _numbers_of(side: ComparedSide) -> tuple[str, str, str]:
    """Return area, points and time of a side."""
    if side.patch is None:
        return "–", "–", "–"
    return _square_cm(side.area_mm2), f"{len(side.patch.points):,}", f"{side.ms:.1f} ms"


def _square_cm(area_mm2: float | None) -> str:
    return "–" if area_mm2 is None else f"{area_mm2 / 100:.2f} cm²"


def _right_aligned(label: QLabel) -> QLabel:
    label.setAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
    return label


def _spec_of(path: str) -> FieldSpec | None:
    """Return how widgets show a field; None for one that no widget shows, such as the notes."""
    try:
        return field_spec(Preset, path)
    except TypeError:
        return None


def _in_words(path: str, spec: FieldSpec | None, value: Any) -> str:
    """Return a value as the panel of parameters shows it, without its unit."""
    if path in _RECORDS:
        return "none" if value is None else _RECORDS[path](value)
    if spec is not None and spec.kind in ("number", "range"):
        numbers = value if isinstance(value, tuple) else (value,)
        return " to ".join(minus(format_number(number * spec.factor)) for number in numbers)
    return format_value(value)
