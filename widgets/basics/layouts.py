"""Layouts of widgets side by side or one below the other, and areas that scroll, made in one call."""

from __future__ import annotations

from enum import Enum
from typing import Final, TypeVar

from PyQt6.QtCore import Qt
from PyQt6.QtWidgets import QBoxLayout, QFrame, QHBoxLayout, QLayout, QScrollArea, QVBoxLayout, QWidget


class Space(Enum):
    """Empty room in a layout."""

    STRETCH = "stretch"


#: Takes the room that is left.
STRETCH: Final = Space.STRETCH

#: A widget or a layout, alone or with its stretch factor; `STRETCH`; or a fixed space in pixels.
Part = QWidget | QLayout | tuple[QWidget | QLayout, int] | Space | int
#: Pixels around a layout: on all sides, or left, top, right and bottom.
Margins = int | tuple[int, int, int, int]

_Layout = TypeVar("_Layout", bound=QBoxLayout)


def hbox(
    *parts: Part, within: QWidget | None = None, margins: Margins | None = None, spacing: int | None = None
) -> QHBoxLayout:
    """Return a layout with its parts side by side.

    Parameters
    ----------
    *parts : Part
    within : QWidget, optional
        The widget that gets this layout.
    margins, spacing : optional
        Pixels around and between the parts; the style's own by default.
    """
    return _filled(QHBoxLayout(within), parts, margins, spacing)


def vbox(
    *parts: Part, within: QWidget | None = None, margins: Margins | None = None, spacing: int | None = None
) -> QVBoxLayout:
    """Return a layout with its parts one below the other; parameters as for `hbox`."""
    return _filled(QVBoxLayout(within), parts, margins, spacing)


def scrolling(content: QWidget) -> QScrollArea:
    """Return an area without a frame that is as wide as its content and scrolls it up and down."""
    scroll = QScrollArea()
    scroll.setWidget(content)
    scroll.setWidgetResizable(True)
    scroll.setFrameShape(QFrame.Shape.NoFrame)
    scroll.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
    return scroll


def _filled(layout: _Layout, parts: tuple[Part, ...], margins: Margins | None, spacing: int | None) -> _Layout:
    if margins is not None:
        layout.setContentsMargins(*((margins,) * 4 if isinstance(margins, int) else margins))
    if spacing is not None:
        layout.setSpacing(spacing)
    for part in parts:
        if isinstance(part, Space):
            layout.addStretch(1)
        elif isinstance(part, int):
            layout.addSpacing(part)
        else:
            item, stretch = part if isinstance(part, tuple) else (part, 0)
            if isinstance(item, QWidget):
                layout.addWidget(item, stretch)
            else:
                layout.addLayout(item, stretch)
    return layout
