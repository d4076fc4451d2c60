"""The panel for the paint's colours and the clean-up."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final, cast

from PyQt6.QtCore import pyqtSignal
from PyQt6.QtWidgets import QCheckBox, QGridLayout, QHBoxLayout, QLabel, QVBoxLayout

from ...core.model.arrays import Uint8Array
from ...core.preset import MaskSection
from ...core.scan.paint import PaintSettings
from ...widgets.basics.accent_button import AccentButton
from ...widgets.basics.collapsible import CollapsibleSection
from ...widgets.images.eyedropper import HsvRanges, Mode, new_ranges
from ...widgets.parameters.fields import FieldSpec, field_spec
from ...widgets.parameters.gestures import new_gesture
from ...widgets.parameters.hsv_colors import groove_colors
from ...widgets.parameters.parameter_row import ParameterRow
from ...widgets.parameters.range_row import RangeEditor

_CHANNELS: Final = ("hue", "saturation", "value")
_USUAL: Final = PaintSettings()
_MEANINGS: Final = {
    "hue": "Hue range of the paint that was touched, OpenCV convention 0-179; a low end above the high end wraps "
    "around through red.",
    "saturation": "Saturation range of the paint that was touched, 0 grey to 255 pure.",
    "value": "Brightness range of the paint that was touched, 0 black to 255 brightest.",
}
_LEAST = FieldSpec(
    path="least_area_mm2",
    title="Least area",
    description="Smaller spots of paint are dropped, and smaller holes are filled.",
    kind="number",
    default=_USUAL.least_area_mm2,
    unit="mm2",
    suffix=" mm²",
    maximum=100_000.0,
    slider=(0.0, 500.0),
    step=1.0,
)
_LARGEST = FieldSpec(
    path="largest",
    title="Spots kept",
    description="How many spots are kept, the largest first; 0 keeps all.",
    kind="number",
    default=_USUAL.largest,
    maximum=1000.0,
    slider=(0.0, 20.0),
    integer=True,
)
_DROPPERS: Final[dict[Mode, tuple[str, str]]] = {
    "set": ("&Pick", "Click the touched paint on the scan: its colour becomes the range (again to put away)"),
    "expand": ("+", "Click touched paint that is missed: the range grows to hold it"),
    "shrink": ("−", "Click what is no touched paint: the range shrinks to leave it out"),
}


class PaintPanel(CollapsibleSection):
    """Colour range with eyedroppers, clean-up, and what comes of it.

    Signals
    -------
    edited(paint: PaintSettings, gesture: int)
    highlightChanged(on: bool)
    eyedropperChanged(mode: str)
        "set", "expand", "shrink" or "off".
    """

    edited = pyqtSignal(object, int)
    highlightChanged = pyqtSignal(bool)
    eyedropperChanged = pyqtSignal(str)

    def __init__(self) -> None:
        super().__init__("Paint")
        self._paint = PaintSettings()
        specs = [
            replace(field_spec(MaskSection, name), description=_MEANINGS[name], default=getattr(_USUAL, name))
            for name in _CHANNELS
        ]
        self.rows = {spec.path: ParameterRow(spec, self) for spec in (*specs, _LEAST, _LARGEST)}
        self.droppers = {mode: AccentButton(text, tip) for mode, (text, tip) in _DROPPERS.items()}
        self.highlight = QCheckBox("&Highlight contact")
        self.highlight.setChecked(True)
        self.highlight.setToolTip("Show what counts as contact in its own colour; off: the paint as it is")
        self.readout = QLabel()
        self.readout.setWordWrap(True)
        self._lay_out()
        for row in self.rows.values():
            row.edited.connect(self._row_edited)
        for mode, button in self.droppers.items():
            button.clicked.connect(lambda checked, mode=mode: self._take_up(mode if checked else "off"))
        self.highlight.toggled.connect(self.highlightChanged)
        self.show_paint(self._paint)

    def _lay_out(self) -> None:
        tools = QHBoxLayout()
        tools.addWidget(QLabel("Eyedropper"))
        for button in self.droppers.values():
            button.setMaximumWidth(64)
            tools.addWidget(button)
        tools.addStretch(1)
        tools.addWidget(self.highlight)
        grid = QGridLayout()
        grid.setHorizontalSpacing(6)
        grid.setVerticalSpacing(3)
        grid.setColumnStretch(1, 1)
        for row in self.rows.values():
            row.add_to(grid)
        layout = QVBoxLayout(self.body)
        layout.setContentsMargins(6, 4, 6, 6)
        layout.addWidget(self.readout)
        layout.addLayout(tools)
        layout.addLayout(grid)

    @property
    def eyedropper(self) -> str:
        """Which eyedropper is in hand, or "off"."""
        return next((mode for mode, button in self.droppers.items() if button.isChecked()), "off")

    def show_paint(self, paint: PaintSettings) -> None:
        """Show settings without emitting."""
        self._paint = paint
        for name, row in self.rows.items():
            row.show_value(getattr(paint, name))
        for name, colors in groove_colors(paint.hue, paint.saturation, paint.value).items():
            cast(RangeEditor, self.rows[name].widget).set_colors(colors)

    def show_readout(self, vertices: int, area_mm2: float, total: int) -> None:
        """Say how much is in contact."""
        share = f"{vertices:,} of {total:,} vertices, {area_mm2:,.0f} mm² along the surface"
        none = "No vertex has this colour: take the eyedropper and click the touched paint on the scan."
        self.readout.setText(share if vertices else none)

    def show_text(self, text: str) -> None:
        """Say something else where the readout stands."""
        self.readout.setText(text)

    def put_away(self) -> None:
        """Put the eyedropper away."""
        self._take_up("off")

    def pick(self, rgb: Uint8Array) -> None:
        """Change the ranges by colours around a click, uint8 (K, 3); raises `EyedropperError` where none are left."""
        paint = self._paint
        present = HsvRanges(paint.hue, paint.saturation, paint.value)
        ranges = new_ranges(rgb[None], present, cast(Mode, self.eyedropper))
        changed = replace(paint, hue=ranges.hue, saturation=ranges.saturation, value=ranges.value)
        self.edited.emit(changed, new_gesture())

    def _take_up(self, mode: str) -> None:
        for name, button in self.droppers.items():
            button.setChecked(name == mode)
        self.eyedropperChanged.emit(mode)

    def _row_edited(self, name: str, value: Any, gesture: int) -> None:
        self.edited.emit(replace(self._paint, **{name: value}), gesture)
