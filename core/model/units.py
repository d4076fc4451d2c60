"""Length units of mesh files."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Final


class MeshUnit(StrEnum):
    """Length units of mesh files."""

    M = "m"
    CM = "cm"
    MM = "mm"
    INCH = "in"


#: Metres of each unit.
UNITS_M: Final[Mapping[str, float]] = {
    MeshUnit.M: 1.0,
    MeshUnit.CM: 0.01,
    MeshUnit.MM: 0.001,
    MeshUnit.INCH: 0.0254,
}
