import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactune.widgets.basics.colormaps import CONTACT_RGB, depth_lut, difference_lut
from tactune.widgets.images.strip_render import NO_VALUE_RGB, StripImages, render_strip, stride_for

HEIGHT, WIDTH = 48, 64


def images(**changes):
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    depth = (0.2 + 0.001 * u).astype(np.float32)
    values = {
        "color": np.dstack([u, v, u + v]).astype(np.uint8),
        "mask_overlay": None,
        "proximity_m": depth,
        "tactile_m": depth + np.float32(0.01),
        "relative": (0.002 * (u - 32)).astype(np.float32),
        "tolerance": 0.03,
        "depth_range_m": (0.2, 0.3),
        "size": (WIDTH, HEIGHT),
    }
    return StripImages(**(values | changes))


def rgb(pane):
    return pane[:, :, 2::-1].astype(int)


def test_depth_has_the_colors_of_the_table_and_none_is_flat():
    proximity = images().proximity_m.copy()
    proximity[5:9, 7:13] = np.nan
    shown = rgb(render_strip(images(proximity_m=proximity, depth_range_m=(0.2, 0.263))).panes["proximity"])
    lut = depth_lut()[:, :3].astype(int)
    np.testing.assert_array_equal(shown[0, 0], lut[1])
    np.testing.assert_array_equal(shown[0, -1], lut[255])
    rows = 1 + np.arange(WIDTH) / 63 * 254
    assert np.abs(shown[0] - lut[np.rint(rows).astype(int)]).max() <= 3
    assert (shown[5:9, 7:13] == NO_VALUE_RGB).all()
    assert not (lut == NO_VALUE_RGB).all(axis=1).any()


@pytest.mark.parametrize("tolerance", [0.0, 0.01, 0.03, 0.2])
def test_the_band_is_one_color_and_nothing_else_has_it(tolerance):
    scene = images(tolerance=tolerance)
    rendered = render_strip(scene)
    shown = rgb(rendered.panes["difference"])
    band = difference_lut(tolerance, rendered.difference_limit)[128, :3]
    in_band = (shown == band).all(axis=2)
    quantum = rendered.difference_limit / 127
    magnitude = np.abs(scene.relative)
    assert in_band[magnitude < tolerance - quantum].all()
    assert not in_band[magnitude > tolerance + quantum].any()


def test_contact_is_outlined_in_every_pane():
    contact = np.zeros((HEIGHT, WIDTH), bool)
    contact[10:30, 20:50] = True
    plain, outlined = render_strip(images()), render_strip(images(contact=contact))
    for before, after in zip(plain.panes.values(), outlined.panes.values(), strict=True):
        changed = (before != after).any(axis=2)
        assert (rgb(after)[changed] == CONTACT_RGB).all()
        assert changed[10, 20:50].all()
        assert not changed[14:26, 24:46].any()
        assert not changed[~contact].any()


@given(hint=st.integers(1, 200))
@settings(max_examples=30, deadline=None)
def test_a_small_pane_gets_every_nth_pixel(hint):
    whole, stride = images(), stride_for(WIDTH, hint)
    assert stride == 1 or WIDTH / stride >= 0.9 * hint
    parts = {
        name: getattr(whole, name)[::stride, ::stride] for name in ("color", "proximity_m", "tactile_m", "relative")
    }
    full, small = render_strip(whole), render_strip(images(**parts, stride=stride))
    assert (small.size, small.stride) == ((WIDTH, HEIGHT), stride)
    for large, reduced in zip(full.panes.values(), small.panes.values(), strict=True):
        np.testing.assert_array_equal(reduced, large[::stride, ::stride])
