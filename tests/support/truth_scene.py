"""Clicks at a place that a view draws."""

from __future__ import annotations

import numpy as np
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QWidget

from hands import LEFT
from tactune.widgets.clouds.pick_view import PickView


def click_at(view: PickView, place: object) -> None:
    """Click where a place is drawn."""
    canvas, top = view.findChild(QWidget, "canvas"), view.window()
    assert canvas is not None and top is not None
    u, v, _ = view.camera().project(np.array([place]), canvas.width(), canvas.height())[0]
    QTest.mouseClick(
        top.windowHandle(), LEFT, Qt.KeyboardModifier.NoModifier, canvas.mapTo(top, QPoint(int(u), int(v)))
    )
