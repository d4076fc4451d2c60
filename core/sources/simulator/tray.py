"""The tray on the membrane: how it rolls under books, and how a rig that turns about the same axis carries it.

The model. The tray is hinged on its roll axis, which lies in its flat underside along the proximity camera's x axis, at
a constant height over the sensor; so only its roll moves. Books stand on it beside the axis. The membrane turns it back
with a torque M(a) that depends on the roll a of the tray relative to the sensor; M is the solver's. With the roll r of
the tray and s of the sensor over the ground, a = r - s, and

    I r'' = -sum m g (y cos r - h sin r) + M(a) - c a'.

I is the inertia of tray and books, c makes half of the critical damping. The sensor turns as fast as it is told,
delayed and up to a maximum rate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from ...model.arrays import Float64Array
from .scene import PressFacts
from .scenes import TRAY_ROLLS_DEG

_GRAVITY_M_S2: Final = 9.81
#: Mass and inertia about the roll axis of the empty tray, kg and kg m^2.
_TRAY_MASS_KG: Final = 0.6
_TRAY_INERTIA_KG_M2: Final = _TRAY_MASS_KG * 0.100**2 / 12
_DAMPING_RATIO: Final = 0.5
#: Height of the tray's and the books' centres of mass over the roll axis, metres.
_TRAY_HEIGHT_M: Final = 0.008
_BOOK_HEIGHT_M: Final = 0.030
_STEP_S: Final = 0.001

#: The sensor's actuator: the largest rate, degrees per second, and the time until it follows a command, seconds.
MAX_RATE_DEG_S: Final = 20.0
DELAY_S: Final = 0.050


@dataclass(frozen=True)
class Book:
    """A book that is put on the tray at a time, ``y_m`` from the roll axis along the tray's y axis."""

    time_s: float
    mass_kg: float
    y_m: float


#: Duration of the scene, seconds, and what is put on the tray.
SECONDS: Final = 12.0
BOOKS: Final = (Book(3.0, 0.35, 0.040), Book(6.0, 0.50, -0.045), Book(9.0, 0.40, 0.042))


class Tray:
    """The tray, its books and the sensor below it as they move; rolls over the ground in radians.

    ``facts`` are those of the solved rolls `scenes.TRAY_ROLLS_DEG`, which give the membrane's torque.
    """

    def __init__(self, facts: Sequence[PressFacts]) -> None:
        self._rolls: Float64Array = np.radians(TRAY_ROLLS_DEG)
        self._torques = np.array([each.torque_nm[0] for each in facts])
        self._stiffness = -float(np.gradient(self._torques, self._rolls)[len(facts) // 2])
        self._commands: list[tuple[float, float]] = []
        self._rate = self._sensor_rate = 0.0
        self.time_s = self.roll_rad = self.sensor_rad = 0.0

    @property
    def relative_rad(self) -> float:
        """Roll of the tray relative to the sensor, radians; the hinge stops it at the largest solved rolls."""
        return self.roll_rad - self.sensor_rad

    @property
    def place(self) -> float:
        """Place of the present state among the solved rolls, for `SimulatorSource.draw`."""
        return float(np.interp(self.relative_rad, self._rolls, np.arange(len(self._rolls))))

    def command(self, rate_rad_s: float) -> None:
        """Tell the actuator to turn the sensor at a rate, radians per second; it obeys `DELAY_S` later."""
        limit = math.radians(MAX_RATE_DEG_S)
        self._commands.append((self.time_s + DELAY_S, min(max(rate_rad_s, -limit), limit)))

    def advance(self, until_s: float) -> None:
        """Move on to a time, seconds."""
        while self.time_s < until_s - _STEP_S / 2:
            while self._commands and self._commands[0][0] <= self.time_s:
                self._sensor_rate = self._commands.pop(0)[1]
            on = [book for book in BOOKS if book.time_s <= self.time_s]
            torque = float(np.interp(self.relative_rad, self._rolls, self._torques))
            inertia = _TRAY_INERTIA_KG_M2
            c, s = math.cos(self.roll_rad), math.sin(self.roll_rad)
            torque += _TRAY_MASS_KG * _GRAVITY_M_S2 * _TRAY_HEIGHT_M * s
            for book in on:
                torque -= book.mass_kg * _GRAVITY_M_S2 * (book.y_m * c - _BOOK_HEIGHT_M * s)
                inertia += book.mass_kg * (book.y_m**2 + _BOOK_HEIGHT_M**2)
            damping = 2.0 * _DAMPING_RATIO * math.sqrt(self._stiffness * inertia)
            # Implicit in the damping, which is stiff.
            rate = self._rate + _STEP_S * (torque + damping * self._sensor_rate) / inertia
            self._rate = rate / (1.0 + _STEP_S * damping / inertia)
            self.roll_rad += _STEP_S * self._rate
            self.sensor_rad += _STEP_S * self._sensor_rate
            self._stop()
            self.time_s += _STEP_S

    def _stop(self) -> None:
        """Keep the tray within the stops of its hinge."""
        relative = min(max(self.relative_rad, float(self._rolls[0])), float(self._rolls[-1]))
        if relative != self.relative_rad:
            self.roll_rad, self._rate = self.sensor_rad + relative, self._sensor_rate


def carried(facts: Sequence[PressFacts], frame_rate_hz: float) -> tuple[float, ...]:
    """Return the place among the solved rolls for each frame while the sensor stands still."""
    tray = Tray(facts)
    places = []
    for n in range(round(SECONDS * frame_rate_hz)):
        tray.advance(n / frame_rate_hz)
        places.append(tray.place)
    return tuple(places)
