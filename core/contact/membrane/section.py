"""The parameters of the membrane test."""

from __future__ import annotations

from typing import Annotated, Final

from ...model.sections import Section, described

#: Mean gaps below this count as near the object, metres.
NEAR_GAP_M: Final = 0.0015
#: Gap at the edge of contact that noise asks for, metres; beyond it the membrane hovers.
USUAL_GAP_M: Final = 0.00005
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
            limits=(0.0, 0.005),
        ),
    ] = USUAL_GAP_M
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
            limits=(0.001, 0.2),
        ),
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
            limits=(0.5, 30.0),
        ),
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
            limits=(0.0, 1e6),
        ),
    ] = 8.0
    frames: Annotated[
        int,
        described(
            "Averaged frames",
            "Number of frames over which depth is averaged while the membrane is still, which reveals small contacts. "
            "Averaging restarts where the membrane moves. 1 averages nothing; larger values take effect during "
            "playback only.",
            slider=(1, 30),
            limits=(1, 300),
        ),
    ] = 1
