"""The numbers of one strain measurement, beside the solver's where they are known, or what to do next."""

from __future__ import annotations

from PyQt6.QtCore import Qt
from PyQt6.QtWidgets import QGridLayout, QLabel, QSizePolicy, QWidget

from ...core.model.arrays import Float64Array
from ...core.strain.field import AxisStrain
from ..rig.parts import make_verdict
from .strain_map import LENGTH_RGB, WIDTH_RGB, largest_pair
from .strain_work import StrainView

_TITLES = ("", "Largest", "Where", "Solver, seen", "Solver, all")
_TIPS = (
    "",
    "Largest strain between neighbouring dots, with its standard deviation",
    "Middle between both dots, in pixels of the tactile colour image; marked in the map",
    "The simulator's own largest strain between neighbours of which the tactile camera sees both dots whole",
    "The simulator's own largest strain between all neighbours; hidden dots cannot be measured",
)
_NOTHING = "–"


class StrainNumbers(QWidget):
    """A verdict in words, and a line each for length and width."""

    def __init__(self) -> None:
        super().__init__()
        self.verdict = QLabel("")
        make_verdict(self.verdict)
        self.verdict.setWordWrap(True)
        self.cells = [[QLabel(_NOTHING) for _ in _TITLES] for _ in range(2)]
        layout = QGridLayout(self)
        layout.setContentsMargins(6, 2, 2, 2)
        layout.setHorizontalSpacing(14)
        layout.addWidget(self.verdict, 0, 0, 1, len(_TITLES) + 1)
        for column, (title, tip) in enumerate(zip(_TITLES, _TIPS, strict=True)):
            head = QLabel(title)
            head.setForegroundRole(head.palette().ColorRole.PlaceholderText)
            head.setToolTip(tip)
            layout.addWidget(head, 1, column)
            for row, name, rgb in ((0, "length", LENGTH_RGB), (1, "width", WIDTH_RGB)):
                label = self.cells[row][column]
                label.setToolTip(tip)
                label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
                if column == 0:
                    label.setTextFormat(Qt.TextFormat.RichText)
                    label.setText(f'<span style="color: rgb{rgb}">■</span> along the {name}')
                layout.addWidget(label, 2 + row, column)
        layout.setColumnStretch(len(_TITLES), 1)
        self.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Maximum)

    def show_view(self, view: StrainView) -> None:
        """Show a measurement, or why there is none and what to do next."""
        measured = view.measured
        self.verdict.setText(_verdict(view))
        for row, name in enumerate(("length", "width")):
            texts = [_NOTHING] * 4
            if measured is not None:
                axis: AxisStrain = getattr(measured, name)
                texts[:2] = [
                    f"{100 * axis.largest:.1f} ± {100 * axis.largest_sigma:.1f} %",
                    _where(axis, measured.pixels),
                ]
            if view.truth is not None:
                seen, every = getattr(view.truth, f"{name}_seen"), getattr(view.truth, name)
                texts[2:] = [f"{100 * seen:.1f} %", f"{100 * every:.1f} %"]
            for label, text in zip(self.cells[row][1:], texts, strict=True):
                label.setText(text)


def _verdict(view: StrainView) -> str:
    measured = view.measured
    if measured is None:
        return view.problem[:1].upper() + view.problem[1:] + "."
    largest = 100 * max(measured.length.largest, measured.width.largest)
    words = f"Largest in-plane strain {largest:.1f} %"
    if view.displacement_mm is not None:
        words += f" at {view.displacement_mm:.1f} mm displacement"
    return f"{words} ({measured.dots} dots)"


def _where(axis: AxisStrain, pixels: Float64Array) -> str:
    u, v = largest_pair(axis, pixels).mean(axis=0)
    return f"({u:.0f}, {v:.0f}) px"
