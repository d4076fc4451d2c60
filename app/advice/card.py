"""One suggestion in the window: what it changes, why, and its picture."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from PyQt6.QtCore import pyqtSignal
from PyQt6.QtGui import QColor, QFont, QPalette
from PyQt6.QtWidgets import QCheckBox, QFrame, QGridLayout, QLabel, QVBoxLayout, QWidget

from ...core.model.arrays import Uint8Array
from ...core.preset import Preset
from ...core.tuning.advice.proposal import MaskLabel, Proposal
from ...widgets.basics.controls import NoteLabel
from ...widgets.basics.fields import field_spec
from ...widgets.basics.layouts import hbox
from ...widgets.images.image_pane import ImagePane
from ...widgets.parameters.parameter_panel import SECTIONS
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
    """Shows a proposal, which can be left out.

    Signals
    -------
    changed()
        The proposal was ticked or unticked.
    """

    changed = pyqtSignal()

    def __init__(self, proposal: Proposal, preset: Preset, tickable: bool, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.proposal, self._preset = proposal, preset
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
        self.weak = NoteLabel("Weaker than with examples: mark frames (Examples…).")
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
        self.take.toggled.connect(self.changed)
        self._show_values()

    @property
    def changes(self) -> Mapping[str, Any]:
        """What the proposal changes in the present preset; nothing if it is left out."""
        if not self.take.isChecked():
            return {}
        return {path: value for path, value in self.proposal.changes.items() if value != self._preset.value(path)}

    def show_preset(self, preset: Preset) -> None:
        """Show another present preset."""
        self._preset = preset
        self._show_values()

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
    pane.set_legend([(text, QColor(*rgb)) for text, rgb in (_LABELS[label] for label in _IN_LEGEND)])
    pane.setFixedHeight(220)
    pane.resized.connect(lambda: pane.show_rect(pane.image_rect()))
    return pane


def _bold(font: QFont) -> QFont:
    bold = QFont(font)
    bold.setBold(True)
    return bold
