"""How a slider's position maps to a value: linear or logarithmic, snapped to sensible steps."""

from __future__ import annotations

import math
from dataclasses import dataclass
from decimal import Decimal


@dataclass(frozen=True)
class Scale:
    """A slider's travel from ``low`` to ``high``; positions are fractions 0 to 1.

    Linear scales snap to multiples of ``step`` from ``low``, logarithmic ones to a hundredth of a decade,
    rounded to three significant digits.
    """

    low: float
    high: float
    step: float = 1.0
    log: bool = False

    def fraction(self, value: float) -> float:
        """Return where a value sits; values beyond the ends sit at the ends."""
        value = min(max(value, self.low), self.high)
        if self.log:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)

    def value(self, fraction: float) -> float:
        """Return the snapped value at a position."""
        fraction = min(max(fraction, 0.0), 1.0)
        if self.log:
            exact = self.low * (self.high / self.low) ** fraction
            return min(max(float(f"{exact:.3g}"), self.low), self.high)
        return self._snapped(self.low + fraction * (self.high - self.low))

    @property
    def positions(self) -> int:
        """How many steps lie between the ends."""
        if self.log:
            return round(100 * math.log10(self.high / self.low))
        return max(1, round((self.high - self.low) / self.step))

    def _snapped(self, value: float) -> float:
        steps = round((value - self.low) / self.step)
        # decimal arithmetic keeps 3 x 0.1 from becoming 0.30000000000000004
        exact = Decimal(repr(self.low)) + steps * Decimal(repr(self.step))
        return min(max(float(exact), self.low), self.high)
