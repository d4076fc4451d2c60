from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactune.core.errors import TactuneError
from tactune.core.preset import MaskSection
from tactune.widgets.images.eyedropper import contains, new_ranges, take_sample

FULL = MaskSection(hue=(0, 179), saturation=(0, 255), value=(0, 255))


def every_color() -> np.ndarray:
    """A coarse grid over the whole HSV cube, as (N, 3)."""
    h, s, v = np.meshgrid(np.arange(180), np.arange(0, 256, 15), np.arange(0, 256, 15), indexing="ij")
    return np.stack([h, s, v], axis=-1).reshape(-1, 3).astype(np.uint8)


COLORS = every_color()


def patch_of(hue: int, saturation: int, value: int, spread: int, seed: int) -> np.ndarray:
    """7 x 7 RGB pixels scattered around an HSV colour."""
    rng = np.random.default_rng(seed)
    hsv = np.empty((7, 7, 3), np.int64)
    hsv[..., 0] = (hue + rng.integers(-spread, spread + 1, (7, 7))) % 180
    hsv[..., 1] = np.clip(saturation + rng.integers(-spread, spread + 1, (7, 7)), 0, 255)
    hsv[..., 2] = np.clip(value + rng.integers(-spread, spread + 1, (7, 7)), 0, 255)
    return cv2.cvtColor(hsv.astype(np.uint8), cv2.COLOR_HSV2RGB)


def to_hsv(rgb: np.ndarray) -> np.ndarray:
    return cv2.cvtColor(np.ascontiguousarray(rgb), cv2.COLOR_RGB2HSV)


hues = st.integers(0, 179)
byte_spans = st.tuples(st.integers(0, 255), st.integers(0, 255)).map(lambda pair: (min(pair), max(pair)))
ranges = st.builds(MaskSection, hue=st.tuples(hues, hues), saturation=byte_spans, value=byte_spans)
patches = st.builds(
    patch_of, hues, st.integers(0, 255), st.integers(0, 255), spread=st.integers(0, 12), seed=st.integers(0, 99)
)
noise = st.integers(0, 999).map(lambda seed: np.random.default_rng(seed).integers(0, 256, (7, 7, 3)).astype(np.uint8))
samples = st.one_of(patches, noise)


def median_color(rgb: np.ndarray, present: MaskSection) -> np.ndarray:
    sample = take_sample(rgb)
    hue = present.hue[0] if sample.median_hue is None else sample.median_hue
    return np.array([hue, sample.median_saturation, sample.median_value], np.uint8)


@given(samples, ranges)
def test_set_covers_nine_tenths_of_every_channel(rgb: np.ndarray, present: MaskSection) -> None:
    fresh = new_ranges(rgb, present, "set")
    hsv = to_hsv(rgb).reshape(-1, 3)
    for channel, span in ((1, fresh.saturation), (2, fresh.value)):
        assert np.mean((hsv[:, channel] >= span[0]) & (hsv[:, channel] <= span[1])) >= 0.9
    colorful = hsv[(hsv[:, 1] >= 25) & (hsv[:, 2] >= 25), 0].astype(int)
    if len(colorful):
        low, high = fresh.hue
        inside = (colorful >= low) & (colorful <= high) if low <= high else (colorful >= low) | (colorful <= high)
        assert np.mean(inside) >= 0.9


@given(patches, ranges)
def test_set_does_not_depend_on_what_was_there(rgb: np.ndarray, present: MaskSection) -> None:
    assert new_ranges(rgb, present, "set") == new_ranges(rgb, FULL, "set")


@given(samples, ranges)
@settings(max_examples=60)
def test_expand_covers_both(rgb: np.ndarray, present: MaskSection) -> None:
    wider = contains(new_ranges(rgb, present, "expand"), COLORS)
    assert wider[contains(present, COLORS)].all()
    assert wider[contains(new_ranges(rgb, present, "set"), COLORS)].all()


@given(samples, ranges)
def test_expanded_hue_is_the_shortest_arc(rgb: np.ndarray, present: MaskSection) -> None:
    def members(arc: tuple[int, int]) -> set[int]:
        return {(arc[0] + i) % 180 for i in range((arc[1] - arc[0]) % 180 + 1)}

    wanted = members(present.hue) | members(new_ranges(rgb, present, "set").hue)
    found = members(new_ranges(rgb, present, "expand").hue)
    # the shortest arc that covers a set leaves out exactly the longest gap between its members
    ordered = sorted(wanted)
    gaps = [(after - before - 1) % 180 for before, after in zip(ordered, ordered[1:] + ordered[:1], strict=True)]
    assert wanted <= found
    assert len(found) == 180 - (max(gaps) if len(ordered) > 1 else 179)


@given(samples, ranges)
@settings(max_examples=60)
def test_shrink_excludes_the_median_and_adds_nothing(rgb: np.ndarray, present: MaskSection) -> None:
    median = median_color(rgb, present)
    try:
        less = new_ranges(rgb, present, "shrink")
    except TactuneError:
        assert contains(present, median)
        return
    assert not contains(less, median)
    assert contains(present, COLORS)[contains(less, COLORS)].all()
    changed = [name for name in ("hue", "saturation", "value") if getattr(less, name) != getattr(present, name)]
    assert len(changed) == (1 if contains(present, median) else 0)


@given(samples)
def test_shrink_of_the_full_range_is_never_refused(rgb: np.ndarray) -> None:
    assert not contains(new_ranges(rgb, FULL, "shrink"), median_color(rgb, FULL))


def test_a_sample_around_red_wraps() -> None:
    red = patch_of(hue=1, saturation=200, value=200, spread=4, seed=0)
    fresh = new_ranges(red, FULL, "set")
    assert fresh.hue[0] > 150
    assert fresh.hue[1] < 30
    assert fresh.hue[0] > fresh.hue[1]
    assert not contains(fresh, np.array([90, 200, 200], np.uint8))


def test_expanding_over_red_takes_the_short_way() -> None:
    present = MaskSection(hue=(150, 170), saturation=(100, 255), value=(100, 255))
    orange = patch_of(hue=8, saturation=200, value=200, spread=1, seed=0)
    assert new_ranges(orange, present, "expand").hue[0] == 150
    assert new_ranges(orange, present, "expand").hue[1] < 30


def test_shrinking_cuts_the_channel_that_loses_least() -> None:
    present = MaskSection(hue=(0, 100), saturation=(100, 255), value=(0, 255))
    dark = patch_of(hue=50, saturation=180, value=10, spread=2, seed=0)
    less = new_ranges(dark, present, "shrink")
    assert less.hue == present.hue
    assert less.saturation == present.saturation
    assert 10 < less.value[0] < 40
    assert less.value[1] == 255


def test_grey_has_no_hue() -> None:
    grey = np.full((7, 7, 3), 120, np.uint8)
    assert take_sample(grey).hue is None
    assert new_ranges(grey, FULL, "set").hue == (0, 179)


def test_one_bright_speck_does_not_count() -> None:
    plain = patch_of(hue=60, saturation=150, value=100, spread=2, seed=1)
    specked = plain.copy()
    specked[3, 3] = 255
    fresh, with_speck = new_ranges(plain, FULL, "set"), new_ranges(specked, FULL, "set")
    assert with_speck.value[1] <= fresh.value[1] + 4


def test_shrinking_to_nothing_is_refused_in_words() -> None:
    pure = np.zeros((7, 7, 3), np.uint8)
    pure[:] = (255, 0, 0)
    with pytest.raises(TactuneError, match="turn the mask off"):
        new_ranges(pure, MaskSection(hue=(0, 0), saturation=(255, 255), value=(255, 255)), "shrink")
