"""What a person does in the views: framing, enlarging, and going back, by real mouse and key events."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QToolButton, QWidget

from hands import show_source
from tactune.app.window.main_window import MainWindow
from tactune.app.worker.results import CloudName
from tiny_sensor import TinySource, tiny_frame

LEFT = Qt.MouseButton.LeftButton
PATCH, TACTILE, PROXIMITY = CloudName.PATCH, CloudName.TACTILE, CloudName.PROXIMITY


class WallSource(TinySource):
    """A disc on the membrane in front of a wall at 2 m; past the membrane's edge the tactile camera sees 3 m."""

    def __init__(self):
        super().__init__()
        self.name = "wall"

    def read(self, index):
        frame = tiny_frame(index, self.rig)
        proximity, tactile = frame.proximity_depth.copy(), frame.tactile_depth.copy()
        proximity[proximity > 1.05 * proximity.min()] = round(2.0 / self.rig.proximity.depth_unit_m)
        tactile[:, :5] = round(3.0 / self.rig.tactile.depth_unit_m)
        return replace(frame, proximity_depth=proximity, tactile_depth=tactile)


def canvas(window: MainWindow, name: CloudName) -> QWidget:
    found = window.views.views[name].findChild(QWidget, "canvas")
    assert found is not None
    return found


def extent(window, name, points):
    """Left, top, right and bottom of points in a view, as shares of its size."""
    size = canvas(window, name).width(), canvas(window, name).height()
    places = window.views.views[name].camera().project(points, *size)[:, :2] / size
    return *places.min(axis=0), *places.max(axis=0)


def membrane(window):
    cloud = window.views.views[TACTILE].cloud()
    points = cloud.points()
    return points[points[:, 2] < 1.0]


def shows_all(window):
    shown = {name for name, view in window.views.views.items() if view.isVisible()}
    return shown == set(CloudName) and all(pane.isVisible() for pane in window.strip.panes.values())


def test_the_membrane_is_framed_not_the_wall_behind_and_frames_do_not_move_the_camera(make_window, qtbot):
    window = make_window()
    show_source(qtbot, window, WallSource(), 3)
    for key in (None, Qt.Key.Key_V, Qt.Key.Key_T, Qt.Key.Key_R):
        if key is not None:
            QTest.keyClick(window, key)
        left, top, right, bottom = extent(window, PROXIMITY, membrane(window))
        assert min(left, top) >= 0 and max(right, bottom) <= 1, key
        assert max(right - left, bottom - top) > 0.8, key
    camera = window.views.views[PATCH].camera()
    window.worker.seek(7)
    qtbot.waitUntil(lambda: window.result.playback.index == 7)
    assert window.views.views[PATCH].camera() == camera


def test_front_looks_along_the_optical_axis(window):
    QTest.keyClick(window.views.views[TACTILE], Qt.Key.Key_V)
    for view in window.views.views.values():
        np.testing.assert_allclose(view.camera().axes(), np.diag([1, -1, -1]), atol=1e-9)


def test_another_source_is_framed_even_after_somebody_steered(window, qtbot):
    QTest.keyClick(window.views.views[PATCH], Qt.Key.Key_Plus)
    QTest.keyClick(window.views.views[PATCH], Qt.Key.Key_Plus)
    steered = window.views.views[PATCH].camera()
    show_source(qtbot, window, WallSource(), 3)
    assert window.views.views[PATCH].camera().distance > steered.distance
    left, top, right, bottom = extent(window, TACTILE, membrane(window))
    assert min(left, top) >= 0 and max(right, bottom) <= 1


def test_zoom_to_patch_fills_the_view_with_the_patch_and_is_off_without_one(window, qtbot):
    patch = window.result.patch.points
    before = extent(window, PATCH, patch)
    QTest.keyClick(window, Qt.Key.Key_Z)
    left, top, right, bottom = extent(window, PATCH, patch)
    assert 0.5 < max(right - left, bottom - top) < 0.7
    assert right - left > 1.5 * (before[2] - before[0])
    assert abs(left + right - 1) < 0.05 and abs(top + bottom - 1) < 0.05
    window.document.edit("tolerance.t", 0.0)
    qtbot.waitUntil(lambda: not window.actions_.zoom_to_patch.isEnabled())


@pytest.mark.parametrize("back", ["double click", "escape", "button"])
@pytest.mark.parametrize("name", ["patch", "tactile image"])
def test_a_double_click_enlarges_a_view_or_image_and_another_goes_back(window, qtbot, name, back):
    pane = window.strip.panes["tactile"]
    target = canvas(window, PATCH) if name == "patch" else pane.view.viewport()
    part = window.views.views[PATCH] if name == "patch" else pane
    width = part.width()
    QTest.mouseDClick(target, LEFT, pos=QPoint(60, 60))
    qtbot.waitUntil(lambda: part.width() > 2.5 * width)
    others = [*window.views.views.values(), *window.strip.panes.values()]
    assert [other for other in others if other.isVisible()] == [part]
    # What is hidden is not drawn, and an image is drawn as finely as it is shown.
    edited = window.document.preset.with_values({"tolerance.t": 0.02})
    window.document.edit("tolerance.t", 0.02)
    qtbot.waitUntil(lambda: window.result.preset == edited)
    drawn = window.result.rendered
    assert set(drawn.clouds) == ({PATCH} if name == "patch" else set())
    assert (drawn.strip is None) == (name == "patch")
    if back == "double click":
        QTest.mouseDClick(target, LEFT, pos=QPoint(60, 60))
    elif back == "escape":
        QTest.keyClick(window, Qt.Key.Key_Escape)
    else:
        QTest.mouseClick(part.findChild(QToolButton, "back"), LEFT)
    qtbot.waitUntil(lambda: shows_all(window) and part.width() == width)
    qtbot.waitUntil(lambda: set(window.result.rendered.clouds) == set(CloudName))


def test_an_enlarged_image_is_drawn_finer(window, qtbot):
    hint = window.strip.width_hint()
    QTest.mouseDClick(window.strip.panes["tactile"].view.viewport(), LEFT, pos=QPoint(60, 60))
    qtbot.waitUntil(lambda: window.strip.width_hint() > 1.5 * hint)


def test_going_back_keeps_hidden_what_the_person_hid(window, qtbot):
    window.actions_.show_tactile.trigger()
    window.actions_.show_strip.trigger()
    QTest.mouseDClick(canvas(window, PATCH), LEFT)
    assert not window.views.views[PROXIMITY].isVisible()
    QTest.mouseDClick(canvas(window, PATCH), LEFT)
    qtbot.waitUntil(window.views.views[PROXIMITY].isVisible)
    assert not window.views.views[TACTILE].isVisible()
    assert not window.strip.isVisible()
