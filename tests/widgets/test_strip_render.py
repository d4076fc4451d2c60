import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactune.widgets.basics.colormaps import CONTACT_RGB, depth_lut, difference_lut
from tactune.widgets.images.strip_render import (
    NO_VALUE_RGB,
    color_pane,
    depth_pane,
    difference_limit,
    difference_pane,
    outline_contact,
    stride_for,
)

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
