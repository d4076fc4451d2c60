"""One suggestion in the window: what it changes, and why."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from PyQt6.QtCore import pyqtSignal
from PyQt6.QtWidgets import QCheckBox, QFrame, QGridLayout, QLabel, QVBoxLayout

from ...core.preset import Preset
from ...core.tuning.advice.proposal import Proposal
from ...widgets.basics.controls import NoteLabel
from ...widgets.basics.fields import field_spec
from ...widgets.basics.layouts import hbox
from ...widgets.parameters.parameter_panel import SECTIONS

_TITLES = dict(SECTIONS)


def section_title(section: str) -> str:
    return _TITLES.get(section, section.replace("_", " ").capitalize())


class ProposalCard(QFrame):
    """Shows a proposal, which can be left out."""

    changed = pyqtSignal()  # it was ticked or unticked

    def __init__(self, proposal: Proposal, preset: Preset) -> None:
        super().__init__()
        self.proposal, self._preset = proposal, preset
        self.setFrameShape(QFrame.Shape.StyledPanel)
        self.take = QCheckBox(section_title(proposal.section))
        self.take.setToolTip(f"Take this suggestion for {section_title(proposal.section).lower()}, or leave it")
        self.take.setChecked(bool(proposal.changes))
        self.take.setEnabled(bool(proposal.changes))
        bold = self.take.font()
        bold.setBold(True)
        self.take.setFont(bold)
        self.label = NoteLabel(proposal.label)
        self.evidence, self.expected = NoteLabel(proposal.evidence), NoteLabel(proposal.expected)
        self._values = QGridLayout()
        self._values.setHorizontalSpacing(16)
        self._values.setVerticalSpacing(4)
        self._values.setColumnStretch(3, 1)
        column = QVBoxLayout(self)
        column.setSpacing(4)
        head = hbox(self.take, (self.label, 1))
        column.addLayout(head)
        for widget in (self.evidence, self.expected):
            column.addWidget(widget)
        column.addLayout(self._values)
        self.take.toggled.connect(self.changed)
        self._show_values()

    @property
    def changes(self) -> Mapping[str, Any]:
        """What the proposal changes in the present preset; nothing if it is left out."""
        if not self.take.isChecked():
            return {}
        return {path: value for path, value in self.proposal.changes.items() if value != self._preset.value(path)}

    def show_preset(self, preset: Preset) -> None:
        self._preset = preset
        self._show_values()

    def _show_values(self) -> None:
        while (item := self._values.takeAt(0)) is not None:
            widget = item.widget()
            if widget is not None:
                widget.deleteLater()
        for line, (path, value) in enumerate(self.proposal.changes.items()):
            spec = field_spec(Preset, path)
            now = self._preset.value(path)
            arrow = "unchanged" if now == value else f"→ {spec.describe(value)}"
            for place, text in enumerate((spec.title, spec.describe(now), arrow)):
                label = QLabel(text)
                label.setToolTip(spec.tooltip)
                self._values.addWidget(label, line, place)
