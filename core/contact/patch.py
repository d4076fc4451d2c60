"""The contact patch: what the pipeline gives back, computed as far as it is asked for."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Generic, TypeVar

import numpy as np

from ..model.arrays import BoolArray, Float32Array, Uint8Array
from ..model.frames import Rig
from ..model.provenance import Provenance
from .alignment import AlignedDepth
from .outliers.clusters import pixel_areas_m2

T = TypeVar("T")


class Once(Generic[T]):
    """A value that is computed when it is first asked for, once only, by whatever thread asks."""

    def __init__(self, compute: Callable[[], T]) -> None:
        self._compute: Callable[[], T] | None = compute
        self._lock = threading.Lock()

    def get(self) -> T:
        """Return the value."""
        with self._lock:
            if self._compute is not None:
                self._value = self._compute()
                self._compute = None
            return self._value


class ContactPatch:
    """Where the membrane touches the object, and why every other pixel was dropped.

    Provenance, mask and aligned depths are computed from the frame's images when they are first read,
    so these images must not be overwritten while a patch is in use.

    Parameters
    ----------
    sequence : int
        The frame's number.
    points, provenance, aligned, mask
        As the attributes of these names, or `Once`; without a mask it follows from the provenance.
    rig : Rig
    stage_ms : mapping of str to float
        Milliseconds of each of `pipeline.stages_of` the preset; 0 for a stage that was cached or skipped.
    skipped : tuple of str
        What this frame did not need, in words, such as "no tile can hold contact".
    averaged_frames : int
        Over how many frames the depths were averaged, this one included.
    """

    def __init__(
        self,
        sequence: int,
        points: Float32Array | Once[Float32Array],
        provenance: Uint8Array | Once[Uint8Array],
        aligned: AlignedDepth | Once[AlignedDepth],
        rig: Rig,
        stage_ms: Mapping[str, float],
        skipped: tuple[str, ...] = (),
        mask: Once[BoolArray] | None = None,
        averaged_frames: int = 1,
    ) -> None:
        self.sequence = sequence
        self.rig = rig
        self.stage_ms = dict(stage_ms)
        self.skipped = skipped
        self.averaged_frames = averaged_frames
        self._points = points
        self._provenance = provenance
        self._aligned = aligned
        self._mask = mask

    def again(self, sequence: int, stage_ms: Mapping[str, float], skipped: tuple[str, ...]) -> ContactPatch:
        """Return the same patch as the result of another call."""
        return ContactPatch(
            sequence, self._points, self._provenance, self._aligned, self.rig, stage_ms, skipped, self._mask,
            self.averaged_frames,
        )  # fmt: skip

    @property
    def points(self) -> Float32Array:
        """Float32 (N, 3), metres, proximity depth frame, in row-major pixel order."""
        return self._points.get() if isinstance(self._points, Once) else self._points

    @property
    def provenance(self) -> Uint8Array:
        """Uint8 (H, W), values of `Provenance`."""
        return self._provenance.get() if isinstance(self._provenance, Once) else self._provenance

    @property
    def aligned(self) -> AlignedDepth:
        """Both sides of the tolerance test."""
        return self._aligned.get() if isinstance(self._aligned, Once) else self._aligned

    @cached_property
    def mask(self) -> BoolArray:
        """Bool (H, W), True in contact; its i-th True pixel belongs to ``points[i]``."""
        return self._mask.get() if self._mask is not None else np.asarray(self.provenance == Provenance.CONTACT)

    @cached_property
    def relative_difference(self) -> Float32Array:
        """Float32 (H, W), ``(dp - dt) / dp``; nan where either is missing."""
        expected, measured = self.aligned.expected_m, self.aligned.measured_m
        return np.asarray((expected - measured) / expected)

    @cached_property
    def area_mm2(self) -> float:
        """Area of the patch, projected on the plane across the optical axis."""
        return float(pixel_areas_m2(self.points[:, 2], self.rig.proximity.intrinsics).sum() * 1e6)

    @cached_property
    def centroid_m(self) -> tuple[float, float, float] | None:
        """Mean of the points in metres, or None for an empty patch."""
        if len(self.points) == 0:
            return None
        x, y, z = self.points.mean(axis=0, dtype=np.float64)
        return float(x), float(y), float(z)
