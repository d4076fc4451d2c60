"""The physical limit: bytes that a frame must move over the bandwidth of this machine's memory."""

from __future__ import annotations

from dataclasses import dataclass

from .scenes import BenchScene

_POINT_BYTES, _COLOR_BYTES, _VERDICT_BYTES = 12, 3, 1


@dataclass(frozen=True)
class Roofline:
    """What the per-pixel chain must move at least, and how long that takes.

    ``must_bytes`` counts each input and each result once: both depth images, a colour for each
    candidate, a verdict for each pixel and a point for each contact. Tables are not in it.
    """

    must_bytes: int
    bandwidth_bytes_per_s: float

    @property
    def limit_ms(self) -> float:
        """The least time for these bytes, milliseconds."""
        return 1e3 * self.must_bytes / self.bandwidth_bytes_per_s


def roofline(scene: BenchScene, candidates: int, contacts: int, bandwidth_bytes_per_s: float) -> Roofline:
    """Return the limit for a scene whose tolerance test passes ``candidates`` and keeps ``contacts`` pixels."""
    frame = scene.frame
    must = frame.proximity_depth.nbytes + frame.tactile_depth.nbytes + frame.proximity_depth.size * _VERDICT_BYTES
    must += contacts * _POINT_BYTES
    if scene.preset.mask.enabled:
        must += candidates * _COLOR_BYTES
    return Roofline(must, bandwidth_bytes_per_s)
