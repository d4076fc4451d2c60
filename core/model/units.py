"""Length units of mesh files."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Final


class MeshUnit(StrEnum):
    M = "m"
    CM = "cm"
    MM = "mm"
    INCH = "in"


#: Metres of each unit.
UNITS_M: Final[Mapping[str, float]] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
