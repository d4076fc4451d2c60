"""The tolerance test: a pixel is in contact where both distances agree within a share of the distance."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from ..model.provenance import Provenance
from .contact_test import (
    HARMLESS_SHARE,
    MASK_REASON,
    PIXEL_FIELDS,
    BiasLimits,
    ContactTest,
    DropReason,
    FusionVariant,
    Step,
    TestSection,
)
from .sections import Section, described


class ToleranceSection(Section):
    """The contact test |dp - dt| <= t |dp|."""

    t: Annotated[
        float,
        described(
            "Tolerance t",
            "A pixel is in contact where both distances agree within this share of the distance.",
            unit="share",
            scale="log",
            slider=(0.001, 0.3),
            step=0.001,
        ),
        Field(ge=0.0, le=1.0),
    ] = 0.03


class OutlierSection(Section):
    """Statistical outlier removal (Open3D's definition) and the smallest cluster kept."""

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
        ),
        Field(ge=1, le=1000),
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
    min_cluster_area_mm2: Annotated[
        float,
        described(
            "Smallest cluster",
            "Connected groups of contact pixels with a smaller area are dropped. 0 keeps all.",
            unit="mm2",
            slider=(0.0, 500.0),
            step=5.0,
        ),
        Field(ge=0.0, le=1e6),
    ] = 0.0


class ToleranceTest(ContactTest[ToleranceSection]):
    """``|dp - dt| <= t |dp|``, pixel by pixel, as published by Yin et al."""

    name = "tolerance"
    implementation = "tactune.core.contact.tolerance:ToleranceFinder"
    sections = (
        TestSection("tolerance", "Tolerance", ToleranceSection),
        TestSection("outliers", "Outliers", OutlierSection),
    )
    steps = (
        Step("fusion", (*PIXEL_FIELDS, "tolerance")),
        Step("outliers", ("outliers.enabled", "outliers.k", "outliers.ratio")),
        Step("clusters", ("outliers.min_cluster_area_mm2",)),
    )
    summary = "a pixel is in contact where both distances agree within t, as published."
    note = "Each pixel by itself, as published."
    looser_words = "raise the tolerance t"
    drop_reasons = {
        Provenance.MASKED: MASK_REASON,
        Provenance.OUTLIER: DropReason("the outlier removal", "raise its ratio, or switch it off"),
        Provenance.SMALL_CLUSTER: DropReason("the limit on small clusters", "lower the smallest cluster"),
    }
    variants = (
        FusionVariant(
            "fusion-rigid",
            {"contact_test": "tolerance", "alignment.model": "rigid"},
            "Contact where both cameras measure the same distance, aligned by the tactile camera's pose",
            (213, 94, 0),
        ),
        FusionVariant(
            "fusion-homography",
            {"contact_test": "tolerance", "alignment.model": "homography"},
            "Contact where both cameras measure the same distance, aligned by a homography as published",
            (230, 159, 0),
        ),
    )

    def accepted_share(self, section: ToleranceSection, distance_m: float) -> float:
        """Return t."""
        return section.t

    def bias_limits(self, section: ToleranceSection, distance_m: float) -> BiasLimits:
        """Return a third of t, and t, at this distance."""
        reason = f"below {100 * HARMLESS_SHARE * section.t:.2g} %, a third of the tolerance t"
        return BiasLimits(HARMLESS_SHARE * section.t * distance_m, section.t * distance_m, reason)


TOLERANCE = ToleranceTest()
