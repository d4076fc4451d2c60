"""The membrane test: contact by local means of the gap and by the shape of the membrane."""

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


class MembraneSection(Section):
    """The contact test on local means of dp - dt. Chosen on the simulator's cube, cup, octopus, knobs and star."""

    gap_m: Annotated[
        float,
        described(
            "Largest gap",
            "Pixels whose local mean gap between membrane and object is smaller are near; contact lies within them. "
            "A limit below about 1 mm is lost in the sensors' noise.",
            unit="m",
            slider=(0.0002, 0.003),
            step=0.0001,
        ),
        Field(ge=0.0, le=0.02),
    ] = 0.0014
    erosion: Annotated[
        float,
        described(
            "Erosion",
            "Share of the estimated non-touching rim that is eroded. The membrane leaves the object at a tangent, so "
            "a rim around contact is near without touching; its width is estimated from how fast the gap grows "
            "there. 0 keeps the rim.",
            slider=(0.0, 1.5),
            step=0.05,
        ),
        Field(ge=0.0, le=2.0),
    ] = 0.9
    window_px: Annotated[
        float,
        described(
            "Averaging",
            "Sigma of the Gaussian window over which gaps are averaged. A wider window resolves smaller gaps but "
            "blurs the edge. 0 averages nothing.",
            unit="px",
            slider=(0.0, 8.0),
            step=0.5,
        ),
        Field(ge=0.0, le=20.0),
    ] = 2.5
    bias_m: Annotated[
        float,
        described(
            "Largest bias",
            "Upper limit of the estimated bias between both cameras. The bias is estimated from the masked prints "
            "and from the most frequent gap, and subtracted. 0 disables the correction.",
            unit="m",
            slider=(0.0, 0.005),
            step=0.0001,
        ),
        Field(ge=0.0, le=0.02),
    ] = 0.0012
    min_area_mm2: Annotated[
        float,
        described(
            "Smallest contact",
            "Connected contacts with a smaller area are dropped. 0 keeps all.",
            unit="mm2",
            slider=(0.0, 100.0),
            step=1.0,
        ),
        Field(ge=0.0, le=1e6),
    ] = 5.0
    curvature: Annotated[
        float,
        described(
            "Largest curvature",
            "Contact needs a membrane curvature below this share of the free membrane's, because a pressing object "
            "flattens the membrane. Lightly touching regions are kept if their gap is no larger than in firm contact. "
            "It separates touching from hovering. 0 disables the test.",
            slider=(0.0, 1.5),
            step=0.05,
        ),
        Field(ge=0.0, le=10.0),
    ] = 0.7
    balance: Annotated[
        bool,
        described(
            "Balanced edge",
            "End contact where a membrane in equilibrium of tension and pressure leaves the measured object. This "
            "narrows light contacts, which are otherwise too wide.",
        ),
    ] = True
    frames: Annotated[
        int,
        described(
            "Averaged frames",
            "Number of frames over which depth is averaged while the membrane is still, which reveals small contacts. "
            "Averaging restarts where the membrane moves. 1 averages nothing; larger values take effect during "
            "playback only.",
            slider=(1, 30),
        ),
        Field(ge=1, le=300),
    ] = 1
    difference_m: Annotated[
        float,
        described(
            "Largest difference",
            "Pixels whose two depths differ by more are excluded from the means: background, flying pixels.",
            unit="m",
            hidden=True,
        ),
        Field(gt=0.0, le=0.1),
    ] = 0.008
    slope: Annotated[
        bool,
        described(
            "Along the normal", "Measure gaps along the surface normal, not along the optical axis.", hidden=True
        ),
    ] = True
    core_share: Annotated[
        float,
        described(
            "Protected core",
            "Pixels farther from the border of a near region than this share of its depth are never eroded.",
            hidden=True,
        ),
        Field(ge=0.0, le=1.0),
    ] = 0.5
    max_erosion_px: Annotated[
        float,
        described("Widest erosion", "Upper limit of the eroded rim's width.", unit="px", hidden=True),
        Field(ge=0.0, le=100.0),
    ] = 16.0
    curvature_px: Annotated[
        float,
        described(
            "Window of the curvature",
            "Sigma of the Gaussian window over which the membrane's curvature is averaged, in tactile pixels.",
            unit="px",
            hidden=True,
        ),
        Field(ge=1.0, le=50.0),
    ] = 11.0
    smooth_px: Annotated[
        float,
        described(
            "Smoothing of points",
            "Sigma of the Gaussian window over which the depth of the points is averaged. 0 averages nothing.",
            unit="px",
            hidden=True,
        ),
        Field(ge=0.0, le=20.0),
    ] = 2.0
    tactile_weight: Annotated[
        float,
        described(
            "Weight of the tactile depth",
            "Weight of the tactile depth in the contact points; the proximity depth has the rest.",
            hidden=True,
        ),
        Field(ge=0.0, le=1.0),
    ] = 0.5

    @property
    def window_reach_px(self) -> float:
        """The wider of the two windows around each pixel, sigma."""
        return max(self.window_px, self.smooth_px)

    @property
    def measures_curvature(self) -> bool:
        """Whether anything depends on the free membrane's curvature."""
        return self.curvature > 0 or self.balance


class MembraneTest(ContactTest[MembraneSection]):
    """Contact where the mean gap is small and the membrane's shape shows that something presses."""

    name = "membrane"
    implementation = "tactune.core.contact.membrane.finder:MembraneFinder"
    sections = (TestSection("membrane", "Membrane test", MembraneSection),)
    steps = (
        Step("fusion", (*PIXEL_FIELDS, "membrane.difference_m", "membrane.window_reach_px")),
        Step("gaps", ("membrane.window_px", "membrane.bias_m", "membrane.slope")),
        Step("edge", ("membrane.gap_m", "membrane.erosion", "membrane.core_share", "membrane.max_erosion_px")),
        Step("press", ("membrane.curvature", "membrane.curvature_px", "membrane.measures_curvature")),
        Step("balance", ("membrane.balance",)),
        Step("clusters", ("membrane.min_area_mm2",)),
        Step("points", ("membrane.smooth_px", "membrane.tactile_weight")),
    )
    summary = (
        "local means of the difference resolve much smaller gaps, and the rim that is near without touching is eroded."
    )
    note = "By mean gaps, where the membrane is pressed. Tolerance and Outliers are ignored."
    near_words = "came near the object"
    looser_words = "raise the largest gap"
    drop_reasons = {
        Provenance.MASKED: MASK_REASON,
        Provenance.RIM: DropReason("the erosion of the rim", "correct if nothing touches; otherwise lower it"),
        Provenance.NOT_PRESSED: DropReason(
            "the membrane's curvature", "correct if nothing presses; otherwise raise it"
        ),
        Provenance.SMALL_CLUSTER: DropReason("the limit on small contacts", "lower the smallest contact"),
    }
    variants = (
        FusionVariant(
            "fusion-membrane",
            {"contact_test": "membrane", "alignment.model": "rigid", "membrane.frames": 1},
            "Both cameras: where the mean of their difference is small and the membrane is pressed",
            (0, 158, 115),
        ),
        FusionVariant(
            "fusion-averaged",
            {"contact_test": "membrane", "alignment.model": "rigid", "membrane.frames": 15},
            "fusion-membrane on the mean of up to 15 frames while the membrane is still",
            (119, 68, 255),
        ),
    )
    frames_field = "membrane.frames"
    unmasked_note = (
        "uses the membrane test without the mask, so parts of the membrane that reflect infrared, such as prints, "
        "pass as contact; set mask.hue, mask.saturation and mask.value to their colour."
    )
    homography_note = (
        "judges gaps of a millimetre, which a homography resolves on one plane only; choose the rigid "
        "alignment, or the tolerance test."
    )
    moves_points = True

    def accepted_share(self, section: MembraneSection, distance_m: float) -> float:
        """Return the largest gap over the distance."""
        return float(f"{section.gap_m / distance_m:.2g}") if distance_m > 0 else 0.0

    def bias_limits(self, section: MembraneSection, distance_m: float) -> BiasLimits:
        """Return what the test corrects or a third of its largest gap, and that plus the largest gap."""
        third_m = HARMLESS_SHARE * section.gap_m
        good_m = max(section.bias_m, third_m)
        why = "what the membrane contact test corrects" if good_m > third_m else "a third of its largest gap"
        return BiasLimits(good_m, section.bias_m + section.gap_m, f"below {1e3 * good_m:.2g} mm, {why}")


MEMBRANE = MembraneTest()
