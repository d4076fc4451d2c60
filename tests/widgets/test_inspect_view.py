"""Picking in a 3D view."""

import numpy as np
import pytest
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtTest import QTest

from seen_clouds import FRONT, canvas_of, cloud_of, picture, shown, wall
from tactune.widgets.clouds.cloud_view import CloudView

LEFT = Qt.MouseButton.LeftButton


@pytest.fixture
def view(qtbot):
    made = CloudView("Patch", inspects=True)
    shown(qtbot, made)
    made.set_cloud(cloud_of(wall()))
    made.set_camera(FRONT)
    QTest.mouseRelease(canvas_of(made), LEFT)  # of a double click in an earlier test; else a move is a drag
    return made


def on_canvas(view, pixel):
    """Where a pixel of the cloud is seen."""
    cloud, canvas = view.cloud(), canvas_of(view)
    u, v, _ = view.camera().project(cloud.places(np.array([pixel])), canvas.width(), canvas.height())[0]
    return QPoint(int(u), int(v))


@pytest.mark.parametrize("pixel", [20 * 64 + 30, 40 * 64 + 12])
def test_the_point_under_the_mouse_is_found(view, qtbot, pixel):
    at, heard = on_canvas(view, pixel), list[tuple[int, object]]()
    view.pointHovered.connect(lambda point: heard.append(point) if point is not None else None)

    def pointed():
        """Point there once more: the display's own pointer, which is elsewhere, may end the hovering meanwhile."""
        QTest.mouseMove(canvas_of(view), at + QPoint(0, 1))
        QTest.mouseMove(canvas_of(view), at)
        return bool(heard)

    qtbot.waitUntil(pointed)
    cloud = view.cloud()
    found, place = heard[-1]
    assert found == pixel
    np.testing.assert_allclose(place, cloud.places(np.array([pixel]))[0])


def test_a_mark_is_painted_and_goes(view):
    bare = picture(view)
    view.set_mark((0.0, 0.0, 0.3))
    marked = picture(view)
    height, width = bare.shape[:2]
    changed = np.argwhere((bare != marked).any(axis=2))
    assert np.abs(changed.mean(axis=0) - (height / 2, width / 2)).max() < 2
    view.set_mark(None)
    assert (picture(view) == bare).all()
