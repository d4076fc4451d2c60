"""Contact of nothing but prints: they reflect infrared, so both cameras measure the membrane itself."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from ....contact.masking import colors_at, in_hsv_range
from ....model.arrays import BoolArray, Uint8Array
from ....model.clouds import deproject
from ....preset import MaskSection
from ..proposal import Finding, Proposal
from .situation import Situation

#: Prints are several groups of pixels of one colour, spread over the membrane: fewest groups and pixels of a group,
#: least share of the contact that has the colour, and largest share of the contact's convex hull that is in contact.
_MIN_GROUPS, _MIN_GROUP_PX, _MIN_COLORED, _MAX_FILL = 3, 25, 0.95, 0.1
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
    """Return a finding if contact is groups of one colour all over the membrane that touch wherever that colour is."""
    patch = situation.patch
    if len(patch.points) < _MIN_GROUPS * _MIN_GROUP_PX:
        return None
    _, _, stats, _ = cv2.connectedComponentsWithStats(patch.mask.view(np.uint8))
    groups = int(np.count_nonzero(stats[1:, cv2.CC_STAT_AREA] >= _MIN_GROUP_PX))
    if groups < _MIN_GROUPS or _fill(patch.mask) > _MAX_FILL:
        return None
    colors, _ = colors_at(patch.points, np.flatnonzero(patch.mask), situation.frame.proximity_color, situation.rig)
    mask = _mask_of(cv2.cvtColor(colors[None], cv2.COLOR_RGB2HSV)[0])
    if mask is None or in_hsv_range(colors, mask).mean() < _MIN_COLORED or not _agrees_everywhere(situation, mask):
        return None
    ranges = f"hue {mask.hue[0]} to {mask.hue[1]}"
    return Finding(
        name="prints",
        field="mask.enabled",
        sentence=f"All contact is {groups} groups of one colour ({ranges}) all over the membrane: probably prints.",
        proposal=Proposal(
            section="mask",
            changes={f"mask.{name}": getattr(mask, name) for name in ("enabled", "hue", "saturation", "value")},
            label="Mask this colour",
            evidence=f"{groups} groups of contact have one colour, and both cameras agree wherever it is.",
            expected="Pixels of this colour no longer count as contact.",
        ),
    )


def _fill(contact: BoolArray) -> float:
    """Return the share of the convex hull of the contact that is in contact."""
    corners = cv2.convexHull(cv2.findNonZero(contact.view(np.uint8)))
    return np.count_nonzero(contact) / max(cv2.contourArea(corners), 1.0)


def _mask_of(hsv: Uint8Array) -> MaskSection | None:
    """Return the range of the most frequent clear colour; None if there is no clear colour."""
    clear = hsv[(hsv[:, 1] >= _MIN_SATURATION) & (hsv[:, 2] >= _MIN_VALUE)].astype(np.int64)
    if len(clear) < _MIN_COLORED * len(hsv):
        return None
    hue = int(np.argmax(np.bincount(clear[:, 0], minlength=_HUES)))
    away = (clear[:, 0] - hue + _HUES // 2) % _HUES - _HUES // 2
    near = np.abs(away) <= _HUE_SPAN
    parts = (away[near], clear[near, 1], clear[near, 2])
    spans = [
        (int(low) - margin, int(high) + margin)
        for (low, high), margin in zip((np.percentile(part, _PERCENTILES) for part in parts), _MARGINS, strict=True)
    ]
    saturation, value = ((max(low, 0), min(high, 255)) for low, high in spans[1:])
    low, high = spans[0]
    return MaskSection(hue=((hue + low) % _HUES, (hue + high) % _HUES), saturation=saturation, value=value)


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
