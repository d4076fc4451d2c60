"""The wipe: two sides in one view, the same in both back ends, and dragged with the mouse."""

import numpy as np
import pytest
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtGui import QImage
from PyQt6.QtTest import QTest

from seen_clouds import FRONT, GREEN, RED, cloud_of, colored, picture, red_wall, shown, wall
from tactune.widgets.basics.overlays import Wipe
from tactune.widgets.clouds.cloud_view import CloudView
from tactune.widgets.images.image_strip import ImageStrip, RenderedStrip

#: Width of what the wipe paints beside its line, in pixels, and height of the names above.
GRIP, NAMES = 10, 40


def green_wall():
    return cloud_of(wall(), index=np.zeros((48, 64), np.uint8), lut=colored(GREEN))


@pytest.fixture
def view(qtbot):
    made = shown(qtbot, CloudView("Patch"))
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
    assert view.right_cloud() is None


def flat(rgb):
    red, green, blue = rgb
    pixels = np.full((48, 64, 4), (blue, green, red, 255), np.uint8)
    return RenderedStrip((pixels,) * 4, (64, 48), 1, (0.2, 0.3), 0.02, 0.1)


def rgb_at(pane, place):
    image = pane.view.viewport().grab().toImage().convertToFormat(QImage.Format.Format_RGB888)
    color = image.pixelColor(place)
    return color.red(), color.green(), color.blue()


def test_all_images_are_divided_at_the_same_share_also_when_zoomed(qtbot):
    strip = ImageStrip()
    strip.resize(1000, 260)
    qtbot.addWidget(strip)
    with qtbot.waitExposed(strip):
        strip.show()
    strip.set_images(flat(RED), flat(GREEN))
    strip.set_wipe(Wipe(0.25, "A", "B"))
    for zoomed in (False, True):
        if zoomed:
            strip.setFocus()
            QTest.keyClick(strip, Qt.Key.Key_Plus)
        for pane in strip.panes.values():
            viewport = pane.view.viewport()
            middle = viewport.height() // 2
            assert rgb_at(pane, QPoint(viewport.width() // 4 - 8, middle)) == RED
            assert rgb_at(pane, QPoint(viewport.width() // 4 + 8, middle)) == GREEN
    assert strip.right_of_wipe(40)
    assert not strip.right_of_wipe(2)
    strip.set_wipe(None)
    assert rgb_at(pane, QPoint(viewport.width() // 2 + 8, middle)) == RED
