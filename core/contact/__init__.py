"""The contact pipeline, the contact tests, and the kernels that they run on.

Importing this package, as presets do for the tests' sections, loads no compiled kernel.
"""

from __future__ import annotations

from typing import Final

from .contact_test import ContactTest
from .membrane.test import MembraneTest
from .pressure.test import PressureTest
from .tolerance import ToleranceTest

#: Every contact test by its name in presets, the default first.
CONTACT_TESTS: Final[dict[str, type[ContactTest]]] = {
    "membrane": MembraneTest,
    "tolerance": ToleranceTest,
    "pressure": PressureTest,
}
