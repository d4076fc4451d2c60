"""Clouds that differ clearly in images, views that show them, and simulated user input."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtGui import QColor, QImage, QPalette
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QWidget
from pytestqt.qtbot import QtBot

from hands import shown
from tactune.core.model.intrinsics import Intrinsics
from tactune.widgets.basics.colormaps import depth_lut
from tactune.widgets.clouds.cloud_data import DepthCloud
from tactune.widgets.clouds.cloud_view import CloudView
from tactune.widgets.clouds.view_camera import ViewCamera

LENS = Intrinsics(width=64, height=48, fx=46.0, fy=46.0, cx=31.5, cy=23.5)
RAYS = LENS.rays()
RED, GREEN, BLUE = (255, 0, 0), (0, 255, 0), (0, 0, 255)
FRONT = ViewCamera((0.0, 0.0, 0.3), 0.6, azimuth=0.0, elevation=0.0)


def shown_view(qtbot: QtBot, title: str = "Proximity") -> CloudView:
    view = CloudView(title)
    palette = view.palette()
    palette.setColor(QPalette.ColorRole.Base, QColor("white"))
    view.setPalette(palette)
    return shown(qtbot, view, 420, 361)  # type: ignore[no-any-return, no-untyped-call]


def canvas_of(view: CloudView) -> QWidget:
    canvas = view.findChild(QWidget, "canvas")
    assert canvas is not None
    return canvas


def picture(view: CloudView) -> npt.NDArray[np.uint8]:
    """What the canvas shows: uint8 (H, W, 3), RGB."""
    image = canvas_of(view).grab().toImage().convertToFormat(QImage.Format.Format_RGB888)
    bits = image.constBits()
    assert bits is not None
    rows = np.frombuffer(bits.asstring(image.sizeInBytes()), np.uint8).reshape(image.height(), image.bytesPerLine())
    return rows[:, : 3 * image.width()].reshape(image.height(), image.width(), 3).copy()


def pixels_of(image: npt.NDArray[np.uint8], color: tuple[int, int, int]) -> npt.NDArray[np.intp]:
    """``(u, v)`` of all pixels of exactly this colour."""
    return np.argwhere((image == color).all(axis=2))[:, ::-1]


def cloud_of(depth: npt.NDArray[np.uint16], **changes: object) -> DepthCloud:
    given: dict[str, object] = {"depth_unit_m": 0.001, "rays": RAYS, "lut": depth_lut(), "pose": np.eye(4)} | changes
    return DepthCloud(depth, **given)  # type: ignore[arg-type]


def wall(counts: int = 300) -> npt.NDArray[np.uint16]:
    return np.full((48, 64), counts, np.uint16)


def colored(*colors: tuple[int, int, int]) -> npt.NDArray[np.uint8]:
    """A table whose first rows are these colours and whose other rows are hidden."""
    lut = np.zeros((256, 4), np.uint8)
    for row, color in enumerate(colors):
        lut[row] = (*color, 255)
    return lut


def red_wall() -> DepthCloud:
    return cloud_of(wall(), index=np.zeros((48, 64), np.uint8), lut=colored(RED))


def drag(view: CloudView, start: tuple[int, int], end: tuple[int, int], button: Qt.MouseButton, **keys: object) -> None:
    window = view.window()
    assert window is not None
    handle = window.windowHandle()
    assert handle is not None
    modifier = keys.get("modifier", Qt.KeyboardModifier.NoModifier)
    a, b = (canvas_of(view).mapTo(window, QPoint(*at)) for at in (start, end))
    QTest.mousePress(handle, button, modifier, a)  # type: ignore[arg-type]
    QTest.mouseMove(handle, (a + b) / 2)
    QTest.mouseMove(handle, b)
    QTest.mouseRelease(handle, button, modifier, b)  # type: ignore[arg-type]
