"""Contact on prints: they reflect infrared, so both cameras measure the membrane itself."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import cv2
import numpy as np

from ....contact.masking import colors_at, in_hsv_range
from ....model.arrays import BoolArray, Int64Array
from ....model.clouds import deproject
from ....preset import MaskSection
from ..proposal import Finding, Proposal
from .situation import Situation

#: Prints are several groups of pixels of one colour, spread over the membrane: fewest groups beside other contact,
#: fewest without any, fewest pixels of a group.
_MIN_BESIDE, _MIN_ALONE, _MIN_GROUP_PX = 2, 3, 25
#: Least share of each group that has the colour, and largest share of the groups' convex hull that is in them.
_MIN_COLORED, _MAX_FILL = 0.9, 0.12
#: Largest share of the other contact that has the colour: more is an object of this colour.
_MAX_SHARED: Final = 0.2
#: Wherever that colour is, both cameras agree, at least in this share: flying pixels at the rim of prints do not. With
#: the colour of an object that hovers elsewhere, the share is smaller.
_MIN_AGREEING: Final = 0.5
#: A clear colour: least saturation and value, and largest distance of a hue from the most frequent one.
_MIN_SATURATION, _MIN_VALUE, _HUE_SPAN = 60, 40, 8
#: What is added to the ranges of the colours found, hue, saturation and value; percentiles of the ranges.
_MARGINS, _PERCENTILES = (4, 30, 40), (2, 98)
#: Differences within this count as agreeing, metres.
_AGREE_M: Final = 0.008
_STRIDE, _HUES = 3, 180


def find(situation: Situation) -> Finding | None:
    """Return a finding if groups of contact have one colour all over the membrane and touch wherever that colour is."""
    patch = situation.patch
    if len(patch.points) < _MIN_ALONE * _MIN_GROUP_PX:
        return None
    count, labels, stats, _ = cv2.connectedComponentsWithStats(patch.mask.view(np.uint8))
    large = [label for label in range(1, count) if stats[label, cv2.CC_STAT_AREA] >= _MIN_GROUP_PX]
    if len(large) < _MIN_ALONE:
        return None
    colors, _ = colors_at(patch.points, np.flatnonzero(patch.mask), situation.frame.proximity_color, situation.rig)
    groups = {label: labels[patch.mask] == label for label in large}
    for mask in _masks(cv2.cvtColor(colors[None], cv2.COLOR_RGB2HSV)[0].astype(np.int64), list(groups.values())):
        colored = in_hsv_range(colors, mask)
        prints = [label for label, group in groups.items() if colored[group].mean() >= _MIN_COLORED]
        others = np.isin(labels[patch.mask], [label for label in large if label not in prints])
        alone = not others.any()
        if len(prints) < (_MIN_ALONE if alone else _MIN_BESIDE) or _fill(np.isin(labels, prints)) > _MAX_FILL:
            continue
        if (alone or colored[others].mean() <= _MAX_SHARED) and _agrees_everywhere(situation, mask):
            return _finding(mask, len(prints))
    return None


def _finding(mask: MaskSection, prints: int) -> Finding:
    found = f"{prints} groups of contact have one colour"
    return Finding(
        name="prints",
        field="mask.enabled",
        sentence=f"{found} (hue {mask.hue[0]} to {mask.hue[1]}) all over the membrane: probably prints.",
        proposal=Proposal(
            section="mask",
            changes={f"mask.{name}": getattr(mask, name) for name in ("enabled", "hue", "saturation", "value")},
            label="Mask this colour",
            evidence=f"{found}, and both cameras agree wherever it is.",
            expected="Pixels of this colour no longer count as contact.",
        ),
    )


def _fill(contact: BoolArray) -> float:
    """Return the share of the convex hull of the contact that is in contact."""
    corners = cv2.convexHull(cv2.findNonZero(contact.view(np.uint8)))
    return np.count_nonzero(contact) / max(cv2.contourArea(corners), 1.0)


def _masks(hsv: Int64Array, groups: list[BoolArray]) -> Iterator[MaskSection]:
    """Yield the range of each clear colour that enough groups have.

    Parameters
    ----------
    hsv : int, shape (N, 3)
    groups : list of bool, shape (N,)
    """
    clear = (hsv[:, 1] >= _MIN_SATURATION) & (hsv[:, 2] >= _MIN_VALUE)
    left = [group for group in groups if clear[group].mean() >= _MIN_COLORED]
    while len(left) >= _MIN_BESIDE:
        hue = _frequent_hue(hsv[left[0] & clear, 0])
        alike = [abs(_hue_away(_frequent_hue(hsv[group & clear, 0]), hue)) <= _HUE_SPAN for group in left]
        if sum(alike) >= _MIN_BESIDE:
            chosen = [group for group, is_alike in zip(left, alike, strict=True) if is_alike]
            yield _range_of(hsv[np.any(chosen, axis=0) & clear])
        left = [group for group, is_alike in zip(left, alike, strict=True) if not is_alike]


def _range_of(hsv: Int64Array) -> MaskSection:
    """Return the range of clear colours around their most frequent hue."""
    hue = _frequent_hue(hsv[:, 0])
    away = _hue_away(hsv[:, 0], hue)
    near = np.abs(away) <= _HUE_SPAN
    parts = (away[near], hsv[near, 1], hsv[near, 2])
    spans = [
        (int(low) - margin, int(high) + margin)
        for (low, high), margin in zip((np.percentile(part, _PERCENTILES) for part in parts), _MARGINS, strict=True)
    ]
    saturation, value = ((max(low, 0), min(high, 255)) for low, high in spans[1:])
    low, high = spans[0]
    return MaskSection(hue=((hue + low) % _HUES, (hue + high) % _HUES), saturation=saturation, value=value)


def _frequent_hue(hues: Int64Array) -> int:
    return int(np.argmax(np.bincount(hues, minlength=_HUES)))


def _hue_away(hue: Any, other: int) -> Any:
    """Return a hue, or an array of hues, less another: -90 to 89."""
    return (hue - other + _HUES // 2) % _HUES - _HUES // 2


def _agrees_everywhere(situation: Situation, mask: MaskSection) -> bool:
    """Return whether both cameras agree wherever the mask's colour is."""
    frame, rig, aligned = situation.frame, situation.rig, situation.patch.aligned
    facts = situation.patch.membrane
    bias_m = facts.bias_m if facts is not None else 0.0
    pixels = np.arange(frame.proximity_depth.size).reshape(frame.proximity_depth.shape)[::_STRIDE, ::_STRIDE].ravel()
    difference_m = (aligned.expected_m - aligned.measured_m)[::_STRIDE, ::_STRIDE].ravel()
    known = np.isfinite(difference_m)
    points = deproject(frame.proximity_depth, rig.proximity, pixels[known])
    colors, seen = colors_at(points, pixels[known], frame.proximity_color, rig)
    marked = seen & in_hsv_range(colors, mask)
    agreeing = np.abs(difference_m[known][marked] - np.float32(bias_m)) < _AGREE_M
    return len(agreeing) > 0 and float(agreeing.mean()) >= _MIN_AGREEING
