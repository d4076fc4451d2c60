"""The strip of images: what its panes show, mouse and keys, and the colours that its eyedropper picks."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PyQt6.QtCore import QPoint, QPointF, Qt
from PyQt6.QtTest import QTest

from hands import LEFT, image_position, shown, turn_wheel
from tactune.core.preset import MaskSection
from tactune.widgets.basics.colormaps import CONTACT_RGB, depth_lut, difference_lut
from tactune.widgets.images.eyedropper import new_ranges
from tactune.widgets.images.image_strip import PANES, ImageStrip
from tactune.widgets.images.strip_render import (
    NO_VALUE_RGB,
    RenderedStrip,
    color_pane,
    depth_pane,
    difference_limit,
    difference_pane,
    outline_contact,
    stride_for,
)

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


def test_the_region_is_dragged_by_its_corner_in_one_gesture(strip, qapp):
    strip.set_region((100, 80, 400, 300))
    qapp.processEvents()
    edits = []
    strip.regionEdited.connect(lambda rectangle, gesture: edits.append((rectangle, gesture)))
    port = viewport(strip, "proximity")
    start, end = at(strip, "proximity", 499.5, 379.5), at(strip, "proximity", 560, 420)
    QTest.mouseMove(port, start)
    QTest.mousePress(port, LEFT, pos=start)
    for share in (0.3, 0.7, 1.0):
        QTest.mouseMove(port, start + (end - start) * share)
    QTest.mouseRelease(port, LEFT, pos=end)
    assert edits
    rectangle = edits[-1][0]
    assert rectangle[:2] == (100, 80)
    assert rectangle[2] == pytest.approx(460, abs=4)
    assert rectangle[3] == pytest.approx(340, abs=4)
    assert all(isinstance(number, int) for number in rectangle)
    assert len({gesture for _, gesture in edits}) == 1
    for region in strip.regions.values():
        assert region.rectangle == rectangle


HEIGHT, WIDTH = 48, 64


def depth():
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    return (0.2 + 0.001 * u + 0.0001 * v).astype(np.float32)


def drawn(stride=1):
    """Return one image of each kind, of every ``stride``-th pixel."""
    every = np.s_[::stride, ::stride]
    color = np.dstack([*np.mgrid[:HEIGHT, :WIDTH], np.full((HEIGHT, WIDTH), 7)]).astype(np.uint8)
    expected, measured = depth()[every], (depth() + np.float32(0.01) * np.cos(depth() * 200))[every]
    return [color_pane(color[every], None), depth_pane(expected, (0.2, 0.3)), difference_pane(expected, measured, 0.03)]


def rgb(pane):
    return pane[:, :, 2::-1].astype(int)


def test_depth_has_the_colors_of_the_table_and_none_is_flat():
    proximity = np.tile((0.2 + 0.001 * np.arange(WIDTH)).astype(np.float32), (HEIGHT, 1))
    proximity[5:9, 7:13] = np.nan
    shown = rgb(depth_pane(proximity, (0.2, 0.263)))
    lut = depth_lut()[:, :3].astype(int)
    np.testing.assert_array_equal(shown[0, 0], lut[1])
    np.testing.assert_array_equal(shown[0, -1], lut[255])
    rows = 1 + np.arange(WIDTH) / 63 * 254
    assert np.abs(shown[0] - lut[np.rint(rows).astype(int)]).max() <= 3
    assert (shown[5:9, 7:13] == NO_VALUE_RGB).all()
    assert not (lut == NO_VALUE_RGB).all(axis=1).any()


@pytest.mark.parametrize("tolerance", [0.0, 0.01, 0.03, 0.2])
def test_the_band_is_one_color_and_nothing_else_has_it(tolerance):
    relative = np.tile((0.002 * (np.arange(WIDTH) - 32)).astype(np.float32), (HEIGHT, 1))
    expected, limit = np.ones_like(relative), difference_limit(tolerance)
    shown = rgb(difference_pane(expected, expected - relative, tolerance))
    band = difference_lut(tolerance, limit)[128, :3]
    in_band = (shown == band).all(axis=2)
    quantum = limit / 127
    magnitude = np.abs(relative)
    assert in_band[magnitude < tolerance - quantum].all()
    assert not in_band[magnitude > tolerance + quantum].any()


def test_contact_is_outlined_in_every_pane():
    contact = np.zeros((HEIGHT, WIDTH), bool)
    contact[10:30, 20:50] = True
    outlined = drawn()
    outline_contact(outlined, contact)
    for before, after in zip(drawn(), outlined, strict=True):
        changed = (before != after).any(axis=2)
        assert (rgb(after)[changed] == CONTACT_RGB).all()
        assert changed[10, 20:50].all()
        assert not changed[14:26, 24:46].any()
        assert not changed[~contact].any()


@given(hint=st.integers(1, 200))
@settings(max_examples=30, deadline=None)
def test_a_small_pane_gets_every_nth_pixel(hint):
    stride = stride_for(WIDTH, hint)
    assert stride == 1 or WIDTH / stride >= 0.9 * hint
    for large, reduced in zip(drawn(), drawn(stride), strict=True):
        np.testing.assert_array_equal(reduced, large[::stride, ::stride])


FULL = MaskSection(hue=(0, 179), saturation=(0, 255), value=(0, 255))


#: A coarse grid over the whole HSV cube, as (N, 3).
COLORS = np.stack(
    np.meshgrid(np.arange(180), np.arange(0, 256, 15), np.arange(0, 256, 15), indexing="ij"), axis=-1
).reshape(-1, 3).astype(np.uint8)  # fmt: skip


def patch_of(hue, saturation, value, spread, seed):
    """7 x 7 RGB pixels scattered around an HSV colour."""
    rng = np.random.default_rng(seed)
    hsv = np.empty((7, 7, 3), np.int64)
    hsv[..., 0] = (hue + rng.integers(-spread, spread + 1, (7, 7))) % 180
    hsv[..., 1] = np.clip(saturation + rng.integers(-spread, spread + 1, (7, 7)), 0, 255)
    hsv[..., 2] = np.clip(value + rng.integers(-spread, spread + 1, (7, 7)), 0, 255)
    return cv2.cvtColor(hsv.astype(np.uint8), cv2.COLOR_HSV2RGB)


def contains(mask, hsv):
    """Which of the colours, H, S and V, a mask covers, as OpenCV finds them."""
    (low, high), (from_s, to_s), (from_v, to_v) = mask.hue, mask.saturation, mask.value
    arcs = [(low, high)] if low <= high else [(low, 179), (0, high)]
    found = [cv2.inRange(hsv.reshape(1, -1, 3), (a, from_s, from_v), (b, to_s, to_v)) for a, b in arcs]
    return np.any(found, axis=0).reshape(hsv.shape[:-1])


hues = st.integers(0, 179)
byte_spans = st.tuples(st.integers(0, 255), st.integers(0, 255)).map(lambda pair: (min(pair), max(pair)))
ranges = st.builds(MaskSection, hue=st.tuples(hues, hues), saturation=byte_spans, value=byte_spans)
patches = st.builds(
    patch_of, hues, st.integers(0, 255), st.integers(0, 255), spread=st.integers(0, 12), seed=st.integers(0, 99)
)
noise = st.integers(0, 999).map(lambda seed: np.random.default_rng(seed).integers(0, 256, (7, 7, 3)).astype(np.uint8))
samples = st.one_of(patches, noise)


@given(samples, ranges)
def test_set_covers_nine_tenths_of_every_channel(rgb, present):
    fresh = new_ranges(rgb, present, "set")
    hsv = cv2.cvtColor(np.ascontiguousarray(rgb), cv2.COLOR_RGB2HSV).reshape(-1, 3)
    for channel, span in ((1, fresh.saturation), (2, fresh.value)):
        assert np.mean((hsv[:, channel] >= span[0]) & (hsv[:, channel] <= span[1])) >= 0.9
    colorful = hsv[(hsv[:, 1] >= 25) & (hsv[:, 2] >= 25), 0].astype(int)
    if len(colorful):
        low, high = fresh.hue
        inside = (colorful >= low) & (colorful <= high) if low <= high else (colorful >= low) | (colorful <= high)
        assert np.mean(inside) >= 0.9


@given(samples, ranges)
@settings(max_examples=60)
def test_expand_covers_both(rgb, present):
    wider = contains(new_ranges(rgb, present, "expand"), COLORS)
    assert wider[contains(present, COLORS)].all()
    assert wider[contains(new_ranges(rgb, present, "set"), COLORS)].all()


def test_a_sample_around_red_wraps():
    red = patch_of(hue=1, saturation=200, value=200, spread=4, seed=0)
    fresh = new_ranges(red, FULL, "set")
    assert fresh.hue[0] > 150
    assert fresh.hue[1] < 30
    assert fresh.hue[0] > fresh.hue[1]
    assert not contains(fresh, np.array([90, 200, 200], np.uint8))
