"""Which images of two streams belong together."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np

from ...model.arrays import Float64Array, IndexArray
from .recording import HARDWARE_CLOCK, Stream

#: Seconds above this are a date, below they count from some start.
_FIRST_DATE_S = 1e9
_LAST_DATE_S = 1e11


def common_times(
    first: Stream, second: Stream, *, same_recording: bool, same_device: bool
) -> tuple[Float64Array, Float64Array] | None:
    """Return both streams' times in seconds on one clock, the most exact that they share.

    That is the clock of the images' own stamps where both name the same (a camera's own clock counts
    for that camera alone), else when the images were recorded or, across two recordings, when they
    reached the computer. None where no clock is shared.
    """
    if first.clock == second.clock != "" and (same_device or first.clock != HARDWARE_CLOCK):
        return first.stamps_s, second.stamps_s
    if same_recording:
        return first.recorded_s, second.recorded_s
    if first.arrived_s is not None and second.arrived_s is not None:
        return first.arrived_s, second.arrived_s
    return None


def period_s(times_s: Float64Array, rate_hz: float) -> float:
    """Return the usual time between two images, in seconds."""
    usual = float(np.median(np.diff(np.sort(times_s)))) if len(times_s) > 1 else 0.0
    return usual or 1.0 / (rate_hz if rate_hz > 0 else 30.0)


def nearest(times_s: Float64Array, candidates_s: Float64Array) -> IndexArray:
    """Return for each time the index of the nearest candidate; the earlier of two that are as near."""
    order = np.argsort(candidates_s, kind="stable")
    ordered = candidates_s[order]
    after = np.searchsorted(ordered, times_s).clip(1, max(len(ordered) - 1, 1))
    before = after - 1
    after = after.clip(max=len(ordered) - 1)
    later_is_nearer = ordered[after] - times_s < times_s - ordered[before]
    return order[np.where(later_is_nearer, after, before)]


def pairs(first_s: Float64Array, second_s: Float64Array, farthest_s: float) -> tuple[IndexArray, IndexArray]:
    """Return the indices of images that are each other's nearest and at most ``farthest_s`` apart."""
    partner = nearest(first_s, second_s)
    is_mutual = nearest(second_s, first_s)[partner] == np.arange(len(first_s))
    # Stamps are sums and products of decimal fractions: exactly half a period must still count.
    is_near = np.abs(second_s[partner] - first_s) <= farthest_s * (1 + 1e-6)
    chosen = np.flatnonzero(is_mutual & is_near)
    return chosen, partner[chosen]


def span_text(times_s: Float64Array) -> str:
    """Return from when to when some images were taken, in words."""
    return f"{_moment(float(times_s.min()))} to {_moment(float(times_s.max()))}"


def _moment(time_s: float) -> str:
    if _FIRST_DATE_S < time_s < _LAST_DATE_S:
        return f"{datetime.fromtimestamp(time_s, UTC):%Y-%m-%d %H:%M:%S.%f}"[:-3] + " UTC"
    return f"{time_s:.3f} s"
