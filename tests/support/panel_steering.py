"""Edits of a parameter panel, recorded from its signals."""

from __future__ import annotations

from typing import Any

from PyQt6.QtCore import Qt

from tactune.widgets.parameters.parameter_panel import ParameterPanel

LEFT = Qt.MouseButton.LeftButton
EYE4 = ((1.0, 0.0, 0.0, 0.04), (0.0, 1.0, 0.0, -0.00123), (0.0, 0.0, 1.0, 0.003), (0.0, 0.0, 0.0, 1.0))
EYE3 = ((1.01, 0.0, 12.5), (0.0, 0.99, -3.25), (1e-5, 0.0, 1.0))


class Recorder:
    """Everything a panel emitted."""

    def __init__(self, panel: ParameterPanel) -> None:
        self.edits: list[tuple[str, Any, int]] = []
        self.resets: list[tuple[dict[str, Any], int]] = []
        self.modes: list[str] = []
        panel.valueEdited.connect(lambda path, value, gesture: self.edits.append((path, value, gesture)))
        panel.valuesEdited.connect(lambda values, gesture: self.resets.append((values, gesture)))
        panel.eyedropperRequested.connect(self.modes.append)
