"""The tolerance test: both distances agree pixel by pixel; then outliers and small clusters are dropped."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..model.arrays import BoolArray, Uint8Array
from ..model.frames import Rig, SensorFrame
from ..model.patch import NO_CANDIDATES, Candidates, Found
from ..model.provenance import Provenance
from ..preset import OutlierSection, Preset
from .alignment import AlignmentModel
from .finder import MAX_TILES_ALONE, ContactFinder, Steps, Workspace, depth_images
from .kernels import chain as kernels
from .kernels.compiling import kernel
from .kernels.threads import by_rows
from .outliers.clusters import in_large_cluster
from .outliers.statistical import statistical_inliers


class ToleranceFinder(ContactFinder):
    """Computes the tolerance test."""

    def __init__(self, preset: Preset, rig: Rig, alignment: AlignmentModel, workspace: Workspace | None = None) -> None:
        super().__init__(preset, rig, alignment, workspace)
        self._unmasked = self._inliers = self._contact = NO_CANDIDATES

    def find(self, frame: SensorFrame, preset: Preset, due: Steps) -> Found:
        """Return the contact in a frame."""
        if due("fusion"):
            self._unmasked = self.candidates(frame)
        if len(self._unmasked) == 0:
            unmasked = self._unmasked
            return Found(unmasked, lambda: full_provenance(self.classify(frame), *[unmasked] * 3), ("no candidates",))
        if due("outliers"):
            self._inliers = drop_outliers(self._unmasked, self._rig, preset.outliers, self._workspace)
        if due("clusters"):
            self._contact = drop_small_clusters(self._inliers, self._rig, preset.outliers)
        steps = self._unmasked, self._inliers, self._contact
        return Found(self._contact, lambda: full_provenance(self.classify(frame), *steps))

    def candidates(self, frame: SensorFrame) -> Candidates:
        """Return the pixels that pass the tolerance test and the colour mask."""
        height, width = frame.proximity_depth.shape
        images = depth_images(frame)
        tiles, possible = self.coarse.tiles(images, self.test.limits)
        if possible == 0:
            return NO_CANDIDATES
        color, buffers = self.color_test(frame), self._workspace.buffers
        out = kernels.CandidateArrays(buffers.pixels, buffers.points.reshape(-1))
        counts: dict[int, int] = {}

        def find_rows(first: int, last: int) -> None:
            counts[first * width] = kernels.find_candidates(images, self.test, color, tiles, first, last, out)

        if possible <= MAX_TILES_ALONE:
            find_rows(0, height)
        else:
            by_rows(find_rows, height)
        return buffers.collect(counts)


def drop_outliers(candidates: Candidates, rig: Rig, section: OutlierSection, workspace: Workspace) -> Candidates:
    """Return the candidates without statistical outliers."""
    if not section.enabled or len(candidates) == 0:
        return candidates
    inliers = statistical_inliers(
        candidates.points, candidates.pixels, rig.proximity.intrinsics, section.k, section.ratio, workspace.neighbours
    )
    return keep(candidates, inliers)


def drop_small_clusters(candidates: Candidates, rig: Rig, section: OutlierSection) -> Candidates:
    """Return the candidates without connected groups smaller than the preset's smallest cluster."""
    camera = rig.proximity.intrinsics
    large = in_large_cluster(candidates.points[:, 2], candidates.pixels, camera, section.min_cluster_area_mm2)
    return keep(candidates, large)


def full_provenance(verdicts: Uint8Array, unmasked: Candidates, inliers: Candidates, contact: Candidates) -> Uint8Array:
    """Write the verdicts of the later steps over those of `ContactFinder.classify`."""
    pixels = verdicts.reshape(-1)
    pixels[pixels == Provenance.CONTACT] = Provenance.MASKED
    pixels[unmasked.pixels] = Provenance.OUTLIER
    pixels[inliers.pixels] = Provenance.SMALL_CLUSTER
    pixels[contact.pixels] = Provenance.CONTACT
    return verdicts


def keep(candidates: Candidates, which: BoolArray) -> Candidates:
    """Return the candidates that ``which`` (bool, shape (N,)) marks."""
    count = int(np.count_nonzero(which))
    if count == len(candidates):
        return candidates
    pixels, points = np.empty(count, np.intp), np.empty((count, 3), np.float32)
    _compact(which, candidates.pixels, candidates.points, pixels, points)
    return Candidates(pixels, points)


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
