"""The wipe: two sides in one view, the same in both back ends, and dragged with the mouse."""

import numpy as np
import pytest

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
