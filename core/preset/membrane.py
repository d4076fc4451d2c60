"""The membrane test: contact is where a membrane in equilibrium of tension and pressure touches the object."""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import Field

from ..model.provenance import Provenance
from .contact_test import (
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

#: Mean gaps below this count as near the object, metres.
NEAR_GAP_M: Final = 0.0015
#: The largest bias between the cameras that the test finds by itself, metres.
LARGEST_BIAS_M: Final = 0.025


class MembraneSection(Section):
    """The contact test on the equilibrium of the membrane. Thresholds follow from physics and the rig's noise."""

    gap_m: Annotated[
        float,
        described(
            "Largest gap",
            "Contact is where the gap of the membrane in equilibrium is smaller. Larger values move the edge outwards.",
            unit="m",
            slider=(0.0, 0.0005),
            step=0.00001,
        ),
        Field(ge=0.0, le=0.005),
    ] = 0.00005
    trust_m: Annotated[
        float,
        described(
            "Equilibrium length",
            "Length over which the equilibrium of tension and pressure is trusted more than the measured gap, at usual "
            "noise; it grows with the fourth root of the measured noise power. Longer averages more noise; shorter "
            "follows the measured gap more closely.",
            unit="m",
            slider=(0.004, 0.04),
            step=0.001,
            advanced=True,
        ),
        Field(ge=0.001, le=0.2),
    ] = 0.016
    shape_px: Annotated[
        float,
        described(
            "Shape smoothing",
            "Sigma of the Gaussian window over which the object's shape is averaged to measure its curvature. Wider "
            "suits noisy cameras and smooth objects.",
            unit="px",
            slider=(1.0, 12.0),
            step=0.5,
            advanced=True,
        ),
        Field(ge=0.5, le=30.0),
    ] = 5.0
    bias: Annotated[
        bool,
        described(
            "Correct bias",
            "Subtract the bias between both cameras: the one measured with the rig, corrected in each frame where "
            "contact is large enough to tell it.",
            advanced=True,
        ),
    ] = True
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
    ] = 15.0
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


class MembraneTest(ContactTest[MembraneSection]):
    """Contact where a membrane in equilibrium touches the object."""

    name = "membrane"
    implementation = "tactune.core.contact.membrane.finder:MembraneFinder"
    sections = (TestSection("membrane", "Membrane test", MembraneSection),)
    steps = (
        Step("fusion", (*PIXEL_FIELDS, "noise", "membrane.bias")),
        Step("equilibrium", ("membrane.trust_m", "membrane.shape_px")),
        Step("edge", ("membrane.gap_m",)),
        Step("clusters", ("membrane.min_area_mm2",)),
        Step("points", ()),
    )
    summary = "the equilibrium of tension and pressure tells where the membrane leaves the object, also in noise."
    note = "By the membrane's equilibrium. Tolerance and Outliers are ignored."
    near_words = "came near the object"
    looser_words = "raise the largest gap"
    drop_reasons = {
        Provenance.MASKED: MASK_REASON,
        Provenance.RIM: DropReason(
            "the membrane's equilibrium",
            "correct if nothing touches; otherwise measure the rig's bias (Check cameras, Noise and bias)",
            "measure_noise",
        ),
        Provenance.SMALL_CLUSTER: DropReason("the limit on small contacts", "lower the smallest contact"),
    }
    variants = (
        FusionVariant(
            "fusion-membrane",
            {"contact_test": "membrane", "alignment.model": "rigid", "membrane.frames": 1},
            "Both cameras: where a membrane in equilibrium of tension and pressure touches the object",
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
        """Return the gap that counts as near the object over the distance."""
        return float(f"{NEAR_GAP_M / distance_m:.2g}") if distance_m > 0 else 0.0

    def bias_limits(self, section: MembraneSection, distance_m: float) -> BiasLimits:
        """Return what the test corrects in firm contact, or what still leaves contact without a correction."""
        if section.bias:
            reason = f"below {1e3 * LARGEST_BIAS_M:g} mm, what the test corrects"
            return BiasLimits(LARGEST_BIAS_M, LARGEST_BIAS_M, reason)
        third_m = NEAR_GAP_M / 3
        return BiasLimits(third_m, NEAR_GAP_M, f"below {1e3 * third_m:.2g} mm, as the bias is not corrected")


MEMBRANE = MembraneTest()
