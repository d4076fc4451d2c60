"""What a person does in the views: framing, enlarging, pointing, copying, by real mouse and key events."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from PyQt6.QtCore import QEvent, QPoint, QRect, QSize, Qt
from PyQt6.QtGui import QHelpEvent
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication, QToolTip, QWidget

from fakes import FakeSource, tiny_frame
from hands import CONTROL, LEFT, image_position, show_source
from tactune.app.worker.results import CloudName

PATCH, TACTILE, PROXIMITY = CloudName.PATCH, CloudName.TACTILE, CloudName.PROXIMITY


def before_a_wall(index, rig):
    """A disc on the membrane in front of a wall at 2 m; past the membrane's edge the tactile camera sees 3 m."""
    frame = tiny_frame(index, rig)
    proximity, tactile = frame.proximity_depth.copy(), frame.tactile_depth.copy()
    proximity[proximity > 1.05 * proximity.min()] = round(2.0 / rig.proximity.depth_unit_m)
    tactile[:, :5] = round(3.0 / rig.tactile.depth_unit_m)
    return replace(frame, proximity_depth=proximity, tactile_depth=tactile)


def canvas(window, name):
    found = window.views.views[name].findChild(QWidget, "canvas")
    assert found is not None
    return found


def double_click(widget):
    """Double-click in the middle of a widget; QTest leaves the button pressed."""
    QTest.mouseDClick(widget, LEFT)
    QTest.mouseRelease(widget, LEFT)


def extent(window, name, points):
    """Left, top, right and bottom of points in a view, as shares of its size."""
    size = canvas(window, name).width(), canvas(window, name).height()
    places = window.views.views[name].camera().project(points, *size)[:, :2] / size
    return *places.min(axis=0), *places.max(axis=0)


def membrane(window):
    cloud = window.views.views[TACTILE].cloud()
    points = cloud.points()
    return points[points[:, 2] < 1.0]


def place(window, widget):
    return QRect(widget.mapTo(window, QPoint()), widget.size())


def shows_all(window):
    shown = {name for name, view in window.views.views.items() if view.isVisible()}
    return shown == set(CloudName) and any(pane.isVisible() for pane in window.strip.panes.values())


def test_the_membrane_is_framed_not_the_wall_behind_and_frames_do_not_move_the_camera(window, qtbot):
    show_source(qtbot, window, FakeSource(make=before_a_wall), 3)
    for key in (None, Qt.Key.Key_V, Qt.Key.Key_T, Qt.Key.Key_R):
        if key is not None:
            QTest.keyClick(window, key)
        left, top, right, bottom = extent(window, PROXIMITY, membrane(window))
        assert min(left, top) >= 0 and max(right, bottom) <= 1, key
        assert max(right - left, bottom - top) > 0.8, key
        assert len({view.camera() for view in window.views.views.values()}) == 1, "they turn together"
    camera = window.views.views[PATCH].camera()
    window.worker.seek(7)
    qtbot.waitUntil(lambda: window.result.playback.index == 7)
    assert window.views.views[PATCH].camera() == camera


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


def test_the_large_view_alone_shows_its_legend_and_a_tooltip_tells_those_of_others(window, qtbot):
    def painted(name):
        header = window.views.views[name].header
        image = header.grab().toImage()
        places = [(x, y) for x in range(image.width()) for y in range(image.height())]
        return header.entries[0][1].rgb() in {image.pixel(*at) for at in places}

    assert painted(PATCH) and not painted(PROXIMITY)
    QTest.mouseMove(canvas(window, PROXIMITY), QPoint(9, 9))
    where = canvas(window, PROXIMITY).mapToGlobal(QPoint(9, 9))
    QApplication.sendEvent(canvas(window, PROXIMITY), QHelpEvent(QEvent.Type.ToolTip, QPoint(9, 9), where))
    points = window.views.views[PROXIMITY].point_count()
    assert f"{points:,} points" in QToolTip.text() and "behind" in QToolTip.text() and "Drag" in QToolTip.text()
    double_click(canvas(window, PROXIMITY))
    qtbot.waitUntil(lambda: painted(PROXIMITY) and not painted(PATCH))


@pytest.mark.parametrize("name", ["proximity", "tactile", "tactile image"])
def test_a_double_click_swaps_a_view_or_image_with_the_patch_and_another_swaps_back(window, qtbot, name):
    window.strip.choose("tactile")
    pane, views = window.strip.panes["tactile"], window.views.views
    part = pane if name == "tactile image" else views[CloudName(name)]
    target = pane.view.viewport() if part is pane else canvas(window, CloudName(name))
    patch, before = views[PATCH], place(window, part)
    large = place(window, patch)
    double_click(target)
    small = window.strip if part is pane else part
    qtbot.waitUntil(lambda: place(window, patch).right() < place(window, small).left())
    assert abs(place(window, small).width() - large.width()) <= 1
    assert all(view.isVisible() for view in views.values())
    if part is pane:  # alone, without tabs
        assert [each for each in window.strip.panes.values() if each.isVisible()] == [pane]
    # A third part takes the large place from the second.
    double_click(canvas(window, TACTILE if name == "proximity" else PROXIMITY))
    qtbot.waitUntil(lambda: place(window, views[TACTILE if name == "proximity" else PROXIMITY]) == large)
    if name == "proximity":
        QTest.keyClick(window, Qt.Key.Key_Escape)
    else:
        double_click(canvas(window, PROXIMITY))
    qtbot.waitUntil(lambda: shows_all(window) and place(window, patch) == large and place(window, part) == before)


@pytest.mark.parametrize("size", [(960, 500), (1024, 700), (1920, 1080)])
def test_the_patch_has_twice_the_area_of_any_other_view_in_every_mode(own_window, qtbot, size):
    window = own_window
    window.resize(*size)
    for mode, key in (("set_up", Qt.Key.Key_1), ("tune", Qt.Key.Key_2), ("run", Qt.Key.Key_3)):
        QTest.keyClick(window, key, CONTROL)
        assert window.modes.mode.value == mode
        qtbot.waitUntil(lambda: window.size() == QSize(*size) and window.modes.stack.isVisible())
        QApplication.processEvents()
        images = [pane.view for pane in window.strip.panes.values() if pane.isVisible()]
        areas = [each.width() * each.height() for each in (canvas(window, PROXIMITY), canvas(window, TACTILE), *images)]
        shown = canvas(window, PATCH)
        assert shown.width() * shown.height() >= 2 * max(areas), mode


def test_the_numbers_stand_on_the_patch(window, qtbot):
    area, touches, _, centroid = window.views.views[PATCH].canvas.readings
    assert area.value == f"{window.result.area_mm2:,.0f} mm²"
    x, y, z = window.result.patch.centroid_m
    assert centroid.value.replace("−", "-") == f"{1e3 * x:.0f}, {1e3 * y:.0f}, {1e3 * z:.0f}"
    assert touches.value.endswith("%")
    before = canvas(window, PATCH).grab().toImage()
    window.views.views[PATCH].set_readings(())
    assert canvas(window, PATCH).grab().toImage() != before, "they are painted"
    seen = {}
    area_of = canvas(window, PATCH)
    window.context.frameShown.connect(lambda: seen.update({window.result.area_mm2: area_of.readings[0].value}))
    QTest.keyClick(window, Qt.Key.Key_Space)
    qtbot.waitUntil(lambda: len(seen) > 5)
    assert seen == {area: f"{area:,.0f} mm²" for area in seen}, "those of the picture shown"


def on_canvas(window, name, place):
    """Where a place is seen in a view, in pixels of its canvas."""
    shown = canvas(window, name)
    u, v, _ = window.views.views[name].camera().project([place], shown.width(), shown.height())[0]
    return QPoint(round(u), round(v))


def place_of(window, name, u, v):
    cloud = window.views.views[name].cloud()
    return cloud.places(np.array([v * cloud.depth.shape[1] + u]))[0]


def hover(window, name, at, shown):
    """Move the mouse to a place until the condition holds; a window that just opened may get late leave events."""
    QTest.mouseMove(canvas(window, name), at + QPoint(0, 1))
    QTest.mouseMove(canvas(window, name), at)
    return shown()


def test_a_point_under_the_mouse_marks_its_pixel_in_the_images_and_its_points_in_the_views(window, qtbot):
    QTest.keyClick(window, Qt.Key.Key_V)
    u, v = 33, 22
    canvases = [view.canvas for view in window.views.views.values()]
    for name in (PROXIMITY, TACTILE, PATCH):
        seen = partial(hover, window, name)

        def pointed(name=name, seen=seen):  # where the point is now: a view that is laid out frames its cloud again
            at = on_canvas(window, name, place_of(window, name, u, v))
            return seen(at, lambda: window.status.readout.text().startswith(f"({u}, {v})"))

        qtbot.waitUntil(pointed)
        assert all(pane.cross.isVisible() for pane in window.strip.panes.values())
        for other, view in window.views.views.items():
            np.testing.assert_allclose(view.canvas.mark, place_of(window, other, u, v), atol=2e-3)
        qtbot.waitUntil(lambda: seen(QPoint(3, 3), lambda: {canvas.mark for canvas in canvases} == {None}))  # noqa: B023  # used at once
        assert window.status.readout.text() == ""


def test_a_pixel_in_an_image_marks_its_points_in_the_views(window, qtbot):
    QTest.mouseMove(window.strip.panes["color"].view.viewport(), QPoint(5, 5))
    at = image_position(window.strip.panes["color"], 30, 20).toPoint()
    QTest.mouseMove(window.strip.panes["color"].view.viewport(), at)
    for name, view in window.views.views.items():
        qtbot.waitUntil(lambda view=view: view.canvas.mark is not None)
        np.testing.assert_allclose(view.canvas.mark, place_of(window, name, 30, 20), atol=1e-6)
    before = canvas(window, PATCH).grab().toImage()
    QTest.keyClick(window.strip, Qt.Key.Key_Right)
    np.testing.assert_allclose(
        window.views.views[PATCH].canvas.mark, place_of(window, PATCH, 31, 20), atol=1e-6, err_msg="keys point, too"
    )
    assert canvas(window, PATCH).grab().toImage() != before, "the mark is painted"
