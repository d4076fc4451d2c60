"""The tolerance test, as published by Yin et al.: both distances agree within a share of the distance.

Depth ranges of image tiles exclude those that cannot hold contact (`kernels.coarse`). In the others one pass over
sixteen pixels at once aligns, tests region, range, |dp - dt| <= t |dp| and colour, deprojects (`kernels.tolerance`).
Rigid alignment projects each proximity point into the tactile image and reads the depth there: no holes, exact at
contact. Then statistical outliers and small contacts are dropped.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from ..model.arrays import Uint8Array
from ..model.frames import SensorFrame
from ..model.patch import NO_CANDIDATES, Candidates, Found, Provenance
from ..model.sections import Section, SmallestContact, described
from .contact_test import HARMLESS_SHARE, MASK_REASON, PIXEL_FIELDS, BiasLimits, ContactTest, DropReason, Steps

if TYPE_CHECKING:
    from ..preset import Preset
    from .pixels import Pixels


class ToleranceSection(Section):
    """The contact test |dp - dt| <= t |dp|."""

    t: Annotated[
        float,
        described(
            "Tolerance t",
            "A pixel is in contact where |dp - dt| <= t |dp|: dt is the tactile depth, dp that of the proximity point "
            "after its move into the tactile camera's frame.",
            unit="share",
            scale="log",
            slider=(0.001, 0.3),
            step=0.001,
            limits=(0.0, 1.0),
        ),
    ] = 0.03


class OutlierSection(Section):
    """Statistical outlier removal (Open3D's definition) and the smallest contact kept."""

    enabled: Annotated[
        bool, described("Remove outliers", "Drop points that lie unusually far from their neighbours.")
    ] = True
    k: Annotated[
        int,
        described(
            "Neighbours k",
            "Number of nearest points averaged for each point. The point itself counts as one, as in Open3D; "
            "PCL counts one less.",
            unit="points",
            slider=(1, 100),
            advanced=True,
            limits=(1, 1000),
        ),
    ] = 20
    ratio: Annotated[
        float,
        described(
            "Ratio",
            "Points whose mean neighbour distance exceeds the mean by this many standard deviations are dropped.",
            unit="sigma",
            slider=(0.1, 5.0),
            step=0.1,
            advanced=True,
        ),
        Field(gt=0.0, le=100.0),
    ] = 2.0
    min_cluster_area_mm2: SmallestContact = 0.0


class ToleranceTest(ContactTest):
    """``|dp - dt| <= t |dp|``, pixel by pixel.

    dt is the tactile depth; dp is the z of the proximity point after its move into the tactile camera's frame,
    ``(T_tactile_proximity p)_z``, and with a homography the proximity depth itself.
    """

    name = "tolerance"
    sections = {"tolerance": ToleranceSection, "outliers": OutlierSection}
    steps = {
        "fusion": (*PIXEL_FIELDS, "tolerance"),
        "outliers": ("outliers.enabled", "outliers.k", "outliers.ratio"),
        "clusters": ("outliers.min_cluster_area_mm2",),
    }
    summary = "a pixel is in contact where both distances agree within t, as published."
    note = "Each pixel by itself, as published."
    smallest_field = "outliers.min_cluster_area_mm2"
    looser_words = "raise the tolerance t"
    drop_reasons = {
        Provenance.MASKED: MASK_REASON,
        Provenance.OUTLIER: DropReason("the outlier removal", "raise its ratio, or switch it off"),
        Provenance.SMALL_CLUSTER: DropReason("the limit on small contacts", "lower the smallest contact"),
    }

    def __init__(self, pixels: Pixels) -> None:
        super().__init__(pixels)
        self._candidates = self._inliers = self._contact = NO_CANDIDATES

    def find(self, frame: SensorFrame, preset: Preset, due: Steps) -> Found:
        pixels, section, t = self.pixels, preset.outliers, preset.tolerance.t
        camera = pixels.rig.proximity.intrinsics
        if due("fusion"):
            self._candidates = pixels.candidates(frame, t)
        if len(self._candidates) == 0:
            nothing = self._candidates, NO_CANDIDATES, NO_CANDIDATES
            return Found(NO_CANDIDATES, lambda: _provenance(pixels, frame, t, *nothing), ("no candidates",))
        from .outliers.clusters import without_small_clusters  # a frame without candidates does not wait for it
        from .outliers.statistical import without_outliers

        if due("outliers"):
            self._inliers = self._candidates
            if section.enabled:
                self._inliers = without_outliers(self._candidates, pixels.workspace.grid, section.k, section.ratio)
        if due("clusters"):
            self._contact = without_small_clusters(self._inliers, camera, section.min_cluster_area_mm2)
        steps = self._candidates, self._inliers, self._contact
        return Found(self._contact, lambda: _provenance(pixels, frame, t, *steps))

    @classmethod
    def accepted_share(cls, preset: Preset, distance_m: float) -> float:
        return preset.tolerance.t

    @classmethod
    def bias_limits(cls, preset: Preset, distance_m: float) -> BiasLimits:
        """Return a third of t, and t, at this distance."""
        largest_m = preset.tolerance.t * distance_m
        return BiasLimits(HARMLESS_SHARE * largest_m, largest_m)


def _provenance(
    pixels: Pixels, frame: SensorFrame, t: float, candidates: Candidates, inliers: Candidates, contact: Candidates
) -> Uint8Array:
    image = pixels.classify(frame)
    verdicts = image.reshape(-1)
    verdicts[verdicts == Provenance.CONTACT] = Provenance.OUTSIDE_TOLERANCE
    verdicts[pixels.agreeing(frame, t)] = Provenance.MASKED
    verdicts[candidates.pixels] = Provenance.OUTLIER
    verdicts[inliers.pixels] = Provenance.SMALL_CLUSTER
    verdicts[contact.pixels] = Provenance.CONTACT
    return image
