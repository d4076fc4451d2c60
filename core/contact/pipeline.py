"""The contact pipeline: one frame and a preset in, the contact patch out."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ParamSpec, TypeVar

from ..model.frames import Rig, SensorFrame
from ..preset import Preset
from ..preset.rig_check import check_rig
from .alignment import AlignmentModel, make_alignment
from .candidates import (
    CandidateBuffers,
    CandidateFinder,
    Found,
    Inliers,
    contact_mask,
    drop_outliers,
    drop_small_clusters,
    full_provenance,
)
from .flat import flat
from .kernels import chain as kernels
from .membrane import stages as membrane_stages
from .membrane.average import SteadyDepth
from .membrane.balance import balanced_contact
from .membrane.differences import DifferenceFinder
from .membrane.press import pressed_contact
from .outliers.statistical import NeighbourMemory, statistical_inliers
from .patch import ContactPatch, Once

__all__ = ["MEMBRANE_STAGES", "STAGES", "ContactPatch", "ContactPipeline", "Still"]

#: Of the tolerance test. The fusion aligns, tests tolerance and colour and deprojects, all in one pass.
STAGES = ("fusion", "outliers", "clusters")
#: Of the membrane test. Here the fusion aligns and tests difference and colour.
MEMBRANE_STAGES = ("fusion", "gaps", "edge", "press", "balance", "clusters", "points")
#: Comes before them where depth is averaged over frames.
AVERAGE = "average"

#: Reasons in `ContactPatch.skipped`.
UNCHANGED = "nothing changed"
STILL = "no depth changed beyond noise"
NO_CANDIDATES = "no candidates"

P = ParamSpec("P")
R = TypeVar("R")


@dataclass(frozen=True)
class Still:
    """When a frame counts as showing what an earlier one has shown, so that its patch is given once more.

    Attributes
    ----------
    noise_m : float
        A depth that differs by no more has not changed, metres; about five standard deviations of the noise.
    share : float
        The largest share of an image's pixels that may have changed all the same, such as flickering edges.
    """

    noise_m: float
    share: float = 0.001


class ContactPipeline:
    """Finds the contact patch of one frame after another.

    Stages are remembered: pushing the same frame again, or a preset that differs in a late stage
    only, repeats nothing that comes before it. Not to be shared between threads; each thread may have
    its own.

    Parameters
    ----------
    preset : Preset
    rig : Rig
        The rig that takes the frames.
    still : Still, optional
        Give the last patch again while nothing moves; without it every frame is computed. The depths of
        a frame are compared with those that the patch was computed from, so small changes do not add up.
    inliers : callable, optional
        Takes the place of `statistical_inliers`, such as one of `outliers.variants`.

    Raises
    ------
    RigMismatchError
        The preset was made for images of another size, or lacks a pose that the rig lacks too.
    """

    def __init__(
        self, preset: Preset, rig: Rig, *, still: Still | None = None, inliers: Inliers = statistical_inliers
    ) -> None:
        self.rig = rig
        self._still = still
        self._inliers = inliers
        self.warnings = check_rig(preset, rig)
        self._preset = preset
        self._finder = _make_finder(preset, rig, make_alignment(preset.alignment, rig))
        self._buffers = CandidateBuffers(rig)
        self._neighbours = NeighbourMemory()
        self._memory = _Memory()
        self._steady: SteadyDepth | None = None
        self._average(averaged_frames(preset))

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
        alignment = self._finder.alignment
        if preset.alignment.geometry != self._preset.alignment.geometry:
            alignment = make_alignment(preset.alignment, self.rig)
        if _fusion_key(preset) != _fusion_key(self._preset):
            self._finder = _make_finder(preset, self.rig, alignment)
        self._average(averaged_frames(preset))
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
            started = time.perf_counter_ns()
            if self._shows_the_same(frame):
                ms = dict.fromkeys(stages_of(self._preset), 0.0) | {"fusion": (time.perf_counter_ns() - started) / 1e6}
                assert self._memory.patch is not None
                return self._memory.patch.again(frame.sequence, ms, (STILL,))
            self._memory = _Memory(frame)
        stage = _StageRunner(self._memory, stages_of(self._preset))
        if self._steady is not None:
            frame = stage(AVERAGE, None, self._steady.add, frame)
        self._memory.preset = self._preset
        if isinstance(self._finder, DifferenceFinder):
            found = self._membrane_test(frame, self._finder, stage)
        else:
            found = self._tolerance_test(frame, self._finder, stage)
        averaged = self._steady.count if self._steady is not None else 1
        return self._memory.patch_of(frame, self.rig, self._finder, found, stage, averaged)

    def _average(self, frames: int) -> None:
        """Average so many frames from now on; what is remembered stays, unless none shall be averaged."""
        if frames == 1:
            if self._steady is not None:
                self._steady, self._memory = None, _Memory()
        elif self._steady is None:
            self._steady = SteadyDepth(self.rig, frames)
        else:
            self._steady.most = frames

    def _tolerance_test(self, frame: SensorFrame, finder: CandidateFinder, stage: _StageRunner) -> Found:
        outliers = self._preset.outliers
        unmasked = stage("fusion", _fusion_key(self._preset), finder.find, frame, self._buffers)
        if len(unmasked) == 0:
            return Found(unmasked, lambda: full_provenance(finder.classify(frame), *[unmasked] * 3), (NO_CANDIDATES,))
        inliers = stage(
            "outliers", (outliers.enabled, outliers.k, outliers.ratio),
            drop_outliers, unmasked, self.rig, outliers, self._inliers, self._neighbours,
        )  # fmt: skip
        contact = stage("clusters", outliers.min_cluster_area_mm2, drop_small_clusters, inliers, self.rig, outliers)
        return Found(contact, lambda: full_provenance(finder.classify(frame), unmasked, inliers, contact))

    def _membrane_test(self, frame: SensorFrame, finder: DifferenceFinder, stage: _StageRunner) -> Found:
        section = self._preset.membrane
        differences = stage("fusion", _fusion_key(self._preset), finder.find, frame)
        if differences is None:
            return Found(self._buffers.collect({}), lambda: finder.classify(frame), (NO_CANDIDATES,))
        gaps = stage(
            "gaps", (section.window_px, section.bias_m, section.slope),
            membrane_stages.mean_gaps, differences, section, self.rig,
        )  # fmt: skip
        if gaps is None:
            early = differences
            return Found(
                self._buffers.collect({}),
                lambda: membrane_stages.early_provenance(finder.classify(frame), early),
                (NO_CANDIDATES,),
            )
        within = stage(
            "edge", (section.gap_m, section.erosion, section.core_share, section.max_erosion_px),
            membrane_stages.within_edge, gaps, section,
        )  # fmt: skip
        pressed = stage(
            "press", (section.curvature, section.curvature_px, section.curvature > 0 or section.balance),
            pressed_contact, within, gaps, frame, self._preset, self.rig, finder.alignment,
        )  # fmt: skip
        balanced = stage("balance", section.balance, balanced_contact, pressed, gaps, section, self.rig)
        large = stage(
            "clusters", section.min_area_mm2,
            membrane_stages.large_contacts, balanced, gaps, section, self.rig,
        )  # fmt: skip
        contact = stage(
            "points", (section.smooth_px, section.tactile_weight),
            membrane_stages.surface_points, large, gaps, section, self.rig, self._buffers,
        )  # fmt: skip
        steps = differences, gaps, section, within, pressed.contact, balanced, large, contact
        return Found(contact, lambda: membrane_stages.full_provenance(finder.classify(frame), *steps))

    def _shows_the_same(self, frame: SensorFrame) -> bool:
        """Tell whether the patch in memory, made with the present preset, may stand for a new frame."""
        before = self._memory.frame
        if self._still is None or before is None or self._memory.preset is not self._preset:
            return False
        if self._steady is not None and not self._steady.full:
            return False
        pairs = (
            (before.proximity_depth, frame.proximity_depth, self.rig.proximity.depth_unit_m),
            (before.tactile_depth, frame.tactile_depth, self.rig.tactile.depth_unit_m),
        )
        for old, new, unit_m in pairs:
            noise = min(int(self._still.noise_m / unit_m), 65535)
            if kernels.count_changed(flat(old), flat(new), noise) > self._still.share * old.size:
                return False
        return True


def stages_of(preset: Preset) -> tuple[str, ...]:
    """Return the names of the stages of a preset's contact test, in their order."""
    if preset.contact_test == "tolerance":
        return STAGES
    return (AVERAGE, *MEMBRANE_STAGES) if averaged_frames(preset) > 1 else MEMBRANE_STAGES


def _make_finder(preset: Preset, rig: Rig, alignment: AlignmentModel) -> CandidateFinder | DifferenceFinder:
    make = DifferenceFinder if preset.contact_test == "membrane" else CandidateFinder
    return make(preset, rig, alignment)


def averaged_frames(preset: Preset) -> int:
    """Return over how many frames depth is averaged at most; with 1 no result depends on earlier frames."""
    return preset.membrane.frames if preset.contact_test == "membrane" else 1


def _fusion_key(preset: Preset) -> tuple[Any, ...]:
    """Return all that decides what the first stage gives."""
    common = preset.contact_test, preset.alignment.geometry, preset.region, preset.range, preset.mask
    if preset.contact_test == "membrane":
        section = preset.membrane
        return *common, section.difference_m, max(section.window_px, section.smooth_px)
    return *common, preset.tolerance


@dataclass
class _Memory:
    """What each stage gave for the present frame, and the patch assembled from it."""

    frame: SensorFrame | None = None
    results: dict[str, tuple[Any, Any]] = field(default_factory=dict)
    patch: ContactPatch | None = None
    preset: Preset | None = None

    def patch_of(
        self,
        frame: SensorFrame,
        rig: Rig,
        finder: CandidateFinder | DifferenceFinder,
        found: Found,
        stages: _StageRunner,
        averaged_frames: int,
    ) -> ContactPatch:
        """Assemble the patch from what the contact test has found."""
        if self.patch is not None and not stages.stale:
            return self.patch.again(frame.sequence, stages.ms, (UNCHANGED,))
        self.patch = ContactPatch(
            frame.sequence,
            found.contact.points,
            Once(found.make_provenance),
            Once(lambda: finder.aligned(frame)),
            rig,
            stages.ms,
            found.skipped,
            mask=Once(lambda: contact_mask(frame.proximity_depth.shape, found.contact)),
            averaged_frames=averaged_frames,
        )
        return self.patch


class _StageRunner:
    """Runs stages in order, skipping those whose frame, key and predecessors are unchanged."""

    def __init__(self, memory: _Memory, names: tuple[str, ...]) -> None:
        self._memory = memory
        self.stale = False
        self.ms = dict.fromkeys(names, 0.0)

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
