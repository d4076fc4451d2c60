"""From a few clicked pixels to HSV ranges: set, expand, shrink.

Ranges are inclusive, in OpenCV's 8-bit convention: hue 0-179 on a circle (low above high wraps around), saturation and
value 0-255.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import cv2
import numpy as np

from ...core.errors import TactuneError
from ...core.model.arrays import BoolArray, Int64Array, Uint8Array
from ...core.preset import MaskSection

Mode = Literal["set", "expand", "shrink"]
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


class EyedropperError(TactuneError):
    """A sample from which no ranges can be made."""


@dataclass(frozen=True)
class Sample:
    """Typical colour of some pixels: span of the core and median, per channel.

    ``hue`` and ``median_hue`` are None where the pixels are too grey or too dark to have one.
    """

    hue: Span | None
    saturation: Span
    value: Span
    median_hue: int | None
    median_saturation: int
    median_value: int


def new_ranges(rgb: Uint8Array, present: MaskSection, mode: Mode) -> MaskSection:
    """Return ranges that a sample, uint8 (h, w, 3) RGB, sets, expands or shrinks.

    set: the core of the sample and a margin. expand: the smallest ranges that cover the present ones and what set
    gives. shrink: one channel, the one that loses the smallest share, is cut so that the sample's median is outside.
    Raises `EyedropperError` if nothing is left to cut.
    """
    sample = take_sample(rgb)
    if mode == "shrink":
        return _shrunk(present, sample)
    fresh = _with_margin(sample)
    if mode == "set":
        return fresh
    return MaskSection(
        hue=_covering_arc(present.hue, fresh.hue),
        saturation=_covering_span(present.saturation, fresh.saturation),
        value=_covering_span(present.value, fresh.value),
    )


def take_sample(rgb: Uint8Array) -> Sample:
    """Measure pixels, uint8 (h, w, 3); up to one in ten may be outliers."""
    hsv = cv2.cvtColor(np.ascontiguousarray(rgb), cv2.COLOR_RGB2HSV).reshape(-1, 3).astype(np.int64)
    chromatic = (hsv[:, 1] >= _CHROMATIC_SATURATION) & (hsv[:, 2] >= _CHROMATIC_VALUE)
    hue: Span | None = None
    median_hue: int | None = None
    if 2 * np.count_nonzero(chromatic) >= len(hsv):
        hues = np.sort(hsv[chromatic, 0])
        hue = _shortest_arc(hues)
        offsets = np.sort((hues - hue[0]) % _HUES)
        inside = offsets[offsets < _arc_length(hue)]
        median_hue = int((hue[0] + inside[(len(inside) - 1) // 2]) % _HUES)
    saturation, median_saturation = _core(hsv[:, 1])
    value, median_value = _core(hsv[:, 2])
    return Sample(hue, saturation, value, median_hue, median_saturation, median_value)


def contains(mask: MaskSection, hsv: Uint8Array) -> BoolArray:
    """Tell which of the colours, uint8 (..., 3) as H, S, V, a mask covers: bool (...)."""
    inside: BoolArray = _on_arc(mask.hue)[hsv[..., 0]]
    for channel, (low, high) in enumerate((mask.saturation, mask.value), start=1):
        inside = inside & (hsv[..., channel] >= low) & (hsv[..., channel] <= high)
    return inside


def _core(numbers: Int64Array) -> tuple[Span, int]:
    """Return the central share of some numbers, and their median, which is one of them."""
    tail = 50.0 * (1.0 - _CORE_SHARE)
    low = np.percentile(numbers, tail, method="lower")
    high = np.percentile(numbers, 100.0 - tail, method="higher")
    return (int(low), int(high)), int(np.percentile(numbers, 50.0, method="lower"))


def _shortest_arc(hues: Int64Array) -> Span:
    """Return the shortest arc of the circle that holds the core share of some sorted hues."""
    count = len(hues)
    needed = int(np.ceil(_CORE_SHARE * count))
    ends = np.concatenate([hues, hues + _HUES])[needed - 1 : needed - 1 + count]
    first = int(np.argmin(ends - hues))
    return int(hues[first]), int(ends[first] % _HUES)


def _with_margin(sample: Sample) -> MaskSection:
    hue = (0, _HUES - 1)
    if sample.hue is not None and _arc_length(sample.hue) + 2 * HUE_MARGIN < _HUES:
        hue = ((sample.hue[0] - HUE_MARGIN) % _HUES, (sample.hue[1] + HUE_MARGIN) % _HUES)
    return MaskSection(
        hue=hue,
        saturation=_widened(sample.saturation, SATURATION_MARGIN),
        value=_widened(sample.value, VALUE_MARGIN),
    )


def _widened(span: Span, margin: int) -> Span:
    return max(0, span[0] - margin), min(_BYTES - 1, span[1] + margin)


def _arc_length(arc: Span) -> int:
    return (arc[1] - arc[0]) % _HUES + 1


def _on_arc(arc: Span) -> BoolArray:
    """Tell which hues, bool (180,), lie on an arc."""
    on: BoolArray = (np.arange(_HUES) - arc[0]) % _HUES < _arc_length(arc)
    return on


def _longest_arc(hues: BoolArray) -> Span | None:
    """Return the longest arc of the circle on which all hues, bool (180,), are true; None if none is."""
    if hues.all() or not hues.any():
        return (0, _HUES - 1) if hues.all() else None
    starts = np.flatnonzero(hues & ~np.roll(hues, 1))
    stops = np.flatnonzero(hues & ~np.roll(hues, -1))
    lengths = [(stops - start) % _HUES for start in starts]
    arcs = [(int(start), int(stops[np.argmin(each)])) for start, each in zip(starts, lengths, strict=True)]
    return max(arcs, key=_arc_length)


def _covering_span(first: Span, second: Span) -> Span:
    return min(first[0], second[0]), max(first[1], second[1])


def _covering_arc(first: Span, second: Span) -> Span:
    """Return the shortest arc that holds two arcs."""
    gap = _longest_arc(~(_on_arc(first) | _on_arc(second)))
    return (0, _HUES - 1) if gap is None else ((gap[1] + 1) % _HUES, (gap[0] - 1) % _HUES)


def _shrunk(present: MaskSection, sample: Sample) -> MaskSection:
    """Cut one channel beyond the sample's core; where that leaves nothing, beyond its median."""
    median_hue = present.hue[0] if sample.median_hue is None else sample.median_hue
    median = np.array([median_hue, sample.median_saturation, sample.median_value], np.uint8)
    if not contains(present, median):
        return present
    at_median = None if sample.median_hue is None else (sample.median_hue,) * 2
    for hue, saturation, value in (
        (sample.hue, sample.saturation, sample.value),
        (at_median, (sample.median_saturation,) * 2, (sample.median_value,) * 2),
    ):
        options = [
            (1.0 - (high - low + 1) / (span[1] - span[0] + 1), name, (low, high))
            for name, span, core in (
                ("saturation", present.saturation, saturation),
                ("value", present.value, value),
            )
            for low, high in ((span[0], core[0] - 1), (core[1] + 1, span[1]))
            if span[0] <= low <= high <= span[1]
        ]
        rest = None if hue is None else _longest_arc(_on_arc(present.hue) & ~_on_arc(hue))
        if rest is not None:
            options.insert(0, (1.0 - _arc_length(rest) / _arc_length(present.hue), "hue", rest))
        if options:
            _, channel, span = min(options, key=lambda option: option[0])
            return present.model_copy(update={channel: span})
    raise EyedropperError("excluding this colour would empty the mask; turn the mask off instead")
