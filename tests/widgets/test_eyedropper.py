import cv2
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tactune.core.preset import MaskSection
from tactune.widgets.images.eyedropper import new_ranges

FULL = MaskSection(hue=(0, 179), saturation=(0, 255), value=(0, 255))


def every_color():
    """A coarse grid over the whole HSV cube, as (N, 3)."""
    h, s, v = np.meshgrid(np.arange(180), np.arange(0, 256, 15), np.arange(0, 256, 15), indexing="ij")
    return np.stack([h, s, v], axis=-1).reshape(-1, 3).astype(np.uint8)


COLORS = every_color()


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


def to_hsv(rgb):
    return cv2.cvtColor(np.ascontiguousarray(rgb), cv2.COLOR_RGB2HSV)


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
    hsv = to_hsv(rgb).reshape(-1, 3)
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
