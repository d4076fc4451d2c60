"""The patch that a scan is aligned to: a frame's contact and what is seen around it, held fast."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...core.model.arrays import Float32Array
from ...core.model.clouds import deproject, valid_depth
from ..worker.results import Result

#: Around the patch every so many rows and columns are kept, and points no farther from its box, metres.
_CONTEXT_STEP = 3
_CONTEXT_MARGIN_M = 0.06


@dataclass(frozen=True, eq=False)
class FrozenPatch:
    """The contact patch of one frame; two are equal where their points are.

    Attributes
    ----------
    points, context : float32, shapes (N, 3) and (M, 3)
        Contact, and some of the proximity points around it; metres, proximity depth frame.
    area_mm2 : float
        Projected, as the main window says it.
    source : str
        Name of the source.
    frame : int
        Number of the frame within the source, from 0.
    preset : str
        File or name of the preset, as ``load_preset`` takes it; empty where it was not saved.
    """

    points: Float32Array
    context: Float32Array
    area_mm2: float
    source: str
    frame: int
    preset: str

    @classmethod
    def of(cls, result: Result, preset: str) -> FrozenPatch:
        """Take the patch of a frame of the main window."""
        patch = result.patch
        points = np.empty((0, 3), np.float32) if patch is None else patch.points
        frame = result.playback.index if result.playback.seekable else result.frame.sequence
        return cls(points, _around(result, points), result.area_mm2, result.source.name, frame, preset)

    @cached_property
    def digest(self) -> str:
        """What tells patches apart."""
        told = hashlib.blake2b(digest_size=12)
        for array in (self.points, self.context):
            told.update(np.ascontiguousarray(array).tobytes())
        told.update(f"{self.source} {self.frame} {self.preset}".encode())
        return told.hexdigest()

    @property
    def title(self) -> str:
        """Which frame it is, as windows show it: from 1."""
        return f"frame {self.frame + 1} of {self.source}"

    def __eq__(self, other: object) -> bool:
        return self is other or (isinstance(other, FrozenPatch) and other.digest == self.digest)

    def __hash__(self) -> int:
        return hash(self.digest)


def _around(result: Result, points: Float32Array) -> Float32Array:
    """Return proximity points near the patch, or all that are in the range of the views where there is none."""
    camera, counts = result.source.rig.proximity, result.frame.proximity_depth
    chosen = np.zeros(counts.shape, np.bool_)
    chosen[::_CONTEXT_STEP, ::_CONTEXT_STEP] = valid_depth(counts[::_CONTEXT_STEP, ::_CONTEXT_STEP])
    around = deproject(counts, camera, np.flatnonzero(chosen))
    if len(points):
        low, high = points.min(axis=0) - _CONTEXT_MARGIN_M, points.max(axis=0) + _CONTEXT_MARGIN_M
        return np.asarray(around[((around >= low) & (around <= high)).all(axis=1)])
    near, far = result.rendered.depth_range_m
    return np.asarray(around[(around[:, 2] >= near) & (around[:, 2] <= far)])
