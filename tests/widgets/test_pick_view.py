"""Clicking points, dragging handles and pressing keys in a 3D view, by real events."""

from __future__ import annotations

import numpy as np
import pytest
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtTest import QTest
from pytestqt.qtbot import QtBot
from scipy.spatial.transform import Rotation

from seen_clouds import canvas_of
from tactune.widgets.clouds.cloud_data import free_cloud
from tactune.widgets.clouds.pick_view import STEP_M, STEP_RAD, PickView, Spot
from tactune.widgets.clouds.pose_handles import Handle, PoseHandles
from tactune.widgets.clouds.view_camera import ViewCamera

LEFT, MIDDLE = Qt.MouseButton.LeftButton, Qt.MouseButton.MiddleButton
NONE, CTRL, SHIFT = (
    Qt.KeyboardModifier.NoModifier,
    Qt.KeyboardModifier.ControlModifier,
    Qt.KeyboardModifier.ShiftModifier,
)
#: Two sheets, the far one seen through a gap in the near one.
NEAR = np.array([(x, y, 0.25) for x in np.linspace(-0.05, -0.01, 9) for y in np.linspace(-0.05, 0.05, 21)])
FAR = np.array([(x, y, 0.35) for x in np.linspace(-0.05, 0.05, 21) for y in np.linspace(-0.05, 0.05, 21)])
POINTS = np.concatenate([NEAR, FAR])
CAMERA = ViewCamera((0.0, 0.0, 0.3), 0.6, 0.0, 0.0)
CENTRE = (0.0, 0.0, 0.3)


@pytest.fixture
def view(qtbot: QtBot) -> PickView:
    return shown(qtbot)


def shown(qtbot: QtBot) -> PickView:
    made = PickView("Scan")
    made.resize(420, 420)
    qtbot.addWidget(made)
    with qtbot.waitExposed(made):
        made.show()
    lut = np.full((256, 4), 255, np.uint8)
    made.set_cloud(free_cloud(POINTS, np.zeros(len(POINTS), np.uint8), lut))
    made.set_camera(CAMERA)
    return made


def on_screen(view: PickView, place: object) -> QPoint:
    """The pixel of the window's canvas at which a place is drawn."""
    canvas = canvas_of(view)
    u, v, _ = view.camera().project(np.array([place]), canvas.width(), canvas.height())[0]
    return canvas.mapTo(view, QPoint(int(u), int(v)))


def drag(view: PickView, start: QPoint, end: QPoint, modifier: Qt.KeyboardModifier = NONE) -> None:
    handle = view.windowHandle()
    assert handle is not None
    QTest.mousePress(handle, LEFT, modifier, start)
    for step in range(1, 6):
        QTest.mouseMove(handle, start + (end - start) * step / 5)
    QTest.mouseRelease(handle, LEFT, modifier, end)


def click(view: PickView, at: QPoint) -> None:
    handle = view.windowHandle()
    assert handle is not None
    QTest.mouseClick(handle, LEFT, NONE, at)


def total(changes: list[np.ndarray]) -> np.ndarray:
    product = np.eye(4)
    for change in changes:
        product = change @ product
    return product


def test_a_click_takes_the_point_that_is_seen_there(qtbot: QtBot) -> None:
    view = shown(qtbot)
    clicks: list[tuple[int, tuple[float, float, float]]] = []
    view.pointClicked.connect(lambda pixel, place: clicks.append((pixel, place)))
    for index in (100, len(NEAR) + 300):
        click(view, on_screen(view, POINTS[index]))
        assert clicks[-1][0] == index
        np.testing.assert_allclose(clicks[-1][1], POINTS[index], atol=1e-6)


def test_the_nearer_of_two_points_under_the_cursor_is_taken(view: PickView) -> None:
    lut = np.full((256, 4), 255, np.uint8)
    line = np.array([(0.0, 0.0, 0.4), (0.0, 0.0, 0.2), (0.0, 0.0, 0.3)])
    view.set_cloud(free_cloud(line, np.zeros(3, np.uint8), lut))
    clicks: list[int] = []
    view.pointClicked.connect(lambda pixel, _: clicks.append(pixel))
    click(view, on_screen(view, (0, 0, 0.3)))
    view.set_camera(ViewCamera(CENTRE, 0.6, np.pi, 0.0))
    click(view, on_screen(view, (0, 0, 0.3)))
    assert clicks == [1, 0]
    view.set_camera(ViewCamera(CENTRE, 0.6, 0.0, 0.0))
    view.set_pickable(1)
    click(view, on_screen(view, (0, 0, 0.3)))
    assert clicks == [1, 0, 0], "what may not be taken is looked through"


def test_a_click_beside_everything_takes_nothing(view: PickView) -> None:
    clicks: list[int] = []
    view.pointClicked.connect(lambda pixel, _: clicks.append(pixel))
    click(view, on_screen(view, (0.08, 0.0, 0.3)))
    assert not clicks
    click(view, on_screen(view, (0, 0, 0.3)))
    assert len(clicks) == 1


def test_orbiting_is_no_click(view: PickView) -> None:
    clicks: list[int] = []
    view.pointClicked.connect(lambda pixel, _: clicks.append(pixel))
    start = on_screen(view, POINTS[100])
    drag(view, start, start + QPoint(60, 10))
    assert not clicks
    assert view.camera().azimuth < 0
    assert view.camera() != CAMERA


@pytest.mark.parametrize("camera", [CAMERA, ViewCamera(CENTRE, 0.5, -0.6, 0.5)])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_an_arrow_moves_along_its_axis_with_the_hand(view: PickView, camera: ViewCamera, axis: int) -> None:
    view.set_camera(camera)
    view.set_handles(PoseHandles(CENTRE))
    lines = PoseHandles(CENTRE).lines(camera, (canvas_of(view).width(), canvas_of(view).height()))
    handle = list(Handle)[axis]
    if handle not in lines:
        assert camera is CAMERA and axis == 2, "only an arrow that points away from the eye is left out"
        return
    changes: list[tuple[np.ndarray, int]] = []
    view.nudged.connect(lambda change, gesture: changes.append((change, gesture)))
    moved = np.zeros(3)
    moved[axis] = 0.02
    tip = canvas_of(view).mapTo(view, QPoint(*(int(value) for value in lines[handle][-1])))
    drag(view, tip, tip + on_screen(view, np.array(CENTRE) + moved) - on_screen(view, CENTRE))
    whole = total([change for change, _ in changes])
    np.testing.assert_allclose(whole[:3, 3], moved, atol=0.002)
    np.testing.assert_allclose(whole[:3, :3], np.eye(3), atol=1e-12)
    assert len({gesture for _, gesture in changes}) == 1, "one drag is one gesture"
    assert view.camera() == camera


def test_a_ring_turns_about_its_axis_with_the_hand(view: PickView) -> None:
    view.set_handles(PoseHandles(CENTRE))
    size = canvas_of(view).width(), canvas_of(view).height()
    ring = PoseHandles(CENTRE).lines(CAMERA, size)[Handle.TURN_Z]
    middle = on_screen(view, CENTRE)
    start = canvas_of(view).mapTo(view, QPoint(*(int(value) for value in ring[6])))
    radius = start - middle
    changes: list[np.ndarray] = []
    view.nudged.connect(lambda change, _: changes.append(change))
    angle = 0.3
    turned = QPoint(
        round(np.cos(angle) * radius.x() - np.sin(angle) * radius.y()),
        round(np.sin(angle) * radius.x() + np.cos(angle) * radius.y()),
    )
    drag(view, start, middle + turned)
    whole = total(changes)
    # y points down and z away from the eye, so that clockwise on the screen is a positive angle about z
    np.testing.assert_allclose(Rotation.from_matrix(whole[:3, :3]).as_rotvec(), (0, 0, angle), atol=0.04)
    np.testing.assert_allclose((whole @ [*CENTRE, 1])[:3], CENTRE, atol=1e-9)


def test_ctrl_and_drag_moves_across_the_view_and_with_shift_turns(view: PickView) -> None:
    view.set_handles(PoseHandles(CENTRE))
    changes: list[np.ndarray] = []
    view.nudged.connect(lambda change, _: changes.append(change))
    start = on_screen(view, (-0.06, 0.06, 0.3))
    drag(view, start, start + on_screen(view, (0.03, -0.01, 0.3)) - on_screen(view, CENTRE), CTRL)
    np.testing.assert_allclose(total(changes)[:3, 3], (0.03, -0.01, 0.0), atol=1e-3)
    changes.clear()
    drag(view, start, start + QPoint(40, 0), CTRL | SHIFT)
    near_side = total(changes) @ [0.0, 0.0, 0.25, 1.0]
    assert near_side[0] > 0.005, "the side that one sees goes along with the hand"
    assert view.camera() == CAMERA


@pytest.mark.parametrize(
    ("key", "moved"),
    [
        (Qt.Key.Key_Right, (STEP_M, 0, 0)),
        (Qt.Key.Key_Up, (0, -STEP_M, 0)),
        (Qt.Key.Key_PageUp, (0, 0, STEP_M)),
        (Qt.Key.Key_PageDown, (0, 0, -STEP_M)),
    ],
)
def test_ctrl_and_keys_move_by_steps(view: PickView, key: Qt.Key, moved: tuple[float, ...]) -> None:
    changes: list[np.ndarray] = []
    view.nudged.connect(lambda change, _: changes.append(change))
    view.setFocus()
    QTest.keyClick(view, key, CTRL)
    assert not changes, "there is nothing to move yet"
    view.set_handles(PoseHandles(CENTRE))
    QTest.keyClick(view, key, CTRL)
    np.testing.assert_allclose(changes[0][:3, 3], moved, atol=1e-12)
    QTest.keyClick(view, Qt.Key.Key_Right, CTRL | SHIFT)
    vector = Rotation.from_matrix(changes[1][:3, :3]).as_rotvec()
    np.testing.assert_allclose(vector, (0, -STEP_RAD, 0), atol=1e-12)
    assert view.camera() == CAMERA


def test_marks_stand_where_they_were_set(qtbot: QtBot) -> None:
    view = shown(qtbot)
    before = canvas_of(view).grab().toImage()
    view.set_spots([Spot((0.04, 0.0, 0.35), "7")])
    at = on_screen(view, (0.04, 0.0, 0.35)) - canvas_of(view).pos()
    after = canvas_of(view).grab().toImage()
    changed = [
        (x, y) for x in range(after.width()) for y in range(after.height()) if before.pixel(x, y) != after.pixel(x, y)
    ]
    assert len(changed) > 50
    assert np.abs(np.array(changed) - (at.x(), at.y())).max() < 40
