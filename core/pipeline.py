"""The contact pipeline: one frame and a preset in, the contact patch out."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ParamSpec, TypeVar

import numpy as np
import numpy.typing as npt

from .alignment import AlignedDepth, make_alignment
from .clouds import deproject
from .frames import Rig, SensorFrame
from .fusion import region_bounds, tolerance_test
from .intrinsics import Intrinsics
from .masking import is_masked
from .outliers import in_large_cluster, pixel_areas_m2, statistical_inliers
from .preset import OutlierSection, Preset
from .provenance import Provenance
from .rig_check import check_rig

STAGES = ("align", "tolerance", "mask", "outliers", "clusters")

P = ParamSpec("P")
R = TypeVar("R")


@dataclass(frozen=True, eq=False)
class ContactPatch:
    """Where the membrane touches the object, and why every other pixel was dropped.

    Attributes
    ----------
    sequence : int
        The frame's number.
    points : float32, shape (N, 3)
        Metres, proximity depth frame, in row-major pixel order.
    provenance : uint8, shape (H, W)
        Values of `Provenance`.
    aligned : AlignedDepth
        Both sides of the tolerance test.
    rig : Rig
    stage_ms : dict of str to float
        Milliseconds of each of `STAGES`; 0 for a stage that was cached or skipped.
    """

    sequence: int
    points: npt.NDArray[np.float32]
    provenance: npt.NDArray[np.uint8]
    aligned: AlignedDepth
    rig: Rig
    stage_ms: dict[str, float]

    @cached_property
    def mask(self) -> npt.NDArray[np.bool_]:
        """Bool (H, W), True in contact; its i-th True pixel belongs to ``points[i]``."""
        return np.asarray(self.provenance == Provenance.CONTACT)

    @cached_property
    def relative_difference(self) -> npt.NDArray[np.float32]:
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


class ContactPipeline:
    """Finds the contact patch of one frame after another.

    Stages are remembered: pushing the same frame again, or a preset that differs in a late stage
    only, repeats nothing that comes before it. Not to be shared between threads.

    Parameters
    ----------
    preset : Preset
    rig : Rig
        The rig that takes the frames.

    Raises
    ------
    RigMismatchError
        The preset was made for images of another size, or lacks a pose that the rig lacks too.
    """

    def __init__(self, preset: Preset, rig: Rig) -> None:
        self.rig = rig
        self.warnings = check_rig(preset, rig)
        self._preset = preset
        self._alignment = make_alignment(preset.alignment, rig)
        self._memory = _Memory()

    @property
    def preset(self) -> Preset:
        """The preset in force; change it with `update`."""
        return self._preset

    def update(self, preset: Preset) -> None:
        """Use another preset from the next frame on.

        Raises
        ------
        RigMismatchError
            As the constructor does; the old preset then stays in force.
        """
        warnings = check_rig(preset, self.rig)
        if preset.alignment.geometry != self._preset.alignment.geometry:
            self._alignment = make_alignment(preset.alignment, self.rig)
        self.warnings = warnings
        self._preset = preset

    def process(self, frame: SensorFrame) -> ContactPatch:
        """Return the contact patch of a frame.

        Raises
        ------
        FrameError
            An image does not have the rig's size.
        """
        if frame is not self._memory.frame:
            frame.check_against(self.rig)
            self._memory = _Memory(frame)
        stage = _StageRunner(self._memory)
        preset, intrinsics = self._preset, self.rig.proximity.intrinsics
        region = region_bounds(preset.region, intrinsics.shape)

        aligned = stage(
            "align", (preset.alignment.geometry, preset.region),
            self._alignment.align, frame.proximity_depth, frame.tactile_depth, region,
        )  # fmt: skip
        provenance, candidates = stage(
            "tolerance", (preset.range, preset.tolerance), find_candidates, frame, aligned, region, self.rig, preset
        )
        if len(candidates) == 0:
            return self._memory.patch(frame, aligned, provenance, [(Provenance.CONTACT, candidates)], stage, self.rig)

        unmasked = stage("mask", preset.mask, drop_masked, candidates, frame, self.rig, preset)
        outliers = preset.outliers
        inliers = stage(
            "outliers", (outliers.enabled, outliers.k, outliers.ratio),
            drop_outliers, unmasked, intrinsics, outliers,
        )  # fmt: skip
        contact = stage("clusters", outliers.min_cluster_area_mm2, drop_small_clusters, inliers, self.rig, outliers)

        verdicts = [
            (Provenance.MASKED, candidates),
            (Provenance.OUTLIER, unmasked),
            (Provenance.SMALL_CLUSTER, inliers),
            (Provenance.CONTACT, contact),
        ]
        return self._memory.patch(frame, aligned, provenance, verdicts, stage, self.rig)


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

    pixels: npt.NDArray[np.intp]
    points: npt.NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.pixels)

    def keep(self, which: npt.NDArray[np.bool_]) -> Candidates:
        """Return those that ``which`` (bool, shape (N,)) marks."""
        return self if which.all() else Candidates(self.pixels[which], self.points[which])


def find_candidates(
    frame: SensorFrame, aligned: AlignedDepth, region: npt.NDArray[np.int64], rig: Rig, preset: Preset
) -> tuple[npt.NDArray[np.uint8], Candidates]:
    """Make the tolerance test; return every pixel's verdict so far and the pixels that pass."""
    provenance = tolerance_test(frame.proximity_depth, rig.proximity, aligned, region, preset.range, preset.tolerance)
    pixels = np.flatnonzero(provenance == Provenance.CONTACT)
    return provenance, Candidates(pixels, deproject(frame.proximity_depth, rig.proximity, pixels))


def drop_masked(candidates: Candidates, frame: SensorFrame, rig: Rig, preset: Preset) -> Candidates:
    """Drop candidates that have the bare membrane's colour."""
    if not preset.mask.enabled:
        return candidates
    masked = is_masked(candidates.points, candidates.pixels, frame.proximity_color, rig, preset.mask)
    return candidates.keep(~masked)


def drop_outliers(candidates: Candidates, intrinsics: Intrinsics, section: OutlierSection) -> Candidates:
    """Drop statistical outliers."""
    if not section.enabled:
        return candidates
    inliers = statistical_inliers(candidates.points, candidates.pixels, intrinsics, section.k, section.ratio)
    return candidates.keep(inliers)


def drop_small_clusters(candidates: Candidates, rig: Rig, section: OutlierSection) -> Candidates:
    """Drop connected groups that are smaller than the preset's smallest cluster."""
    large = in_large_cluster(
        candidates.points, candidates.pixels, rig.proximity.intrinsics, section.min_cluster_area_mm2
    )
    return candidates.keep(large)


@dataclass
class _Memory:
    """What each stage gave for the present frame, and the patch assembled from it."""

    frame: SensorFrame | None = None
    results: dict[str, tuple[Any, Any]] = field(default_factory=dict)
    last_patch: ContactPatch | None = None

    def patch(
        self,
        frame: SensorFrame,
        aligned: AlignedDepth,
        provenance: npt.NDArray[np.uint8],
        verdicts: list[tuple[Provenance, Candidates]],
        stages: _StageRunner,
        rig: Rig,
    ) -> ContactPatch:
        """Assemble the patch: each verdict overwrites the pixels that reached its stage."""
        if self.last_patch is not None and not stages.stale:
            return replace(self.last_patch, stage_ms=stages.ms)
        provenance = provenance.copy()
        flat = provenance.reshape(-1)
        for verdict, reached in verdicts:
            flat[reached.pixels] = verdict
        self.last_patch = ContactPatch(frame.sequence, verdicts[-1][1].points, provenance, aligned, rig, stages.ms)
        return self.last_patch


class _StageRunner:
    """Runs stages in order, skipping those whose frame, key and predecessors are unchanged."""

    def __init__(self, memory: _Memory) -> None:
        self._memory = memory
        self.stale = False
        self.ms = dict.fromkeys(STAGES, 0.0)

    def __call__(self, name: str, key: Any, compute: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
        remembered_key, result = self._memory.results.get(name, (None, None))
        if not self.stale and name in self._memory.results and remembered_key == key:
            remembered: R = result
            return remembered
        self.stale = True
        start = time.perf_counter_ns()
        fresh = compute(*args, **kwargs)
        self.ms[name] = (time.perf_counter_ns() - start) / 1e6
        self._memory.results[name] = (key, fresh)
        return fresh
