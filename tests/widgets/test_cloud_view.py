"""Drawing and messages of a cloud view, its framing, mouse, keys and wipe."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from PyQt6.QtCore import QPoint, QPointF, Qt
from PyQt6.QtTest import QTest

from hands import turn_wheel
from seen_clouds import (
    BLUE,
    FRONT,
    GREEN,
    RED,
    canvas_of,
    cloud_of,
    colored,
    drag,
    picture,
    pixels_of,
    red_wall,
    shown_view,
    wall,
)
from tactune.core.model.intrinsics import Intrinsics
from tactune.widgets.basics.overlays import Wipe
from tactune.widgets.clouds.cloud_canvas import CloudCanvas, SoftwareRenderer
from tactune.widgets.clouds.view_camera import ViewCamera

#: With this lens points are denser than the screen; with that of `red_wall` far apart.
DENSE = Intrinsics(width=640, height=480, fx=460.0, fy=460.0, cx=319.5, cy=239.5)


def sparse_cloud():
    """A few points of distinct colours, and where each lies in the view's frame."""
    angle = 0.2
    pose = np.eye(4)
    pose[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    pose[:3, 3] = (-0.03, 0.01, 0.02)
    colors = [(255, 0, 0), (0, 160, 0), (0, 0, 255), (200, 0, 200), (0, 150, 150), (120, 60, 0)]
    pixels = [(200, 100), (400, 120), (310, 230), (500, 400), (280, 350), (600, 50)]
    depth, index = np.zeros((480, 640), np.uint16), np.zeros((480, 640), np.uint8)
    points = []
    for row, (u, v) in enumerate(pixels):
        depth[v, u] = 240 + 20 * row
        index[v, u] = row
        z = 1.1 * 0.001 * (240 + 20 * row) - 0.02
        points.append(pose[:3, :3] @ ((u - 319.5) / 460 * z, (v - 239.5) / 460 * z, z) + pose[:3, 3])
    look = {"rays": DENSE.rays(), "index": index, "lut": colored(*colors), "depth_range_m": (0.2, 0.4)}
    cloud = cloud_of(depth, **look, pose=pose, depth_scale=1.1, depth_offset_m=-0.02)
    return cloud, colors, np.array(points)


def seen_at(camera, point, width, height):
    """Project with nothing but the definition: an eye, a target, and y pointing down."""
    direction = np.array(
        [
            np.sin(camera.azimuth) * np.cos(camera.elevation),
            -np.sin(camera.elevation),
            -np.cos(camera.azimuth) * np.cos(camera.elevation),
        ]
    )
    right = np.cross(-direction, (0.0, -1.0, 0.0))
    right /= np.linalg.norm(right)
    up = np.cross(right, -direction)
    offset = point - (np.array(camera.target) + camera.distance * direction)
    focal = min(width, height) / 2 / np.tan(camera.field_of_view / 2) / (offset @ -direction)
    return width / 2 + focal * (offset @ right), height / 2 - focal * (offset @ up)


# What is drawn, and where


@pytest.mark.parametrize("point_size", [1, 2, 3, 4])
@pytest.mark.parametrize("azimuth", [-0.5, 0.0, 0.9])
def test_points_are_drawn_where_numpy_deprojects_them(view, azimuth, point_size):
    cloud, colors, points = sparse_cloud()
    view.set_cloud(cloud)
    view.set_point_size(point_size)
    view.set_camera(ViewCamera((0.0, 0.0, 0.3), 0.8, azimuth, 0.4))
    found = cloud.points()
    np.testing.assert_allclose(points[np.lexsort(points.T)], found[np.lexsort(found.T)], atol=1e-6)
    image = picture(view)
    height, width = image.shape[:2]
    for color, point in zip(colors, points, strict=True):
        pixels = pixels_of(image, color)
        assert len(pixels) == point_size**2, f"{color} is a whole square"
        u, v = seen_at(view.camera(), point, width, height)
        assert np.abs(pixels.mean(axis=0) + 0.5 - (u, v)).max() <= 0.51, f"{color} lies within half a pixel"


@pytest.mark.parametrize("counts", [0, 65535])
def test_no_depth_is_not_drawn(view, counts):
    """At 10 micrometres a count even 65535 would lie well inside the view."""
    depth = wall(counts)
    depth[20:28, 20:40] = 30000
    red = {"index": np.zeros((48, 64), np.uint8), "lut": colored(RED), "depth_unit_m": 1e-5}
    view.set_camera(ViewCamera((0.0, 0.0, 0.3), 1.5, azimuth=0.0, elevation=0.0))
    view.set_cloud(cloud_of(depth, **red))
    drawn = len(pixels_of(picture(view), RED))
    view.set_cloud(cloud_of(np.where(depth == counts, 0, depth).astype(np.uint16), **red))
    assert drawn == len(pixels_of(picture(view), RED)) > 100
    view.set_cloud(cloud_of(np.where(depth == counts, 65534, depth).astype(np.uint16), **red))
    assert len(pixels_of(picture(view), RED)) > 2 * drawn


@pytest.mark.parametrize("nearer_first", [True, False])
@pytest.mark.parametrize("behind", [True, False])
def test_the_nearer_point_wins(view, nearer_first, behind):
    depth, index, rays = np.zeros((48, 64), np.uint16), np.zeros((48, 64), np.uint8), np.zeros((48, 64, 2), np.float32)
    depth[0, :2] = (250, 350) if nearer_first else (350, 250)
    index[0, :2] = (0, 1) if nearer_first else (1, 0)
    view.set_cloud(cloud_of(depth, index=index, rays=rays, lut=colored(RED, BLUE)))
    view.set_camera(replace(FRONT, azimuth=np.pi) if behind else FRONT)
    image = picture(view)
    visible, covered = (BLUE, RED) if behind else (RED, BLUE)
    assert len(pixels_of(image, visible)) == 4
    assert len(pixels_of(image, covered)) == 0


# What is not drawn


def dense_cloud(every=1, holes=True):
    """A stepped red and green wall of 640 x 480 pixels, denser than the screen, or every n-th row and column of it."""
    v, u = np.mgrid[:480, :640]
    depth = np.uint16(300) + 20 * ((u // 2 // 40) % 2).astype(np.uint16)
    if holes:
        depth[::20, ::20] = 0  # a pixel of those that are drawn when the cloud is thinned
    part = np.s_[::every, ::every]
    return cloud_of(
        depth[part],
        rays=DENSE.rays()[part],
        index=((u // 32 + v // 32) % 2).astype(np.uint8)[part],
        lut=colored(RED, GREEN),
        depth_range_m=(0.25, 0.35),
    )


def test_running_frames_leave_out_points_that_the_screen_cannot_tell_apart(qtbot):
    view = shown_view(qtbot, "V")
    view.set_camera(FRONT)
    view.set_cloud(dense_cloud())
    whole = picture(view)
    view.set_running(True)
    running = picture(view)
    assert 0 < (running != whole).any(axis=2).mean() < 0.04, "only edges of squares move"
    view.set_running(False)
    assert (picture(view) == whole).all(), "a frame that stands still has all its points"
    view.set_cloud(dense_cloud(every=2, holes=False))
    assert (running == picture(view)).all(), "every other row and column, and no holes from single pixels without depth"


@pytest.fixture
def drawn(monkeypatch):
    """The size of each picture that is drawn from now on."""
    sizes, render = [], SoftwareRenderer.render
    monkeypatch.setattr(
        SoftwareRenderer, "render", lambda self, cloud, look: (sizes.append(look.size), render(self, cloud, look))[1]
    )
    return sizes


def test_a_cloud_that_did_not_change_is_not_drawn_again(qtbot, drawn):
    view = shown_view(qtbot, "V")
    cloud = red_wall()
    view.set_cloud(cloud)
    view.set_camera(FRONT)
    picture(view)
    drawn.clear()
    view.set_cloud(cloud)
    view.badge.set_text("old")
    picture(view)
    assert drawn == []
    view.set_wipe(Wipe(0.5, "A", "B"))
    view.set_right(cloud)
    picture(view)
    assert drawn == [], "a cloud that both sides of a wipe share is drawn once"
    view.set_right(red_wall())
    picture(view)
    assert len(drawn) == 1


def test_a_large_view_is_drawn_at_half_its_resolution(qtbot, drawn, monkeypatch):
    monkeypatch.setattr(CloudCanvas, "devicePixelRatioF", lambda canvas: 2.0)
    view = shown_view(qtbot, "V")
    view.set_cloud(red_wall())
    for width, height, ratio in ((420, 360, 2), (1280, 1400, 1)):
        view.resize(width, height)
        picture(view)
        canvas = canvas_of(view)
        assert drawn[-1] == (ratio * canvas.width(), ratio * canvas.height())


def test_the_scene_follows_the_hand(view):
    view.set_cloud(cloud_of(wall()))
    before, seen = view.camera(), picture(view)
    drag(view, (100, 100), (140, 120), Qt.MouseButton.LeftButton)
    after = view.camera()
    assert after.azimuth < before.azimuth, "to the right, so the eye goes left"
    assert after.elevation > before.elevation
    assert (after.distance, after.target) == (before.distance, before.target)
    assert (picture(view) != seen).any()


def test_the_wheel_zooms_about_the_cursor_and_surfaces_stay_closed(view):
    view.set_cloud(red_wall())
    view.set_camera(FRONT)
    canvas = canvas_of(view)
    size = canvas.width(), canvas.height()
    point = np.array([0.05, -0.04, 0.3])
    u, v, _ = FRONT.project([point], *size)[0]
    turn_wheel(canvas, QPointF(u, v), 2, view)
    assert view.camera().distance < FRONT.distance
    np.testing.assert_allclose(view.camera().project([point], *size)[0, :2], (u, v), atol=0.01)
    assert (picture(view) == RED).all(axis=2).mean() > 0.98, "all but the axes"
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
    for depth in (wall(700) * (np.arange(64) < 8), wall(700)):  # as a patch grows while an object is pressed deeper
        view.set_cloud(cloud_of(depth, index=np.zeros((48, 64), np.uint8), lut=colored(RED)))
    grown = view.camera()
    view.fit()
    assert view.camera() == grown
    for width, height in ((420, 360), (300, 500), (700, 250)):
        view.resize(width, height)
        qtbot.waitUntil(lambda width=width: canvas_of(view).width() <= view.width() == width)
        left, top, right, bottom = extent(view, RED)
        assert min(left, top) > 0
        assert max(right - left, bottom - top) > 0.8
    view.set_camera(FRONT)
    view.resize(420, 360)
    view.set_cloud(None)
    view.set_cloud(cloud_of(wall(500)))
    assert view.camera() == FRONT


#: Width of what the wipe paints beside its line, in pixels, and height of the names above.
GRIP, NAMES = 10, 40


def green_wall():
    return cloud_of(wall(), index=np.zeros((48, 64), np.uint8), lut=colored(GREEN))


@pytest.fixture
def red_view(qtbot):
    made = shown_view(qtbot, "Patch")
    made.set_camera(FRONT)
    made.set_cloud(red_wall())
    return made


@pytest.mark.parametrize("share", [0.0, 0.35, 0.8, 1.0])
def test_each_side_is_what_its_cloud_alone_shows(red_view, share):
    red = picture(red_view)
    red_view.set_cloud(green_wall())
    green = picture(red_view)
    red_view.set_cloud(red_wall())
    red_view.set_wipe(Wipe(share, "A", "B"))
    red_view.set_right(green_wall())
    both = picture(red_view)
    line = round(share * both.shape[1])
    left, right = np.s_[NAMES:, : max(line - GRIP, 0)], np.s_[NAMES:, line + GRIP :]
    assert (both[left] == red[left]).all()
    assert (both[right] == green[right]).all()
    assert (both[NAMES:] == RED).all(axis=2).any() == (share > 0)
    assert (both[NAMES:] == GREEN).all(axis=2).any() == (share < 1)
    red_view.set_wipe(None)
    assert (picture(red_view) == red).all()
    assert red_view.canvas.right is None


def test_a_wipe_that_ends_while_it_is_dragged_does_not_stick_to_the_mouse(red_view):
    canvas, dragged, left = red_view.canvas, [], Qt.MouseButton.LeftButton
    red_view.wipeDragged.connect(dragged.append)
    red_view.set_wipe(Wipe(0.5, "A", "B"))
    QTest.mousePress(canvas, left, pos=QPoint(canvas.width() // 2, 100))
    QTest.mouseMove(canvas, QPoint(canvas.width() // 4, 100))
    assert dragged == [pytest.approx(0.25, abs=0.01)]
    red_view.set_wipe(None)
    QTest.mouseRelease(canvas, left, pos=QPoint(20, 100))
    red_view.set_wipe(Wipe(0.5, "A", "B"))
    QTest.mouseMove(canvas, QPoint(40, 100))
    assert len(dragged) == 1
