"""From a few clicked pixels to HSV ranges: set, expand.

Ranges are inclusive, in OpenCV's 8-bit convention: hue 0-179 on a circle (low above high wraps around), saturation and
value 0-255.
"""

from __future__ import annotations

from typing import Final, Literal

import cv2
import numpy as np

from ...core.model.arrays import BoolArray, Int64Array, Uint8Array
from ...core.preset import MaskSection

Mode = Literal["set", "expand"]
Span = tuple[int, int]

#: Half width of the sampled square, pixels.
RADIUS: Final = 3
#: Margin around the sampled colours, so that the rest of the membrane matches too.
HUE_MARGIN: Final = 6
SATURATION_MARGIN: Final = 30
VALUE_MARGIN: Final = 40

_HUES = 180
_BYTES = 256
_CORE_SHARE = 0.9
_CHROMATIC_SATURATION = 25
_CHROMATIC_VALUE = 25


def new_ranges(rgb: Uint8Array, present: MaskSection, mode: Mode) -> MaskSection:
    """Return the ranges of nine tenths of a sample, (h, w, 3) RGB, and a margin; expanded, with the present ones."""
    hsv = cv2.cvtColor(np.ascontiguousarray(rgb), cv2.COLOR_RGB2HSV).reshape(-1, 3).astype(np.int64)
    fresh = MaskSection(
        hue=_hue_range(hsv),
        saturation=_widened(_core(hsv[:, 1]), SATURATION_MARGIN),
        value=_widened(_core(hsv[:, 2]), VALUE_MARGIN),
    )
    if mode == "set":
        return fresh
    return MaskSection(
        hue=_covering_arc(present.hue, fresh.hue),
        saturation=_covering_span(present.saturation, fresh.saturation),
        value=_covering_span(present.value, fresh.value),
    )


def _hue_range(hsv: Int64Array) -> Span:
    """Return the hues of a sample, (N, 3), and a margin; all where most pixels are too grey or dark to have one."""
    chromatic = (hsv[:, 1] >= _CHROMATIC_SATURATION) & (hsv[:, 2] >= _CHROMATIC_VALUE)
    if 2 * np.count_nonzero(chromatic) < len(hsv):
        return 0, _HUES - 1
    low, high = arc = _shortest_arc(np.sort(hsv[chromatic, 0]))
    if _arc_length(arc) + 2 * HUE_MARGIN >= _HUES:
        return 0, _HUES - 1
    return (low - HUE_MARGIN) % _HUES, (high + HUE_MARGIN) % _HUES


def _core(numbers: Int64Array) -> Span:
    """Return the central share of some numbers."""
    tail = 50.0 * (1.0 - _CORE_SHARE)
    low = np.percentile(numbers, tail, method="lower")
    high = np.percentile(numbers, 100.0 - tail, method="higher")
    return int(low), int(high)


def _shortest_arc(hues: Int64Array) -> Span:
    """Return the shortest arc of the circle that holds the core share of some sorted hues."""
    count = len(hues)
    needed = int(np.ceil(_CORE_SHARE * count))
    ends = np.concatenate([hues, hues + _HUES])[needed - 1 : needed - 1 + count]
    first = int(np.argmin(ends - hues))
    return int(hues[first]), int(ends[first] % _HUES)


def _widened(span: Span, margin: int) -> Span:
    return max(0, span[0] - margin), min(_BYTES - 1, span[1] + margin)


def _arc_length(arc: Span) -> int:
    return (arc[1] - arc[0]) % _HUES + 1


def _on_arc(arc: Span) -> BoolArray:
    """Tell which hues, bool (180,), lie on an arc."""
    on: BoolArray = (np.arange(_HUES) - arc[0]) % _HUES < _arc_length(arc)
    return on


def _covering_span(first: Span, second: Span) -> Span:
    return min(first[0], second[0]), max(first[1], second[1])


def _covering_arc(first: Span, second: Span) -> Span:
    """Return the shortest arc that holds two arcs: it begins where one begins and ends where one ends."""
    held = _on_arc(first) | _on_arc(second)
    arcs = [(low, high) for low in (first[0], second[0]) for high in (first[1], second[1])]
    holding = [arc for arc in arcs if _on_arc(arc)[held].all()]
    return min(holding, key=_arc_length, default=(0, _HUES - 1))
