"""Pixels that may be contact, and how they are found and thinned out: the stages of the pipeline."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from ..model.arrays import BoolArray, Float32Array, IndexArray, Uint8Array
from ..model.frames import Rig, SensorFrame
from ..model.intrinsics import Intrinsics
from ..model.provenance import Provenance
from ..preset import OutlierSection, Preset
from .alignment import AlignedDepth, AlignmentModel
from .flat import flat, ray_planes
from .fusion import depth_limits, region_bounds
from .kernels import chain as kernels
from .kernels.coarse import CoarseTest
from .kernels.colors import hsv_limits
from .kernels.compiling import kernel
from .kernels.simd import LANES
from .kernels.threads import by_rows
from .masking import color_lookup_of
from .outliers.clusters import in_large_cluster
from .outliers.statistical import NeighbourMemory

#: Tells which points are no outliers, as `outliers.statistical.statistical_inliers` does.
Inliers = Callable[[Float32Array, IndexArray, Intrinsics, int, float, NeighbourMemory], BoolArray]

_NO_LIMITS = np.empty(0, np.int64)


@dataclass(frozen=True, eq=False)
class Candidates:
    """Pixels that are still in the running, with their points.

    Attributes
    ----------
    pixels : int, shape (N,)
        Flat proximity pixel numbers, ascending.
    points : float32, shape (N, 3)
        Metres, proximity depth frame.
    """

    pixels: IndexArray
    points: Float32Array

    def __len__(self) -> int:
        return len(self.pixels)

    def keep(self, which: BoolArray) -> Candidates:
        """Return those that ``which`` (bool, shape (N,)) marks."""
        count = int(np.count_nonzero(which))
        if count == len(self):
            return self
        pixels, points = np.empty(count, np.intp), np.empty((count, 3), np.float32)
        _compact(which, self.pixels, self.points, pixels, points)
        return Candidates(pixels, points)


NO_CANDIDATES: Final = Candidates(np.empty(0, np.intp), np.empty((0, 3), np.float32))

#: So few tiles are not worth waking other threads for.
_TILES_ALONE = 300


@kernel
def _compact(which: Any, pixels: Any, points: Any, pixels_out: Any, points_out: Any) -> None:
    count = 0
    for i in range(len(which)):
        if which[i]:
            pixels_out[count] = pixels[i]
            points_out[count, 0] = points[i, 0]
            points_out[count, 1] = points[i, 1]
            points_out[count, 2] = points[i, 2]
            count += 1


def depth_images(frame: SensorFrame) -> kernels.DepthImages:
    """Return the depth images of a frame as the kernels take them."""
    return kernels.DepthImages(flat(frame.proximity_depth), flat(frame.tactile_depth))


class PixelTests:
    """What a preset and rig say of single pixels, with tables and buffers. For one thread at a time.

    Attributes
    ----------
    test : kernels.PixelTest
    """

    def __init__(self, preset: Preset, rig: Rig, alignment: AlignmentModel) -> None:
        self.alignment = alignment
        self.coarse = CoarseTest(alignment.tables)
        camera = rig.proximity.intrinsics
        self.test = kernels.PixelTest(
            alignment.tables,
            region_bounds(preset.region, camera.shape),
            depth_limits(preset.range, preset.tolerance),
            ray_planes(camera),
        )
        self._lookup = color_lookup_of(rig)
        self._hsv = hsv_limits(preset.mask) if preset.mask.enabled else _NO_LIMITS

    def aligned(self, frame: SensorFrame) -> AlignedDepth:
        """Return both sides of the tolerance test."""
        return self.alignment.align(frame.proximity_depth, frame.tactile_depth, self.test.region)

    def color_test(self, frame: SensorFrame) -> kernels.ColorTest:
        """Return the colour mask of a frame."""
        return kernels.ColorTest(self._lookup, flat(frame.proximity_color, 3 * LANES), self._hsv)

    def classify(self, frame: SensorFrame) -> Uint8Array:
        """Return each pixel's verdict of depth, region, range and tolerance; candidates have CONTACT."""
        provenance = np.empty(frame.proximity_depth.shape, np.uint8)
        images, verdicts = depth_images(frame), provenance.reshape(-1)
        by_rows(
            lambda first, last: kernels.classify_rows(images, self.test, first, last, verdicts),
            len(provenance),
        )
        return provenance


class CandidateFinder(PixelTests):
    """The per-pixel chain of the tolerance test."""

    def find(self, frame: SensorFrame, buffers: CandidateBuffers) -> Candidates:
        """Return the pixels that pass the tolerance test and the colour mask."""
        height, width = frame.proximity_depth.shape
        images = depth_images(frame)
        tiles, possible = self.coarse.tiles(images, self.test.limits)
        if possible == 0:
            return NO_CANDIDATES
        color = self.color_test(frame)
        out = kernels.CandidateArrays(buffers.pixels, buffers.points.reshape(-1))
        counts: dict[int, int] = {}

        def find_rows(first: int, last: int) -> None:
            counts[first * width] = kernels.find_candidates(images, self.test, color, tiles, first, last, out)

        if possible <= _TILES_ALONE:
            find_rows(0, height)
        else:
            by_rows(find_rows, height)
        return buffers.collect(counts)


class CandidateBuffers:
    """Room for every pixel of an image, used again for each frame."""

    def __init__(self, rig: Rig) -> None:
        height, width = rig.proximity.intrinsics.shape
        self.pixels = np.empty(height * width, np.intp)
        self.points = np.empty((height * width, 3), np.float32)

    def collect(self, counts: dict[int, int]) -> Candidates:
        """Copy out what parts of the work have written: ``counts`` from each beginning."""
        parts = [slice(start, start + counts[start]) for start in sorted(counts) if counts[start]]
        if not parts:
            return NO_CANDIDATES
        return Candidates(
            np.concatenate([self.pixels[part] for part in parts]), np.concatenate([self.points[part] for part in parts])
        )


@dataclass(frozen=True, eq=False)
class Found:
    """What a contact test has found in a frame.

    Attributes
    ----------
    contact : Candidates
    make_provenance : callable
        Makes the verdict on each pixel, uint8 (H, W), when it is asked for.
    skipped : tuple of str
        As in `patch.ContactPatch`.
    """

    contact: Candidates
    make_provenance: Callable[[], Uint8Array]
    skipped: tuple[str, ...] = ()


def drop_outliers(
    candidates: Candidates, rig: Rig, section: OutlierSection, inliers: Inliers, memory: NeighbourMemory
) -> Candidates:
    """Drop statistical outliers."""
    if not section.enabled or len(candidates) == 0:
        return candidates
    kept = inliers(candidates.points, candidates.pixels, rig.proximity.intrinsics, section.k, section.ratio, memory)
    return candidates.keep(kept)


def drop_small_clusters(candidates: Candidates, rig: Rig, section: OutlierSection) -> Candidates:
    """Drop connected groups that are smaller than the preset's smallest cluster."""
    large = in_large_cluster(
        candidates.points[:, 2], candidates.pixels, rig.proximity.intrinsics, section.min_cluster_area_mm2
    )
    return candidates.keep(large)


def contact_mask(shape: tuple[int, int], contact: Candidates) -> BoolArray:
    """Return the image of the pixels in contact."""
    mask = np.zeros(shape, np.bool_)
    mask.reshape(-1)[contact.pixels] = True
    return mask


def full_provenance(verdicts: Uint8Array, unmasked: Candidates, inliers: Candidates, contact: Candidates) -> Uint8Array:
    """Write the verdicts of the later stages over those of `PixelTests.classify`."""
    pixels = verdicts.reshape(-1)
    pixels[pixels == Provenance.CONTACT] = Provenance.MASKED
    pixels[unmasked.pixels] = Provenance.OUTLIER
    pixels[inliers.pixels] = Provenance.SMALL_CLUSTER
    pixels[contact.pixels] = Provenance.CONTACT
    return verdicts
