"""The parameters of the pressure test."""

from __future__ import annotations

from typing import Annotated

from ...model.sections import Section, SmallestContact, described


class PressureSection(Section):
    """The pressure test: contact pressure from the curvature of the membrane."""

    limit: Annotated[
        float,
        described(
            "Pressure limit",
            "Contact is where the pressure of the object exceeds this share of the inflation. Noise raises it. A "
            "larger value gives a smaller patch.",
            unit="share",
            scale="log",
            slider=(0.05, 2.0),
            step=0.01,
            limits=(0.0, 100.0),
        ),
    ] = 0.3
    share: Annotated[
        float,
        described(
            "Edge flatness",
            "Contact ends where the membrane is less flat than about this share: 0 is as round as the free membrane, 1 "
            "is flat. A larger value gives a smaller patch.",
            slider=(0.0, 0.95),
            step=0.01,
            limits=(0.0, 1.0),
        ),
    ] = 0.35
    noise: Annotated[
        float,
        described(
            "Pressure noise",
            "Standard deviation of the pressure, as a share of the inflation, that the averaging window is chosen for: "
            "the noisier the camera, the wider the window. A smaller value averages more and resolves less.",
            unit="share",
            slider=(0.03, 0.5),
            step=0.01,
            advanced=True,
            limits=(0.01, 5.0),
        ),
    ] = 0.12
    min_area_mm2: SmallestContact = 5.0
    gauge_pa: Annotated[
        float,
        described(
            "Inflation",
            "Pressure of the air above the atmosphere. It turns relative pressure and force into pascals and newtons. "
            "0: not known; figures then stay relative to the inflation.",
            unit="Pa",
            slider=(0.0, 10_000.0),
            step=10.0,
            advanced=True,
            limits=(0.0, 1e6),
        ),
    ] = 0.0
    gauge_sigma_pa: Annotated[
        float,
        described(
            "Inflation error",
            "Standard deviation of the inflation.",
            unit="Pa",
            slider=(0.0, 1000.0),
            step=1.0,
            advanced=True,
            limits=(0.0, 1e6),
        ),
    ] = 0.0
