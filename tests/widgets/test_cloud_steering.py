"""A cloud view follows mouse and keys and frames its content."""

import numpy as np
import pytest
from PyQt6.QtCore import QPointF, Qt
from PyQt6.QtTest import QTest

from hands import turn_wheel
from seen_clouds import FRONT, RED, canvas_of, cloud_of, colored, drag, picture, pixels_of, wall


def test_the_scene_follows_the_hand(view):
    view.set_cloud(cloud_of(wall()))
    before, seen = view.camera(), picture(view)
    drag(view, (100, 100), (140, 120), Qt.MouseButton.LeftButton)
    after = view.camera()
    assert after.azimuth < before.azimuth, "to the right, so the eye goes left"
    assert after.elevation > before.elevation
    assert (after.distance, after.target) == (before.distance, before.target)
    assert (picture(view) != seen).any()


def test_the_wheel_zooms_about_the_cursor(view):
    view.set_camera(FRONT)
    canvas = canvas_of(view)
    size = canvas.width(), canvas.height()
    point = np.array([0.05, -0.04, 0.3])
    u, v, _ = FRONT.project([point], *size)[0]
    turn_wheel(canvas, QPointF(u, v), 2, view)
    assert view.camera().distance < FRONT.distance
    np.testing.assert_allclose(view.camera().project([point], *size)[0, :2], (u, v), atol=0.01)
    turn_wheel(canvas, QPointF(u, v), -2, view)
    assert view.camera().distance == pytest.approx(FRONT.distance)


def test_keys_orbit_zoom_and_choose_viewpoints(view):
    view.set_cloud(cloud_of(wall()))
    view.setFocus()
    start = view.camera()

    def after(key):
        QTest.keyClick(view, key)
        return view.camera()

    assert after(Qt.Key.Key_Right).azimuth > start.azimuth
    assert after(Qt.Key.Key_Left).azimuth == pytest.approx(start.azimuth)
    assert after(Qt.Key.Key_Up).elevation > start.elevation
    assert after(Qt.Key.Key_Down).elevation == pytest.approx(start.elevation)
    assert after(Qt.Key.Key_Plus).distance < start.distance
    assert after(Qt.Key.Key_Minus).distance == pytest.approx(start.distance)
    assert after(Qt.Key.Key_T).elevation == pytest.approx(np.pi / 2)
    assert after(Qt.Key.Key_S).azimuth == pytest.approx(np.pi / 2)
    reset = after(Qt.Key.Key_R)
    assert (reset.azimuth, reset.elevation) == (start.azimuth, start.elevation)
    assert reset.target == pytest.approx(start.target)


# Framing


def extent(view, color):
    """Left, top, right and bottom of a colour as shares of the canvas."""
    image = picture(view)
    pixels = pixels_of(image, color)
    size = np.array(image.shape[1::-1])
    return np.concatenate([pixels.min(axis=0), pixels.max(axis=0) + 1]) / np.tile(size, 2)


def test_the_first_cloud_is_framed_and_stays_so_when_resized_until_somebody_steers(view, qtbot):
    view.set_cloud(cloud_of(wall(700), index=np.zeros((48, 64), np.uint8), lut=colored(RED)))
    for width, height in ((420, 360), (300, 500), (700, 250)):
        view.resize(width, height)
        qtbot.waitUntil(lambda width=width: canvas_of(view).width() <= view.width() == width)
        left, top, right, bottom = extent(view, RED)
        assert min(left, top) >= 0
        assert max(right, bottom) <= 1
        assert max(right - left, bottom - top) > 0.8
    view.set_camera(FRONT)
    view.resize(420, 360)
    view.set_cloud(None)
    view.set_cloud(cloud_of(wall(500)))
    assert view.camera() == FRONT
