import numpy as np
import pytest
from PyQt6.QtCore import QPoint, QPointF, QRectF, Qt
from PyQt6.QtTest import QTest

from hands import image_position, shown, turn_wheel
from tactune.widgets.images.image_strip import PANES, ImageStrip
from tactune.widgets.images.strip_render import RenderedStrip, color_pane, depth_pane, difference_pane, stride_for

LEFT = Qt.MouseButton.LeftButton
NONE = Qt.KeyboardModifier.NoModifier
HEIGHT, WIDTH = 480, 640


def rendered(height=HEIGHT, width=WIDTH, hint=0):
    stride = stride_for(width, hint)
    v, u = np.mgrid[:height:stride, :width:stride]
    depth = (0.2 + 0.0001 * u + 0.0001 * v).astype(np.float32)
    color = np.dstack([u % 256, v % 256, np.zeros_like(u)]).astype(np.uint8)
    panes = {"color": color_pane(color, None), "difference": difference_pane(depth, depth, 0.03)}
    panes |= {name: depth_pane(depth, (0.2, 0.31)) for name in ("proximity", "tactile")}
    return RenderedStrip(panes, (width, height), stride, (0.2, 0.31), 0.03)


@pytest.fixture
def strip(qtbot, qapp):
    widget = shown(qtbot, ImageStrip(), 1600, 800)
    widget.set_images(rendered(hint=widget.width_hint()))
    widget.reset_view()
    qapp.processEvents()
    return widget


def viewport(strip, pane):
    return strip.panes[pane].view.viewport()


def at(strip, pane, u, v):
    return image_position(strip.panes[pane], u, v).toPoint()


def zoom_in(strip, pane, u, v, notches=10):
    for _ in range(notches):
        turn_wheel(viewport(strip, pane), QPointF(at(strip, pane, u, v)), 1)


def seen_rect(strip, pane):
    rect = strip.panes[pane].box.viewRect()
    return rect.left(), rect.top(), rect.width(), rect.height()


@pytest.mark.parametrize("pane", ["color", "difference"])
def test_hover_and_click_tell_the_exact_pixel_in_every_pane(strip, pane):
    zoom_in(strip, pane, 320, 240)
    found = []
    strip.hovered.connect(lambda u, v: found.append((u, v)))
    expected = [(u, v) for u, v in ((320, 240), (321, 240), (318, 243), (323, 238))]
    for u, v in expected:
        QTest.mouseMove(viewport(strip, pane), at(strip, pane, u, v))
    assert found == expected
    clicks = []
    strip.clicked.connect(lambda *click: clicks.append(click))
    QTest.mouseClick(viewport(strip, pane), LEFT, Qt.KeyboardModifier.ShiftModifier, at(strip, pane, 322, 239))
    assert clicks == [(pane, 322, 239, Qt.KeyboardModifier.ShiftModifier)]


def test_all_panes_zoom_and_pan_together_and_0_shows_them_whole(strip, qapp):
    whole = {pane: seen_rect(strip, pane) for pane in PANES}
    zoom_in(strip, "proximity", 200, 100, notches=8)
    zoomed = seen_rect(strip, "proximity")
    assert zoomed[2] < 0.9 * whole["proximity"][2]
    for pane in PANES:
        assert seen_rect(strip, pane) == pytest.approx(zoomed, abs=0.5)
    start = at(strip, "difference", 200, 100)
    QTest.mouseMove(viewport(strip, "difference"), start)
    QTest.mousePress(viewport(strip, "difference"), LEFT, pos=start)
    for step in (10, 20, 30):
        QTest.mouseMove(viewport(strip, "difference"), start + QPoint(step, 0))
    QTest.mouseRelease(viewport(strip, "difference"), LEFT, pos=start + QPoint(30, 0))
    qapp.processEvents()
    panned = seen_rect(strip, "difference")
    assert panned[0] < zoomed[0] - 1
    for pane in PANES:
        assert seen_rect(strip, pane) == pytest.approx(panned, abs=0.5)
    QTest.keyClick(strip, Qt.Key.Key_0)
    qapp.processEvents()
    assert {pane: seen_rect(strip, pane) for pane in PANES} == whole


@pytest.mark.parametrize("hint", [0, 300])
def test_the_pixels_on_the_screen_are_those_of_the_image(strip, qapp, hint):
    strip.set_images(rendered(hint=hint))
    zoom_in(strip, "color", 200, 100, notches=12)
    grabbed = strip.panes["color"].view.grab().toImage()
    for u, v in ((200, 100), (202, 102), (198, 98)):
        color = grabbed.pixelColor(at(strip, "color", u, v))
        assert (color.red(), color.green(), color.blue()) == (u % 256, v % 256, 0)


def test_the_keyboard_points_clicks_and_zooms(strip, qapp):
    found = []
    clicks = []
    strip.hovered.connect(lambda u, v: found.append((u, v)))
    strip.clicked.connect(lambda *click: clicks.append(click))
    QTest.keyClick(strip, Qt.Key.Key_Right)
    QTest.keyClick(strip, Qt.Key.Key_Up, Qt.KeyboardModifier.ShiftModifier)
    assert found == [(321, 240), (321, 230)]
    QTest.keyClick(strip, Qt.Key.Key_Return)
    assert clicks == [("color", 321, 230, NONE)]
    for _ in range(40):
        QTest.keyClick(strip, Qt.Key.Key_Right, Qt.KeyboardModifier.ShiftModifier)
    assert found[-1] == (639, 230)
    whole = seen_rect(strip, "difference")
    QTest.keyClick(strip, Qt.Key.Key_Plus)
    qapp.processEvents()
    assert seen_rect(strip, "difference")[2] < whole[2]
    QTest.keyClick(strip, Qt.Key.Key_0)
    qapp.processEvents()
    assert seen_rect(strip, "difference") == pytest.approx(whole, abs=0.5)


def test_the_region_stands_on_every_image(strip):
    strip.set_region((100, 80, 400, 300))
    for pane in strip.panes.values():
        assert pane.region.isVisible()
        assert pane.region.rect() == QRectF(99.5, 79.5, 400, 300)
    strip.set_region(None)
    assert not any(pane.region.isVisible() for pane in strip.panes.values())
