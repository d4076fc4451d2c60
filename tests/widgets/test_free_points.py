"""Points without an image: their positions and colours, and the point that a click selects."""

from __future__ import annotations

import numpy as np
import pytest
from PyQt6.QtGui import QColor, QImage, QPalette
from PyQt6.QtWidgets import QWidget
from pytestqt.qtbot import QtBot

from tactune.widgets.clouds.cloud_data import free_cloud
from tactune.widgets.clouds.cloud_view import CloudView
from tactune.widgets.clouds.view_camera import ViewCamera

COLORS = [(255, 0, 0), (0, 160, 0), (0, 0, 255), (200, 0, 200)]
POINTS = np.array([(0.02, -0.03, -0.05), (-0.04, 0.01, 0.3), (0.0, 0.0, 0.0), (0.05, 0.04, 0.1)])


def lut() -> np.ndarray:
    table = np.zeros((256, 4), np.uint8)
    for row, color in enumerate(COLORS):
        table[row] = (*color, 255)
    return table


@pytest.mark.parametrize("azimuth", [0.0, 2.5])
def test_free_points_are_drawn_where_they_lie(qtbot: QtBot, azimuth: float) -> None:
    view = CloudView("Scan")
    palette = view.palette()
    palette.setColor(QPalette.ColorRole.Base, QColor("white"))
    view.setPalette(palette)
    view.resize(420, 360)
    qtbot.addWidget(view)
    with qtbot.waitExposed(view):
        view.show()
    view.set_cloud(free_cloud(POINTS, np.arange(4, dtype=np.uint8), lut()))
    view.set_point_size(3)
    view.set_camera(ViewCamera((0.0, 0.0, 0.1), 0.9, azimuth, 0.3))
    canvas = view.findChild(QWidget, "canvas")
    assert canvas is not None
    image = canvas.grab().toImage().convertToFormat(QImage.Format.Format_RGB888)
    places = view.camera().project(POINTS, canvas.width(), canvas.height())
    for (u, v, _), color in zip(places, COLORS, strict=True):
        assert image.pixelColor(int(u), int(v)).getRgb()[:3] == color
    assert view.point_count() == 4


def test_points_survive_the_image() -> None:
    rng = np.random.default_rng(4)
    points = rng.uniform(-0.15, 0.15, (5000, 3)) + np.array([0.3, -0.1, 0.0])
    cloud = free_cloud(points, np.zeros(5000, np.uint8), lut())
    np.testing.assert_allclose(cloud.points(), points, atol=3e-6)
