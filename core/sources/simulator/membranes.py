"""Named membranes of the simulator: size, material and air of each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from .mesh import MembraneDesign


@dataclass(frozen=True)
class NamedMembrane:
    """One membrane; a held-out one is reserved for judging methods, not for developing them."""

    name: str
    about: str
    design: MembraneDesign
    held_out: bool = False


STANDARD: Final = "standard"

_ALL: Final = (
    NamedMembrane(STANDARD, "apex 60 mm above the rim, pre-stretch 4 %", MembraneDesign()),
    NamedMembrane(
        "soft",
        "softer rubber, half the pressure, apex 50 mm",
        MembraneDesign(apex_m=0.050, stiffness_n_m=150.0, stiffening=0.05, prestretch=1.03),
    ),
    NamedMembrane(
        "taut",
        "pre-stretch 12 %, stiffer rubber that stiffens more, apex 52 mm",
        MembraneDesign(apex_m=0.052, stiffness_n_m=300.0, stiffening=0.12, prestretch=1.12),
    ),
    NamedMembrane("tall", "more air, apex 80 mm", MembraneDesign(apex_m=0.080)),
    NamedMembrane(
        "uneven",
        "1.3 times as stiff at the right edge and 0.7 times at the left, thinner in the centre",
        MembraneDesign(stiffness_slope=0.6, centre_stiffness=0.75),
    ),
    NamedMembrane("sticky", "sticks to the object instead of sliding along it", MembraneDesign(sticks=True)),
    NamedMembrane(
        "held-membrane",
        "other pre-stretch, stiffening, air and distribution of stiffness",
        MembraneDesign(
            apex_m=0.067,
            dead_volume_m3=0.0060,
            stiffness_n_m=260.0,
            stiffening=0.08,
            prestretch=1.08,
            stiffness_slope=-0.4,
            centre_stiffness=1.35,
        ),
        held_out=True,
    ),
)

#: All membranes by name; the held-out one is the last.
MEMBRANES: Final[dict[str, NamedMembrane]] = {membrane.name: membrane for membrane in _ALL}
