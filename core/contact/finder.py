"""Base of the implementations of contact tests: cached steps, per-pixel tests and buffers."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from functools import lru_cache
from typing import Any, Final

import numpy as np

from ..model.arrays import Float32Array, Uint8Array
from ..model.clouds import ray_table
from ..model.frames import Rig, SensorFrame
from ..model.intrinsics import Intrinsics
from ..model.patch import NO_CANDIDATES, AlignedDepth, Candidates, Found
from ..preset import Preset, RangeSection, RegionSection, ToleranceSection
from .alignment import AlignmentModel
from .kernels import chain as kernels
from .kernels.coarse import CoarseTest
from .kernels.colors import hsv_limits
from .kernels.simd import LANES
from .kernels.threads import by_rows
from .masking import color_lookup_of
from .outliers.statistical import NeighbourMemory

#: Below this number of image tiles, one thread is faster than several.
MAX_TILES_ALONE: Final = 300
_NO_LIMITS = np.empty(0, np.int64)
_NEVER_RUN = object()


class Steps:
    """Tells which steps of a frame are due, and times them.

    A step is due if the frame is new, one of its preset fields has changed, or an earlier step has run. Its time ends
    when the next step is asked for::

        if due("outliers"):
            self._inliers = drop_outliers(...)

    Parameters
    ----------
    keys : dict of str to tuple
        The values of each step's preset fields, in the order of the steps.
    done : dict of str to object
        The keys with which steps have run on this frame; updated.

    Attributes
    ----------
    ms : dict of str to float
        Milliseconds of each step; 0 for a step that was not due.
    stale : bool
        Whether a step has run.
    """

    def __init__(self, keys: dict[str, Any], done: dict[str, Any]) -> None:
        self._keys = keys
        self._done = done
        self._running = ""
        self._started_ns = 0
        self.stale = False
        self.ms = dict.fromkeys(keys, 0.0)

    def __call__(self, name: str) -> bool:
        """Return whether a step is due; if so, start its clock."""
        self.finish()
        if not self.stale and self._done.get(name, _NEVER_RUN) == self._keys[name]:
            return False
        self.stale = True
        self._done.pop(name, None)  # until it has finished
        self._running, self._started_ns = name, time.perf_counter_ns()
        return True

    def finish(self) -> None:
        """End the time of the step that runs."""
        if self._running:
            self.ms[self._running] = (time.perf_counter_ns() - self._started_ns) / 1e6
            self._done[self._running] = self._keys[self._running]
            self._running = ""


class CandidateBuffers:
    """Room for every pixel of an image, reused for each frame."""

    def __init__(self, rig: Rig) -> None:
        height, width = rig.proximity.intrinsics.shape
        self.pixels = np.empty(height * width, np.intp)
        self.points = np.empty((height * width, 3), np.float32)

    def collect(self, counts: dict[int, int]) -> Candidates:
        """Copy out what was written: first index of each part to its number of pixels."""
        parts = [slice(start, start + counts[start]) for start in sorted(counts) if counts[start]]
        if not parts:
            return NO_CANDIDATES
        return Candidates(
            np.concatenate([self.pixels[part] for part in parts]), np.concatenate([self.points[part] for part in parts])
        )


class Workspace:
    """State that is kept when the preset changes: the rig, buffers, and the cache of the outlier removal."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.buffers = CandidateBuffers(rig)
        self.neighbours = NeighbourMemory()

    def aligned(self, frame: SensorFrame, alignment: AlignmentModel, region: RegionSection) -> AlignedDepth:
        """Return both depths for every proximity pixel of a region; nan elsewhere."""
        bounds = region_bounds(region, self.rig.proximity.intrinsics.shape)
        return alignment.align(frame.proximity_depth, frame.tactile_depth, bounds)


class ContactFinder(ABC):
    """The implementation of a contact test: finds contact in frames. For one thread at a time.

    A new one is made when a field of the test's first step changes; later fields are read in `find`.

    Parameters
    ----------
    preset : Preset
    rig : Rig
    alignment : AlignmentModel
    workspace : Workspace, optional

    Attributes
    ----------
    test : kernels.PixelTest
        The test of single pixels, for the kernels.
    """

    def __init__(self, preset: Preset, rig: Rig, alignment: AlignmentModel, workspace: Workspace | None = None) -> None:
        self.alignment = alignment
        self.coarse = CoarseTest(alignment.tables)
        camera = rig.proximity.intrinsics
        self.test = kernels.PixelTest(
            alignment.tables,
            region_bounds(preset.region, camera.shape),
            depth_limits(preset.range, preset.tolerance),
            _ray_planes(camera),
        )
        self._rig = rig
        self._workspace = workspace or Workspace(rig)
        self._lookup = color_lookup_of(rig)
        self._hsv = hsv_limits(preset.mask) if preset.mask.enabled else _NO_LIMITS

    @abstractmethod
    def find(self, frame: SensorFrame, preset: Preset, due: Steps) -> Found:
        """Return the contact in a frame; run only the steps that are due."""

    def color_test(self, frame: SensorFrame) -> kernels.ColorTest:
        """Return the colour mask of a frame."""
        return kernels.ColorTest(self._lookup, kernels.flat(frame.proximity_color, 3 * LANES), self._hsv)

    def classify(self, frame: SensorFrame) -> Uint8Array:
        """Return each pixel's verdict of depth, region, range and tolerance; candidates have CONTACT."""
        provenance = np.empty(frame.proximity_depth.shape, np.uint8)
        images, verdicts = depth_images(frame), provenance.reshape(-1)
        by_rows(
            lambda first, last: kernels.classify_rows(images, self.test, first, last, verdicts),
            len(provenance),
        )
        return provenance


def depth_images(frame: SensorFrame) -> kernels.DepthImages:
    """Return the depth images of a frame, flat, for the kernels."""
    return kernels.DepthImages(kernels.flat(frame.proximity_depth), kernels.flat(frame.tactile_depth))


def region_bounds(section: RegionSection, shape: tuple[int, int]) -> kernels.Region:
    """Return the region in pixels, clipped to the image."""
    height, width = shape
    if not section.enabled:
        return kernels.Region(0, 0, width, height)
    left, top, region_width, region_height = section.rectangle
    return kernels.Region(left, top, min(left + region_width, width), min(top + region_height, height))


def depth_limits(limits: RangeSection, tolerance: ToleranceSection) -> kernels.DepthLimits:
    """Return the nearest and farthest depth considered (metres), and the tolerance."""
    near, far = limits.limits_m if limits.enabled else (0.0, np.inf)
    return kernels.DepthLimits(np.float32(near), np.float32(far), np.float32(tolerance.t))


@lru_cache(maxsize=8)
def _ray_planes(intrinsics: Intrinsics) -> Float32Array:
    """Return `ray_table` for the kernels: all x / z, then all y / z, flat."""
    return kernels.planes_of(ray_table(intrinsics))
