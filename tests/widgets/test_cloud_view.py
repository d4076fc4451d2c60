"""The same behaviour from both back ends: software anywhere, OpenGL where there is a display."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import pytest
from PyQt6.QtCore import QPoint, QPointF, Qt
from PyQt6.QtGui import QColor, QImage, QPalette, QShortcut, QWheelEvent
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication, QHBoxLayout, QLabel, QWidget
from pytestqt.qtbot import QtBot

from tactune.core.intrinsics import Intrinsics
from tactune.widgets import gl_backend
from tactune.widgets.cloud_data import DepthCloud
from tactune.widgets.cloud_header import CloudHeader, short_count
from tactune.widgets.cloud_view import BackendChoice, CloudView, link_cameras
from tactune.widgets.colormaps import depth_lut
from tactune.widgets.gl_backend import GLCanvas, GLError, GLProbe, GLRenderer
from tactune.widgets.view_camera import ViewCamera

LENS = Intrinsics(width=64, height=48, fx=46.0, fy=46.0, cx=31.5, cy=23.5)
RAYS = LENS.rays()
RED, GREEN, BLUE = (255, 0, 0), (0, 255, 0), (0, 0, 255)
FRONT = ViewCamera((0.0, 0.0, 0.3), 0.6, azimuth=0.0, elevation=0.0)


@pytest.fixture
def opengl(qapp: QApplication) -> BackendChoice:
    """The OpenGL back end, emulated or not, where there is one."""
    probe = gl_backend.probe_opengl()
    if not probe.usable:
        pytest.skip(f"no OpenGL context: {probe.reason}")
    return "opengl"


@pytest.fixture(params=["software", pytest.param("opengl", marks=pytest.mark.gl)])
def backend(request: pytest.FixtureRequest) -> BackendChoice:
    if request.param == "opengl":
        request.getfixturevalue("opengl")
    choice: BackendChoice = request.param
    return choice


@pytest.fixture
def view(backend: BackendChoice, qtbot: QtBot) -> CloudView:
    return shown(qtbot, CloudView("Proximity", backend))


def shown(qtbot: QtBot, widget: CloudView) -> CloudView:
    palette = widget.palette()
    palette.setColor(QPalette.ColorRole.Base, QColor("white"))
    widget.setPalette(palette)
    widget.resize(420, 360)
    qtbot.addWidget(widget)
    with qtbot.waitExposed(widget):
        widget.show()
    return widget


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


@dataclass
class Sparse:
    """A few points of distinct colours, and where each lies in the view's frame."""

    cloud: DepthCloud
    colors: list[tuple[int, int, int]]
    points: npt.NDArray[np.float64]


def sparse_cloud() -> Sparse:
    angle = 0.2
    pose = np.eye(4)
    pose[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    pose[:3, 3] = (-0.03, 0.01, 0.02)
    colors = [(255, 0, 0), (0, 160, 0), (0, 0, 255), (200, 0, 200), (0, 150, 150), (120, 60, 0)]
    pixels = [(20, 10), (40, 12), (31, 23), (50, 40), (28, 35), (60, 5)]
    depth, index = np.zeros((48, 64), np.uint16), np.zeros((48, 64), np.uint8)
    points = []
    for row, (u, v) in enumerate(pixels):
        depth[v, u] = 240 + 20 * row
        index[v, u] = row
        z = 1.1 * 0.001 * (240 + 20 * row) - 0.02
        points.append(pose[:3, :3] @ ((u - 31.5) / 46 * z, (v - 23.5) / 46 * z, z) + pose[:3, 3])
    cloud = cloud_of(depth, index=index, lut=colored(*colors), pose=pose, depth_scale=1.1, depth_offset_m=-0.02)
    return Sparse(cloud, colors, np.array(points))


def seen_at(camera: ViewCamera, point: npt.NDArray[np.float64], width: int, height: int) -> tuple[float, float]:
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
def test_points_are_drawn_where_numpy_deprojects_them(view: CloudView, azimuth: float, point_size: int) -> None:
    sparse = sparse_cloud()
    view.set_cloud(sparse.cloud)
    view.set_point_size(point_size)
    view.set_camera(ViewCamera((0.0, 0.0, 0.3), 0.8, azimuth, 0.4))
    np.testing.assert_allclose(
        sparse.points[np.lexsort(sparse.points.T)],
        sparse.cloud.points()[np.lexsort(sparse.cloud.points().T)],
        atol=1e-6,
    )
    image = picture(view)
    height, width = image.shape[:2]
    for color, point in zip(sparse.colors, sparse.points, strict=True):
        pixels = pixels_of(image, color)
        assert len(pixels) == point_size**2, f"{color} is a whole square"
        u, v = seen_at(view.camera(), point, width, height)
        assert np.abs(pixels.mean(axis=0) + 0.5 - (u, v)).max() <= 0.51, f"{color} lies within half a pixel"


@pytest.mark.gl
@pytest.mark.usefixtures("opengl")
def test_both_back_ends_draw_the_same_picture(qtbot: QtBot) -> None:
    radius = np.hypot(RAYS[..., 0], RAYS[..., 1])
    depth = (320 - 300 * radius**2).astype(np.uint16)
    depth[10:14, 10:20] = 0
    for cloud in (
        cloud_of(depth, depth_range_m=(0.2, 0.32)),
        cloud_of(depth, index=(depth % 5).astype(np.uint8), lut=colored(RED, GREEN, BLUE)),
    ):
        images = []
        for backend in ("software", "opengl"):
            view = shown(qtbot, CloudView("Same", backend))  # type: ignore[arg-type]
            assert view.backend_name == backend
            view.set_cloud(cloud)
            view.set_point_size(3)
            images.append(picture(view).astype(int))
        difference = np.abs(images[0] - images[1]).max(axis=2)
        assert (images[0] != 255).any(axis=2).mean() > 0.1, "the cloud is there"
        assert (difference > 8).mean() < 0.005


@pytest.mark.parametrize("counts", [0, 65535])
def test_no_depth_is_not_drawn(view: CloudView, counts: int) -> None:
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


def test_every_row_of_the_table_reaches_its_points(view: CloudView) -> None:
    lut = np.full((256, 4), 255, np.uint8)
    lut[:, 0], lut[:, 1], lut[:, 2] = np.arange(256), 255 - np.arange(256), 77
    index = np.kron(np.arange(256, dtype=np.uint8).reshape(16, 16), np.ones((3, 4), np.uint8))
    view.set_cloud(cloud_of(wall(), index=index, lut=lut))
    view.set_camera(FRONT)
    view.set_point_size(3)
    image = picture(view)
    assert [row for row in range(256) if len(pixels_of(image, (row, 255 - row, 77))) == 0] == []


def test_hidden_colours_are_not_drawn(view: CloudView) -> None:
    index = np.zeros((48, 64), np.uint8)
    index[:, 32:] = 1
    lut = colored(RED, GREEN)
    view.set_cloud(cloud_of(wall(), index=index, lut=lut))
    view.set_camera(FRONT)
    before = picture(view)
    assert len(pixels_of(before, RED)) > 100
    assert len(pixels_of(before, GREEN)) > 100
    lut = lut.copy()
    lut[1, 3] = 0
    view.set_cloud(cloud_of(wall(), index=index, lut=lut))
    after = picture(view)
    assert len(pixels_of(after, GREEN)) == 0
    assert len(pixels_of(after, RED)) == len(pixels_of(before, RED))
    where = pixels_of(before, GREEN)
    assert (after[where[:, 1], where[:, 0]] == 255).all(), "the background is seen instead"
    assert view.point_count() == 48 * 32


@pytest.mark.parametrize("nearer_first", [True, False])
@pytest.mark.parametrize("behind", [True, False])
def test_the_nearer_point_wins(view: CloudView, nearer_first: bool, behind: bool) -> None:
    depth, index, rays = np.zeros((48, 64), np.uint16), np.zeros((48, 64), np.uint8), np.zeros((48, 64, 2), np.float32)
    depth[0, :2] = (250, 350) if nearer_first else (350, 250)
    index[0, :2] = (0, 1) if nearer_first else (1, 0)
    view.set_cloud(cloud_of(depth, index=index, rays=rays, lut=colored(RED, BLUE)))
    view.set_camera(replace(FRONT, azimuth=np.pi) if behind else FRONT)
    image = picture(view)
    visible, covered = (BLUE, RED) if behind else (RED, BLUE)
    assert len(pixels_of(image, visible)) == 4
    assert len(pixels_of(image, covered)) == 0


def test_points_behind_the_eye_are_not_drawn(view: CloudView) -> None:
    depth = np.zeros((48, 64), np.uint16)
    depth[24, 32] = 300
    view.set_cloud(cloud_of(depth, index=np.zeros((48, 64), np.uint8), lut=colored(RED)))
    view.set_camera(ViewCamera((0.0, 0.0, 0.9), 0.3, 0.0, 0.0))
    assert len(pixels_of(picture(view), RED)) == 0
    view.set_camera(ViewCamera((0.0, 0.0, 0.35), 0.3, 0.0, 0.0))
    assert len(pixels_of(picture(view), RED)) == 4


def test_every_new_frame_is_drawn(view: CloudView) -> None:
    index = np.zeros((48, 64), np.uint8)
    view.set_camera(FRONT)
    for color in (RED, GREEN, BLUE):
        view.set_cloud(cloud_of(wall(), index=index, lut=colored(color)))
        assert len(pixels_of(picture(view), color)) > 1000
    view.set_cloud(cloud_of(wall(), index=index + 1, lut=colored(color)))
    assert len(pixels_of(picture(view), color)) == 0
    smaller = Intrinsics(width=32, height=24, fx=23.0, fy=23.0, cx=15.5, cy=11.5)
    view.set_cloud(cloud_of(np.full((24, 32), 300, np.uint16), rays=smaller.rays(), depth_range_m=(0.3, 0.4)))
    near = tuple(int(channel) for channel in depth_lut()[0, :3])
    assert len(pixels_of(picture(view), near)) >= 24 * 32  # type: ignore[arg-type]
    view.set_cloud(None)
    assert len(pixels_of(picture(view), near)) == 0  # type: ignore[arg-type]


def test_the_background_follows_the_theme(view: CloudView) -> None:
    palette = view.palette()
    palette.setColor(QPalette.ColorRole.Base, QColor(30, 32, 34))
    view.setPalette(palette)
    assert picture(view)[2, 2].tolist() == [30, 32, 34]


# Words around it


@pytest.mark.parametrize(
    ("count", "short"),
    [
        *[(0, "0"), (999, "999"), (1000, "1.0k"), (9949, "9.9k"), (9951, "10k"), (222_102, "222k")],
        *[(999_499, "999k"), (999_500, "1.0M"), (1_310_720, "1.3M"), (12_345_678, "12M")],
    ],
)
def test_short_count(count: int, short: str) -> None:
    assert short_count(count) == short


@pytest.mark.parametrize("width", [60, 90, 130, 160, 200, 260, 420])
def test_the_header_never_cuts_the_count(qtbot: QtBot, width: int) -> None:
    header = CloudHeader("Contact patch")
    qtbot.addWidget(header)
    header.resize(width, header.sizeHint().height())
    header.set_count(222_102)
    title, count = header.findChild(QLabel, "title"), header.findChild(QLabel, "count")
    assert title is not None and count is not None
    wide = width >= 260
    assert count.text() == ("222,102 points" if wide else "222k")
    assert count.accessibleName() == "222,102 points"
    assert count.toolTip() == ("" if wide else "222,102 points")
    assert count.width() >= count.sizeHint().width()
    assert not title.geometry().intersects(count.geometry())
    assert header.rect().contains(count.geometry())
    assert title.geometry().left() >= 0


def test_title_count_and_message(view: CloudView) -> None:
    count = view.findChild(QLabel, "count")
    assert count is not None
    view.set_message("No contact yet: press the object")
    assert (count.text(), view.message()) == ("0 points", "No contact yet: press the object")
    with_message = picture(view)
    view.set_cloud(cloud_of(wall()))
    assert (count.text(), view.message()) == ("3,072 points", "")
    view.set_cloud(cloud_of(wall(), count=1))
    assert count.text() == "1 point"
    view.set_cloud(cloud_of(wall(), count=0))
    assert (count.text(), view.message()) == ("0 points", "No contact yet: press the object")
    view.set_cloud(None)
    view.set_message("")
    height, width = with_message.shape[:2]
    middle = np.s_[height // 2 - 20 : height // 2 + 20, width // 4 : 3 * width // 4]
    assert (with_message[middle] != picture(view)[middle]).any(), "the message is painted in the middle"


def test_the_legend_shows_what_fits_and_lists_all(qtbot: QtBot) -> None:
    view = shown(qtbot, CloudView("Legend", "software"))
    entries = [(f"reason number {i}", QColor(20 * i, 0, 0)) for i in range(9)]
    view.set_legend(entries)
    assert view.legend() == entries
    line = view._legend
    assert 1 <= line.fitting() < 9
    assert all(text in line.toolTip() for text, _ in entries)
    view.set_legend(entries[:1])
    assert line.fitting() == 1


def test_the_tooltip_explains_mouse_and_keys(qtbot: QtBot) -> None:
    tip = shown(qtbot, CloudView("Help", "software")).toolTip()
    for word in ("Drag", "Shift", "wheel", "double click", "arrows", "R", "T", "S"):
        assert word in tip


# Steering


def drag(view: CloudView, start: tuple[int, int], end: tuple[int, int], button: Qt.MouseButton, **keys: object) -> None:
    """Press, move and release through the window system."""
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


def three_linked(qtbot: QtBot, backend: BackendChoice) -> list[CloudView]:
    window = QWidget()
    layout = QHBoxLayout(window)
    views = [CloudView(title, backend) for title in ("Proximity", "Tactile", "Contact patch")]
    for view in views:
        layout.addWidget(view)
    link_cameras(views)
    window.resize(900, 360)
    qtbot.addWidget(window)
    with qtbot.waitExposed(window):
        window.show()
    views[0]._keep_window = window  # type: ignore[attr-defined]
    return views


def test_orbiting_one_view_turns_all_and_each_says_so_once(qtbot: QtBot, backend: BackendChoice) -> None:
    views = three_linked(qtbot, backend)
    for view in views:
        view.set_cloud(cloud_of(wall()))
    for dragged in views:
        heard: list[list[ViewCamera]] = [[], [], []]
        for view, cameras in zip(views, heard, strict=True):
            view.cameraChanged.connect(cameras.append)
        before = dragged.camera()
        pictures = [picture(view) for view in views]
        drag(dragged, (100, 100), (140, 120), Qt.MouseButton.LeftButton)
        after = dragged.camera()
        assert after.azimuth < before.azimuth, "the scene follows the hand to the right, so the eye goes left"
        assert after.elevation > before.elevation
        assert (after.distance, after.target) == (before.distance, before.target)
        assert [view.camera() for view in views] == [after] * 3
        assert heard[0] == heard[1] == heard[2]
        assert 1 <= len(heard[0]) <= 2, "one signal for each movement of the mouse, and no echo"
        for view, old in zip(views, pictures, strict=True):
            assert (picture(view) != old).any()
            view.cameraChanged.disconnect()


@pytest.mark.parametrize("way", ["middle", "shift"])
def test_panning_moves_the_scene_with_the_hand(view: CloudView, way: str) -> None:
    view.set_camera(FRONT)
    button = Qt.MouseButton.MiddleButton if way == "middle" else Qt.MouseButton.LeftButton
    shift = Qt.KeyboardModifier.NoModifier if way == "middle" else Qt.KeyboardModifier.ShiftModifier
    drag(view, (100, 100), (130, 90), button, modifier=shift)
    canvas = canvas_of(view)
    u, v, _ = view.camera().project([FRONT.target], canvas.width(), canvas.height())[0]
    assert (u - canvas.width() / 2, v - canvas.height() / 2) == pytest.approx((30, -10), abs=0.01)
    assert view.camera().azimuth == 0


def test_moving_without_a_button_does_nothing(view: CloudView) -> None:
    drag(view, (100, 100), (140, 100), Qt.MouseButton.LeftButton)
    camera = view.camera()
    drag(view, (100, 100), (140, 100), Qt.MouseButton.RightButton)
    handle = view.windowHandle()
    assert handle is not None
    QTest.mouseMove(handle, QPoint(200, 150))
    assert view.camera() == camera


def turn_wheel(view: CloudView, at: QPointF, steps: float) -> None:
    """Turn the wheel over a place of the canvas. Qt passes only the window system's own wheel events up."""
    canvas = canvas_of(view)
    event = QWheelEvent(
        canvas.mapTo(view, at), canvas.mapToGlobal(at), QPoint(), QPoint(0, round(120 * steps)),
        Qt.MouseButton.NoButton, Qt.KeyboardModifier.NoModifier, Qt.ScrollPhase.NoScrollPhase, False,
    )  # fmt: skip
    QApplication.sendEvent(view, event)


def test_the_wheel_zooms_about_the_cursor(view: CloudView) -> None:
    view.set_camera(FRONT)
    canvas = canvas_of(view)
    size = canvas.width(), canvas.height()
    point = np.array([0.05, -0.04, 0.3])
    u, v, _ = FRONT.project([point], *size)[0]
    turn_wheel(view, QPointF(u, v), 2)
    assert view.camera().distance < FRONT.distance
    np.testing.assert_allclose(view.camera().project([point], *size)[0, :2], (u, v), atol=0.01)
    turn_wheel(view, QPointF(u, v), -2)
    assert view.camera().distance == pytest.approx(FRONT.distance)


def test_keys_orbit_zoom_and_choose_viewpoints(view: CloudView) -> None:
    view.set_cloud(cloud_of(wall()))
    view.setFocus()
    start = view.camera()

    def after(key: Qt.Key) -> ViewCamera:
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


def test_focused_keys_win_over_shortcuts_of_the_application(qtbot: QtBot) -> None:
    view = shown(qtbot, CloudView("Keys", "software"))
    pressed: list[str] = []
    for key in ("T", "Ctrl+T"):
        shortcut = QShortcut(key, view)
        shortcut.setContext(Qt.ShortcutContext.WindowShortcut)
        shortcut.activated.connect(lambda key=key: pressed.append(key))
    view.activateWindow()
    view.setFocus()
    QTest.keyClick(view, Qt.Key.Key_T)
    assert view.camera().elevation == pytest.approx(np.pi / 2)
    assert pressed == []
    QTest.keyClick(view, Qt.Key.Key_T, Qt.KeyboardModifier.ControlModifier)
    assert pressed == ["Ctrl+T"]


def test_a_double_click_resets(view: CloudView) -> None:
    view.set_cloud(cloud_of(wall()))
    framed = view.camera()
    drag(view, (100, 100), (180, 140), Qt.MouseButton.LeftButton)
    turn_wheel(view, QPointF(50, 50), 5)
    assert view.camera() != framed
    QTest.mouseDClick(canvas_of(view), Qt.MouseButton.LeftButton)
    assert view.camera() == framed


def test_the_focus_ring_is_seen(qtbot: QtBot) -> None:
    view = shown(qtbot, CloudView("Focus", "software"))
    view.clearFocus()
    plain = view.grab().toImage()
    drag(view, (60, 60), (60, 60), Qt.MouseButton.LeftButton)
    assert view.hasFocus(), "a click gives focus"
    ring = view.grab().toImage()
    corner = canvas_of(view).geometry().topLeft() - QPoint(1, -40)
    assert ring.pixelColor(corner) != plain.pixelColor(corner)
    assert ring.pixelColor(corner) == view.palette().color(QPalette.ColorRole.Highlight)


# Framing


def extent(view: CloudView, color: tuple[int, int, int]) -> npt.NDArray[np.float64]:
    """Left, top, right and bottom of a colour as shares of the canvas."""
    image = picture(view)
    pixels = pixels_of(image, color)
    size = np.array(image.shape[1::-1])
    return np.concatenate([pixels.min(axis=0), pixels.max(axis=0) + 1]) / np.tile(size, 2)


def test_the_first_cloud_is_framed_and_stays_so_when_resized_until_somebody_steers(
    view: CloudView, qtbot: QtBot
) -> None:
    view.set_cloud(cloud_of(wall(700), index=np.zeros((48, 64), np.uint8), lut=colored(RED)))
    for width, height in ((420, 360), (300, 500), (700, 250)):
        view.resize(width, height)
        qtbot.wait(50)
        left, top, right, bottom = extent(view, RED)
        assert min(left, top) >= 0
        assert max(right, bottom) <= 1
        assert max(right - left, bottom - top) > 0.8
    view.set_camera(FRONT)
    view.resize(420, 360)
    qtbot.wait(50)
    view.set_cloud(None)
    view.set_cloud(cloud_of(wall(500)))
    assert view.camera() == FRONT


def test_a_new_frame_does_not_move_the_camera(view: CloudView) -> None:
    view.set_cloud(cloud_of(wall(300)))
    camera = view.camera()
    view.set_cloud(cloud_of(wall(500)))
    assert view.camera() == camera
    view.fit()
    assert view.camera() != camera


def test_linked_views_frame_all_their_clouds(qtbot: QtBot) -> None:
    views = three_linked(qtbot, "software")
    left, right = wall(), wall()
    left[:, 40:] = 0
    right[:, :24] = 0
    views[0].set_cloud(cloud_of(left))
    alone = views[0].camera()
    views[1].set_cloud(cloud_of(right))
    assert views[0].camera() == views[1].camera() == views[2].camera()
    assert views[0].camera().distance > alone.distance


def test_an_unknown_viewpoint_is_refused(qtbot: QtBot) -> None:
    with pytest.raises(ValueError, match="choose one of reset, top, side"):
        shown(qtbot, CloudView("V", "software")).look_from("bottom")  # type: ignore[arg-type]


# Choosing and losing the back end


@pytest.mark.parametrize("choice", ["auto", "opengl"])
def test_without_opengl_the_software_draws_and_says_why(
    qtbot: QtBot, monkeypatch: pytest.MonkeyPatch, choice: BackendChoice
) -> None:
    monkeypatch.setattr(gl_backend, "probe_opengl", lambda: GLProbe(False, False, "", "no OpenGL on this display"))
    view = shown(qtbot, CloudView("V", choice))
    assert view.backend_name == "software"
    assert view.backend_reason == "Software view: no OpenGL on this display"
    assert view.backend_reason in view.toolTip()
    view.set_camera(FRONT)
    corner = picture(view)[-24:, 150:]
    view._scene.note = ""
    canvas_of(view).update()
    assert (corner != picture(view)[-24:, 150:]).any(), "the reason is written on the view"


def test_asking_for_software_needs_no_reason(qtbot: QtBot) -> None:
    view = shown(qtbot, CloudView("V", "software"))
    assert (view.backend_name, view.backend_reason) == ("software", "")


def test_emulated_opengl_is_used_only_when_insisted_on(qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> None:
    probe = GLProbe(True, True, "llvmpipe (LLVM 15)", "OpenGL is only emulated here (llvmpipe)")
    monkeypatch.setattr(gl_backend, "probe_opengl", lambda: probe)
    view = CloudView("V", "auto")
    qtbot.addWidget(view)
    assert view.backend_name == "software"
    assert "only emulated here (llvmpipe)" in view.backend_reason
    insisted = CloudView("V", "opengl")
    qtbot.addWidget(insisted)
    assert (insisted.backend_name, insisted.backend_reason) == ("opengl", "")


def test_real_opengl_is_taken_by_itself(qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gl_backend, "probe_opengl", lambda: GLProbe(True, False, "A real one", ""))
    view = CloudView("V", "auto")
    qtbot.addWidget(view)
    assert (view.backend_name, view.backend_reason) == ("opengl", "")


def falls_back(qtbot: QtBot, view: CloudView, words: str) -> None:
    camera = view.camera()
    qtbot.waitUntil(lambda: view.backend_name == "software")
    assert words in view.backend_reason
    assert view.camera() == camera
    assert len(pixels_of(picture(view), RED)) > 1000
    drag(view, (100, 100), (140, 120), Qt.MouseButton.LeftButton)
    assert view.camera() != camera, "it can still be steered"
    qtbot.waitUntil(lambda: view.findChildren(GLCanvas) == [])


def red_wall() -> DepthCloud:
    return cloud_of(wall(), index=np.zeros((48, 64), np.uint8), lut=colored(RED))


def test_it_goes_on_in_software_where_the_window_gets_no_context(qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> None:
    if gl_backend.probe_opengl().usable:
        pytest.skip("this display has OpenGL, so a context can be made")
    monkeypatch.setattr(gl_backend, "probe_opengl", lambda: GLProbe(True, False, "A real one", ""))
    view = CloudView("V", "auto")
    view.set_cloud(red_wall())
    view.set_camera(FRONT)
    falls_back(qtbot, shown(qtbot, view), "no OpenGL context could be made")


@pytest.mark.gl
@pytest.mark.parametrize("moment", ["__init__", "render"])
def test_it_goes_on_in_software_when_opengl_fails(
    qtbot: QtBot, opengl: BackendChoice, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    view = CloudView("V", opengl)
    view.set_cloud(red_wall())
    view.set_camera(FRONT)
    if moment == "render":
        shown(qtbot, view)
        assert len(pixels_of(picture(view), RED)) > 1000

    def fail(*_: object) -> None:
        raise GLError("the graphics driver was reset")

    monkeypatch.setattr(GLRenderer, moment, fail)
    if moment == "__init__":
        shown(qtbot, view)
    else:
        canvas_of(view).update()
    assert view.isVisible()
    falls_back(qtbot, view, "the graphics driver was reset")


def test_it_survives_moving_to_another_window(
    view: CloudView, backend: BackendChoice, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    freed: list[GLRenderer] = []
    destroy = GLRenderer.destroy
    monkeypatch.setattr(GLRenderer, "destroy", lambda renderer: (freed.append(renderer), destroy(renderer)))
    view.set_cloud(red_wall())
    view.set_camera(FRONT)
    before = len(pixels_of(picture(view), RED))
    other = QWidget()
    layout = QHBoxLayout(other)
    layout.addWidget(view)
    qtbot.addWidget(other)
    other.resize(500, 420)
    with qtbot.waitExposed(other):
        other.show()
    assert view.backend_name == backend
    assert len(pixels_of(picture(view), RED)) > before / 2
    assert len(freed) == (backend == "opengl"), "graphics memory of the former window is freed"
    view.setParent(None)
