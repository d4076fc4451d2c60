"""One suggestion in the window: what it changes, why, and its picture or curve."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from PyQt6.QtCore import pyqtSignal
from PyQt6.QtGui import QFont, QPalette
from PyQt6.QtWidgets import QCheckBox, QComboBox, QFrame, QGridLayout, QLabel, QVBoxLayout, QWidget

from ...core.model.arrays import Uint8Array
from ...core.preset import Preset
from ...core.tuning.advice.examples import CURVES, ErrorCurve
from ...core.tuning.advice.proposal import MaskLabel, Proposal
from ...widgets.basics.controls import NoteLabel, caption
from ...widgets.basics.fields import field_spec
from ...widgets.basics.layouts import STRETCH, hbox
from ...widgets.images.image_pane import ImagePane, Swatch
from ...widgets.parameters.parameter_panel import SECTIONS
from ...widgets.plots.error_curve import ErrorCurvePlot
from ..calibration.pictures import pack_rgb

_TITLES = dict(SECTIONS)
#: Legend and colour of each pixel of a mask's picture; the same in both themes.
_LABELS: dict[int, tuple[str, tuple[int, int, int]]] = {
    MaskLabel.COVERED: ("print covered", (26, 114, 224)),
    MaskLabel.MISSED: ("print missed", (255, 214, 10)),
    MaskLabel.LOST: ("bare lost", (214, 40, 57)),
    MaskLabel.BARE: ("bare kept", (196, 200, 206)),
    MaskLabel.UNKNOWN: ("unknown", (104, 104, 110)),
}
_IN_LEGEND = (MaskLabel.BARE, MaskLabel.LOST, MaskLabel.MISSED, MaskLabel.COVERED)


def section_title(section: str) -> str:
    """Return the heading of a section in the parameter panel."""
    return _TITLES.get(section, section.replace("_", " ").capitalize())


class ProposalCard(QFrame):
    """Shows a proposal. Its values can be changed along the error curve, and it can be left out.

    Signals
    -------
    changed()
        Another value was chosen, or the proposal was ticked or unticked.
    curveWanted()
        The curve of another field was chosen.
    """

    changed = pyqtSignal()
    curveWanted = pyqtSignal()

    def __init__(self, proposal: Proposal, preset: Preset, tickable: bool, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._original, self._preset = proposal, preset
        self._chosen: dict[str, Any] = {}
        self._curve: ErrorCurve | None = None
        self.setFrameShape(QFrame.Shape.StyledPanel)
        self.take = QCheckBox(section_title(proposal.section))
        self.take.setToolTip(f"Take this suggestion for {section_title(proposal.section).lower()}, or leave it")
        self.take.setChecked(bool(proposal.changes))
        self.take.setFont(_bold(self.take.font()))
        self._heading = QLabel(section_title(proposal.section))
        self._heading.setFont(_bold(self._heading.font()))
        (self._heading if tickable else self.take).hide()
        self.label = NoteLabel(proposal.label)
        self.evidence = NoteLabel(proposal.evidence)
        self.expected = NoteLabel(proposal.expected)
        self.weak = NoteLabel("Weaker than with examples: mark untouched frames or paint contact (Examples…).")
        self.weak.setVisible(proposal.weak)
        self.weak.setForegroundRole(QPalette.ColorRole.PlaceholderText)
        self._values = QGridLayout()
        self._values.setHorizontalSpacing(16)
        self._values.setVerticalSpacing(4)
        self._values.setColumnStretch(3, 1)
        column = QVBoxLayout(self)
        column.setSpacing(4)
        head = hbox(self.take, self._heading, (self.label, 1))
        column.addLayout(head)
        for widget in (self.evidence, self.expected, self.weak):
            column.addWidget(widget)
        column.addLayout(self._values)
        if proposal.picture is not None:
            column.addWidget(_mask_picture(proposal.picture))
        self.curve_field = QComboBox()
        self.curve = self._make_curve(column)
        self.take.toggled.connect(self.changed)
        self._show_values()

    @property
    def proposal(self) -> Proposal:
        """The proposal with the values that were chosen on the curve."""
        if not self._chosen:
            return self._original
        texts = (f"{_spec(path).title} {_spec(path).describe(value)}" for path, value in self._chosen.items())
        return replace(self._original, changes={**self._original.changes, **self._chosen}, label=", ".join(texts))

    @property
    def changes(self) -> Mapping[str, Any]:
        """What the proposal changes in the present preset; nothing if it is left out."""
        if not self.take.isChecked():
            return {}
        return {path: value for path, value in self.proposal.changes.items() if value != self._preset.value(path)}

    @property
    def curve_path(self) -> str:
        """The field whose curve is shown; empty for a section without one."""
        return str(self.curve_field.currentData() or "")

    def show_preset(self, preset: Preset) -> None:
        """Show another present preset."""
        self._preset = preset
        self._show_values()

    def show_curve(self, curve: ErrorCurve | None) -> None:
        """Show the curve of `curve_path`, or none."""
        self._curve = curve if curve is not None and curve.path == self.curve_path else None
        self.curve.setVisible(self._curve is not None)
        if self._curve is not None:
            self.curve.set_curve(self._curve.values, self._curve.missed_mm2, self._curve.false_mm2)
            self._show_values()

    def _make_curve(self, column: QVBoxLayout) -> ErrorCurvePlot:
        for path in CURVES.get(self._original.section, {}):
            self.curve_field.addItem(_spec(path).title, path)
        proposed = [self.curve_field.findData(path) for path in self._original.changes]
        self.curve_field.setCurrentIndex(max([0, *proposed]))
        self.curve_field.setToolTip("The parameter whose missed and false area in the examples is drawn")
        self._curve_row = QWidget()
        error_by = caption("Error in the examples by", self.curve_field)
        hbox(error_by, self.curve_field, STRETCH, within=self._curve_row, margins=0)
        self._curve_row.hide()
        curve = ErrorCurvePlot(lambda value: _spec(self.curve_path).describe(value))
        curve.hide()
        curve.chosen.connect(self._choose)
        self.curve_field.activated.connect(lambda _: self._switch_curve())
        column.addWidget(self._curve_row)
        column.addWidget(curve)
        return curve

    def offer_curve(self) -> None:
        """Show the choice of curves: there are examples."""
        self._curve_row.setVisible(self.curve_field.count() > 0)

    def _switch_curve(self) -> None:
        self.show_curve(None)
        self.curveWanted.emit()

    def _choose(self, value: float) -> None:
        spec = _spec(self.curve_path)
        self._chosen[self.curve_path] = round(value) if spec.integer else value
        self.take.setChecked(True)
        self._show_values()
        self.changed.emit()

    def _show_values(self) -> None:
        """List the fields that change, with both values."""
        while (item := self._values.takeAt(0)) is not None:
            widget = item.widget()
            if widget is not None:
                widget.deleteLater()
        proposal = self.proposal
        self.label.setText(proposal.label)
        self.take.setEnabled(bool(proposal.changes))
        for line, (path, value) in enumerate(proposal.changes.items()):
            spec = _spec(path)
            now = self._preset.value(path)
            arrow = "unchanged" if now == value else f"→ {spec.describe(value)}"
            for place, text in enumerate((spec.title, spec.describe(now), arrow)):
                label = QLabel(text)
                label.setToolTip(spec.tooltip)
                self._values.addWidget(label, line, place)
        if self._curve is not None:
            path = self._curve.path
            now = float(self._preset.value(path))
            self.curve.set_values(now, float(proposal.changes.get(path, now)))


def _spec(path: str) -> Any:
    return field_spec(Preset, path)


def _mask_picture(labels: Uint8Array) -> QWidget:
    """Draw which prints a mask covers and which bare membrane it loses."""
    colors = np.zeros((256, 3), np.uint8)
    for label, (_, rgb) in _LABELS.items():
        colors[label] = rgb
    pane = ImagePane("Prints under this mask")
    height, width = labels.shape
    pane.set_pixels(pack_rgb(colors[labels]), (width, height), 1)
    pane.header.set_legend(None, tuple(Swatch(*_LABELS[label]) for label in _IN_LEGEND))
    pane.header.set_lines(2)
    pane.setFixedHeight(220)
    pane.resized.connect(lambda: pane.show_rect(pane.image_rect()))
    return pane


def _bold(font: QFont) -> QFont:
    bold = QFont(font)
    bold.setBold(True)
    return bold
