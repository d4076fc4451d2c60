"""What `tactune.core.rig` measures of a rig and a preset stores: noise, bias, and the verdict on the boundary."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import datetime
from typing import Annotated, Final, Literal

from pydantic import Field

from .sections import Section, stored

BiasOrigin = Literal["prints", "contact", "unknown"]
Link = Literal["alignment", "bias", "noise", "missing depth"]
_ADVICE: Final[Mapping[Link, str]] = {
    "alignment": "more points, at another inflation, improve it, or the rigid model in place of a homography",
    "bias": "a firm press of a larger object measures it better",
    "noise": "a nearer camera reduces it, and with the membrane test averaged frames, where nothing moves",
    "missing depth": "light the membrane evenly, and check that the tactile camera sees all of it",
}

_Noise = Annotated[float, Field(ge=0.0, le=1.0)]


class CameraNoise(Section):
    """Depth noise: a part of single pixels, and one that pixels d px apart share by exp(-d^2 / (4 length_px^2))."""

    white_m: Annotated[
        _Noise, stored("White noise", "Standard deviation of the part that differs from pixel to pixel.", unit="m")
    ]
    correlated_m: Annotated[
        _Noise, stored("Correlated noise", "Standard deviation of the part that neighbouring pixels share.", unit="m")
    ]
    length_px: Annotated[
        float,
        stored(
            "Correlation length",
            "Sigma of the Gaussian window that correlates neighbouring pixels. 0: there is no correlated part.",
            unit="px",
            limits=(0.0, 1000.0),
        ),
    ]
    changing_share: Annotated[
        float,
        stored(
            "Changing share",
            "Share of the variance that changes from frame to frame. An average over frames reduces only this share.",
            limits=(0.0, 1.0),
        ),
    ]
    distance_m: Annotated[float, stored("Distance", "Depth at which the noise holds.", unit="m", limits=(0.01, 10.0))]

    @property
    def total_m(self) -> float:
        """Standard deviation of one pixel, metres."""
        return math.hypot(self.white_m, self.correlated_m)

    def density_m4(self, focal_px: float) -> float:
        """Return the noise power per area at low spatial frequency, m^4: the variance of a mean times its area."""
        pixel_m = self.distance_m / focal_px
        shared_m2 = 4.0 * math.pi * (self.length_px * pixel_m) ** 2
        return (self.white_m * pixel_m) ** 2 + self.correlated_m**2 * shared_m2


class RigNoise(Section):
    """The measured noise of both cameras and the bias between them."""

    proximity: CameraNoise
    tactile: CameraNoise
    bias_m: Annotated[
        float,
        stored(
            "Bias",
            "Proximity depth minus tactile depth on the same surface, after the alignment's depth scale and offset.",
            unit="m",
            limits=(-1.0, 1.0),
        ),
    ] = 0.0
    bias_sigma_m: Annotated[
        float, stored("Bias uncertainty", "Standard deviation of the bias.", unit="m", limits=(0.0, 1.0))
    ] = 0.005
    bias_from: Annotated[
        BiasOrigin,
        stored(
            "Bias measured on",
            "prints: prints of the mask's colour, which both cameras see. contact: an object pressed into the "
            "membrane. unknown: not measured.",
        ),
    ] = "unknown"
    bias_per_m: Annotated[
        float,
        stored(
            "Bias slope",
            "Growth of the bias per metre of depth. 0: constant, or too small a range of depth to tell.",
            limits=(-1.0, 1.0),
        ),
    ] = 0.0
    measured: Annotated[datetime, stored("Measured", "Date and time of the measurement.")]
    frames: Annotated[int, stored("Frames", "Number of frames that were measured.", unit="frames", limits=(1, 100_000))]


class Verdict(Section):
    """How far the boundary of a patch is off, by the links of the chain of measurement."""

    links_mm: Annotated[
        dict[Link, Annotated[float, Field(ge=0.0)]],
        stored("Links", "Error of the boundary by each link, millimetres; their squares add up."),
        Field(min_length=1),
    ]
    reasons: Annotated[tuple[str, ...], stored("In doubt", "Reasons to doubt the patch that was judged.")] = ()
    judged: Annotated[datetime, stored("Judged", "Date and time of the verdict.")]

    @property
    def error_mm(self) -> float:
        return math.hypot(*self.links_mm.values())

    @property
    def weakest(self) -> Link:
        return max(self.links_mm, key=lambda link: self.links_mm[link])

    @property
    def sentence(self) -> str:
        """The error, the weakest link and what improves it."""
        doubts = f" In doubt: {', '.join(self.reasons)}." if self.reasons else ""
        return (
            f"The boundary of a patch is off by about {self.error_mm:.1f} mm. Weakest link: {self.weakest} "
            f"({self.links_mm[self.weakest]:.1f} mm); {_ADVICE[self.weakest]}.{doubts}"
        )
