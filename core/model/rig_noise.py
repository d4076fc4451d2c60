"""The measured noise of both cameras and the bias between them; `tactune.core.rig` measures them."""

from __future__ import annotations

import math
from datetime import datetime
from typing import Annotated, Literal

from pydantic import Field

from .sections import Section, stored

BiasOrigin = Literal["prints", "contact", "unknown"]

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
