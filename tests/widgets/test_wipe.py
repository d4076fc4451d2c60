"""The wipe: two sides in one view, the same in both back ends, and dragged with the mouse."""

import numpy as np
import pytest
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtTest import QTest

from seen_clouds import FRONT, GREEN, RED, cloud_of, colored, picture, red_wall, shown_view, wall
from tactune.widgets.basics.overlays import Wipe

#: Width of what the wipe paints beside its line, in pixels, and height of the names above.
GRIP, NAMES = 10, 40


def green_wall():
    return cloud_of(wall(), index=np.zeros((48, 64), np.uint8), lut=colored(GREEN))


@pytest.fixture
def view(qtbot):
    made = shown_view(qtbot, "Patch")
    made.set_camera(FRONT)
    made.set_cloud(red_wall())
    return made


@pytest.mark.parametrize("share", [0.0, 0.35, 0.8, 1.0])
def test_each_side_is_what_its_cloud_alone_shows(view, share):
    red = picture(view)
    view.set_cloud(green_wall())
    green = picture(view)
    view.set_cloud(red_wall())
    view.set_wipe(Wipe(share, "A", "B"))
    view.set_right(green_wall())
    both = picture(view)
    line = round(share * both.shape[1])
    left, right = np.s_[NAMES:, : max(line - GRIP, 0)], np.s_[NAMES:, line + GRIP :]
    assert (both[left] == red[left]).all()
    assert (both[right] == green[right]).all()
    assert (both[NAMES:] == RED).all(axis=2).any() == (share > 0)
    assert (both[NAMES:] == GREEN).all(axis=2).any() == (share < 1)
    view.set_wipe(None)
    assert (picture(view) == red).all()
    assert view.canvas.right is None


def test_a_wipe_that_ends_while_it_is_dragged_does_not_stick_to_the_mouse(view):
    canvas, dragged, left = view.canvas, [], Qt.MouseButton.LeftButton
    view.wipeDragged.connect(dragged.append)
    view.set_wipe(Wipe(0.5, "A", "B"))
    QTest.mousePress(canvas, left, pos=QPoint(canvas.width() // 2, 100))
    QTest.mouseMove(canvas, QPoint(canvas.width() // 4, 100))
    assert dragged == [pytest.approx(0.25, abs=0.01)]
    view.set_wipe(None)
    QTest.mouseRelease(canvas, left, pos=QPoint(20, 100))
    view.set_wipe(Wipe(0.5, "A", "B"))
    QTest.mouseMove(canvas, QPoint(40, 100))
    assert len(dragged) == 1
