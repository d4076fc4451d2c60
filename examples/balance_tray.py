"""Level a simulated tray on the membrane by the angle of its contact patch, while books are put on it.

A frame gives the roll of the tray relative to the sensor; the sensor's encoder gives its own roll. Their sum is the
roll over the ground, which a PD controller brings to zero by turning the sensor:

    rate = -(P roll + D d(roll)/dt)

On a robot, replace `SimulatorSource` by `open_source("cameras:")` and `Tray` by your wrist.

    python examples/balance_tray.py [--seconds 12] [--p-gain 5] [--d-gain 0.1]
"""

from __future__ import annotations

import argparse
import math
import time
from collections import deque
from dataclasses import dataclass

from tactune.core import ContactPipeline, TiltEstimator, load_preset
from tactune.core.sources.simulator.scenes import TRAY_ROLLS_DEG
from tactune.core.sources.simulator.simulator_source import SimulatorSource

#: The tray is level while its roll is within this angle, degrees.
LEVEL_DEG = 1.0
#: Torque of the membrane per roll of the tray, N m per radian, and the time in which the tray follows it, seconds.
STIFFNESS, LAG_S = 2.43, 0.08
#: The largest rate of the sensor's actuator, radians per second, and the frames until it follows a command.
MAX_RATE, DELAY_FRAMES = math.radians(20.0), 2


@dataclass(frozen=True)
class Book:
    """A book that is put on the tray at a time, ``y_m`` from the roll axis along the tray's y axis."""

    time_s: float
    mass_kg: float
    y_m: float


BOOKS = (Book(3.0, 0.35, 0.040), Book(6.0, 0.50, -0.045), Book(9.0, 0.40, 0.042))


class Tray:
    """The tray rolls to where the membrane's torque balances its books, while the sensor turns below it."""

    def __init__(self) -> None:
        self.time_s = self.roll_rad = self.sensor_rad = 0.0
        self._rates = deque([0.0] * DELAY_FRAMES)

    def advance(self, seconds: float, rate_rad_s: float) -> None:
        """Move on in time; the sensor gets a command to turn at a rate."""
        self._rates.append(min(max(rate_rad_s, -MAX_RATE), MAX_RATE))
        self.time_s += seconds
        self.sensor_rad += seconds * self._rates.popleft()
        load = -sum(9.81 * book.mass_kg * book.y_m for book in BOOKS if book.time_s <= self.time_s)
        balanced = self.sensor_rad + load / STIFFNESS
        self.roll_rad += (1.0 - math.exp(-seconds / LAG_S)) * (balanced - self.roll_rad)

    @property
    def state(self) -> int:
        """The simulated roll that is the nearest one to the tray's roll relative to the sensor."""
        relative_deg = math.degrees(self.roll_rad - self.sensor_rad)
        return min(range(len(TRAY_ROLLS_DEG)), key=lambda n: abs(TRAY_ROLLS_DEG[n] - relative_deg))


@dataclass(frozen=True)
class Step:
    """One turn of the loop: time, roll over the ground (true, measured), roll of the sensor, time to the angle."""

    time_s: float
    roll_rad: float
    measured_rad: float | None
    sensor_rad: float
    latency_s: float


def balance(seconds: float, p_per_s: float = 5.0, d: float = 0.1) -> list[Step]:
    """Run the loop for a time, seconds; ``p_per_s`` and ``d`` are the gains of the controller."""
    preset = load_preset("simulator")
    with SimulatorSource("tray") as source:
        pipeline, estimator = ContactPipeline(preset, source.rig), TiltEstimator(preset, source.rig)
        tray, period_s = Tray(), 1 / source.frame_rate_hz
        steps: list[Step] = []
        before: float | None = None
        rate = 0.0
        for number in range(round(seconds / period_s)):
            tray.advance(period_s, rate)
            frame = source.draw(number, tray.state)
            started = time.perf_counter()
            tilt = estimator.estimate(pipeline.process(frame))
            latency_s = time.perf_counter() - started
            measured = None if tilt.roll_rad is None else tilt.roll_rad + tray.sensor_rad
            change = 0.0 if before is None or measured is None else (measured - before) / period_s
            rate = 0.0 if measured is None else -(p_per_s * measured + d * change)  # no contact: stand still
            before = measured
            steps.append(Step(tray.time_s, tray.roll_rad, measured, tray.sensor_rad, latency_s))
    return steps


def settle_times(steps: list[Step]) -> list[float | None]:
    """Return for each book how long the tray took to stay level until the next one, seconds; None if it did not."""
    settled: list[float | None] = []
    put_on = [book.time_s for book in BOOKS if book.time_s < steps[-1].time_s]
    for begin, end in zip(put_on, [*put_on[1:], math.inf], strict=False):
        during = [step for step in steps if begin <= step.time_s < end]
        tilted = [n for n, step in enumerate(during) if abs(math.degrees(step.roll_rad)) > LEVEL_DEG]
        if not tilted:
            settled.append(0.0)
        else:
            level_from = tilted[-1] + 1
            settled.append(during[level_from].time_s - begin if level_from < len(during) else None)
    return settled


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=12.0, help="simulated time; books come at 3, 6 and 9 s")
    parser.add_argument("--p-gain", type=float, default=5.0, help="rate of the sensor per roll of the tray, 1/s")
    parser.add_argument("--d-gain", type=float, default=0.1, help="rate of the sensor per rate of the tray")
    options = parser.parse_args()
    steps = balance(options.seconds, options.p_gain, options.d_gain)
    errors = [step.measured_rad - step.roll_rad for step in steps if step.measured_rad is not None]
    rms_deg = math.degrees(math.sqrt(sum(error**2 for error in errors) / len(errors))) if errors else math.nan
    latency_ms = sorted(1e3 * step.latency_s for step in steps)
    print(f"{len(steps)} frames, {len(steps) - len(errors)} of them without an angle")
    print(f"error of the angle: {rms_deg:.2f} degrees RMS")
    print(f"from frame to angle: {latency_ms[len(steps) // 2]:.1f} ms, {latency_ms[int(0.95 * len(steps))]:.1f} (95 %)")
    for book, settled in zip(BOOKS, settle_times(steps), strict=False):
        level = "never" if settled is None else f"after {settled:.2f} s"
        print(f"book of {1e3 * book.mass_kg:.0f} g at {book.time_s:g} s: level {level}")


if __name__ == "__main__":
    main()
