"""Layouts of widgets side by side or one below the other, and areas that scroll or can be resized, made in one call."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import Final, TypeVar

from PyQt6.QtCore import Qt
from PyQt6.QtWidgets import QBoxLayout, QFrame, QHBoxLayout, QLayout, QScrollArea, QSplitter, QVBoxLayout, QWidget


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
    """Return a layout with its parts side by side; margins and spacing in pixels, by default the style's own."""
    return _filled(QHBoxLayout(within), parts, margins, spacing)


def vbox(
    *parts: Part, within: QWidget | None = None, margins: Margins | None = None, spacing: int | None = None
) -> QVBoxLayout:
    """Return a layout with its parts one below the other; parameters as for `hbox`."""
    return _filled(QVBoxLayout(within), parts, margins, spacing)


def holding(layout: QLayout) -> QWidget:
    """Return a widget that a layout fills."""
    widget = QWidget()
    widget.setLayout(layout)
    return widget


def splitter(
    orientation: Qt.Orientation, *parts: QWidget | tuple[QWidget, int], sizes: Sequence[int] = ()
) -> QSplitter:
    """Return widgets whose shares of the room, ``sizes`` at first, a person can change; none can be hidden."""
    made = QSplitter(orientation)
    for number, part in enumerate(parts):
        widget, stretch = part if isinstance(part, tuple) else (part, 0)
        made.addWidget(widget)
        if stretch:
            made.setStretchFactor(number, stretch)
    if sizes:
        made.setSizes(list(sizes))
    made.setChildrenCollapsible(False)
    return made


def scrolling(content: QWidget, min_width: int = 0) -> QScrollArea:
    """Return an area without a frame that scrolls up and down, as wide as its content or ``min_width`` px."""
    scroll = QScrollArea()
    scroll.setWidget(content)
    scroll.setWidgetResizable(True)
    scroll.setFrameShape(QFrame.Shape.NoFrame)
    scroll.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
    bar = scroll.verticalScrollBar()
    if min_width and bar is not None:
        scroll.setMinimumWidth(max(min_width, content.minimumSizeHint().width() + bar.sizeHint().width()))
    return scroll


def empty(layout: QLayout) -> None:
    """Take all widgets out of a layout; each ends only after the event in which one of them asked for that."""
    while (item := layout.takeAt(0)) is not None:
        if (widget := item.widget()) is not None:
            widget.hide()
            widget.deleteLater()


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
