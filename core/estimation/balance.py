"""A closed loop on the simulator: a controller levels the tray by the angle that the contact patch shows.

A frame gives the tray's roll relative to the sensor, the sensor's encoder its own roll; their sum is the roll over the
ground, which the controller brings to zero by turning the sensor::

    rate = -(P roll + D roll')

The tray, its books and the actuator are those of `sources.simulator.tray`. Beside the loop runs the comparison of Yin
et al.: the roll from the proximity camera alone, from its points nearer than the untouched membrane.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from ..contact.pipeline import ContactPipeline
from ..errors import SourceError
from ..methods.proximity_only import ProximityOnly
from ..model.arrays import Float64Array
from ..model.frames import SensorFrame
from ..preset import Preset
from ..sources.simulator.source import SimulatorSource
from ..sources.simulator.tray import BOOKS, Tray
from .tilt import Tilt, TiltEstimator

BalanceMethod = Literal["patch", "proximity"]

#: The tray is levelled while its roll is within this angle, degrees.
LEVEL_DEG: Final = 1.0


@dataclass(frozen=True)
class Gains:
    """Gains of the controller.

    Attributes
    ----------
    p_per_s : float
        Rate of the sensor per roll of the tray, 1/s.
    d : float
        Rate of the sensor per rate of the tray.
    """

    p_per_s: float = 5.0
    d: float = 0.1


@dataclass(frozen=True)
class BalanceStep:
    """One turn of the loop.

    Attributes
    ----------
    time_s : float
    roll_rad : float
        True roll of the tray over the ground, radians.
    measured_rad : float or None
        The same as the controller measured it; None without an angle.
    patch, proximity : Tilt
        The roll relative to the sensor from the patch and from the proximity camera alone.
    true_rad : float
        The true roll relative to the sensor, radians.
    sensor_rad : float
        Roll of the sensor over the ground, radians.
    latency_s, processor_s : float
        From the frame to the angle that controls: elapsed, and processor time of all threads, seconds.
    loop_s : float
        Time of the turn without the comparison: simulate tray and frame, measure the angle, command the sensor.
    """

    time_s: float
    roll_rad: float
    measured_rad: float | None
    patch: Tilt
    proximity: Tilt
    true_rad: float
    sensor_rad: float
    latency_s: float
    processor_s: float
    loop_s: float


class BalanceLoop:
    """The tray in the simulated rig, and the controller that levels it, frame by frame.

    Parameters
    ----------
    source : SimulatorSource
        The scene ``tray``, which gives membrane, sensor and noise.
    preset : Preset
        For the contact patch and, with the rig's noise, for the angle.
    method : {"patch", "proximity"}
        Which angle controls.
    gains : Gains
        May be replaced at any time.

    Raises
    ------
    SourceError
        The source is another scene.
    """

    def __init__(
        self, source: SimulatorSource, preset: Preset, method: BalanceMethod = "patch", gains: Gains | None = None
    ) -> None:
        if not source.scene.loaded:
            raise SourceError(f"{source.name} has no tray to balance; open sim:tray")
        self.gains = gains or Gains()
        self._source, self._method = source, method
        self._tray = Tray(source.solved_facts())
        with source.with_object_away() as away:
            self._proximity = ProximityOnly(preset, source.rig, away.read(0))
        self._pipeline = ContactPipeline(preset, source.rig)
        self._tilt = TiltEstimator(preset, source.rig)
        self._frames = 0
        self._before: float | None = None

    def step(self) -> BalanceStep:
        """Move on to the next frame, measure the angle and tell the sensor how fast to turn."""
        started = time.perf_counter()
        period_s = 1.0 / self._source.frame_rate_hz
        tray = self._tray
        tray.advance(self._frames * period_s)
        frame = self._source.draw(self._frames, tray.place)
        drawn, drawn_processor = time.perf_counter(), time.process_time()
        angle, other_angle = self._patch_tilt, self._proximity_tilt
        if self._method == "proximity":
            angle, other_angle = other_angle, angle
        found = angle(frame)
        measured = None if found.roll_rad is None else found.roll_rad + tray.sensor_rad
        latency_s, processor_s = time.perf_counter() - drawn, time.process_time() - drawn_processor
        tray.command(self._rate(measured, period_s))
        loop_s = time.perf_counter() - started
        other = other_angle(frame)
        self._frames += 1
        patch, proximity = (found, other) if self._method == "patch" else (other, found)
        return BalanceStep(
            time_s=tray.time_s,
            roll_rad=tray.roll_rad,
            measured_rad=measured,
            patch=patch,
            proximity=proximity,
            true_rad=tray.relative_rad,
            sensor_rad=tray.sensor_rad,
            latency_s=latency_s,
            processor_s=processor_s,
            loop_s=loop_s,
        )

    def _patch_tilt(self, frame: SensorFrame) -> Tilt:
        return self._tilt.estimate(self._pipeline.process(frame), frame.sequence, frame.proximity_time_s)

    def _proximity_tilt(self, frame: SensorFrame) -> Tilt:
        return self._tilt.estimate(self._proximity.find(frame), frame.sequence, frame.proximity_time_s)

    def _rate(self, roll_rad: float | None, period_s: float) -> float:
        """Return the rate of the sensor, radians per second; it stands while there is no angle."""
        before, self._before = self._before, roll_rad
        if roll_rad is None:
            return 0.0
        change = 0.0 if before is None else (roll_rad - before) / period_s
        return -(self.gains.p_per_s * roll_rad + self.gains.d * change)


@dataclass(frozen=True)
class AngleErrors:
    """Errors of a measured roll against the truth.

    Attributes
    ----------
    rms_deg, bias_deg : float
        Over all frames with an angle, degrees; nan without any.
    noise_deg : float
        Standard deviation of what changes from frame to frame, degrees.
    within_1, within_2 : float
        Shares of the frames with an error of at most one and two of the stated standard deviations.
    missing : int
        Frames without an angle.
    """

    rms_deg: float
    bias_deg: float
    noise_deg: float
    within_1: float
    within_2: float
    missing: int


@dataclass(frozen=True)
class BalanceSummary:
    """What a run of the loop has shown.

    Attributes
    ----------
    frames : int
    loop_hz : float
        Mean rate that the loop reaches, simulation included.
    latency_median_ms, latency_p95_ms : float
        From the frame to the angle, elapsed time.
    processor_median_ms, processor_p95_ms : float
        The same in processor time of all threads.
    settle_s : list of float or None
        For each book that was put on: time until the tray stays level, until the next book; None if it does not.
    patch, proximity : AngleErrors
    noise_factor, rms_factor : float
        Noise and RMS error of the roll from the proximity camera alone, as multiples of the patch's.
    """

    frames: int
    loop_hz: float
    latency_median_ms: float
    latency_p95_ms: float
    processor_median_ms: float
    processor_p95_ms: float
    settle_s: list[float | None]
    patch: AngleErrors
    proximity: AngleErrors
    noise_factor: float
    rms_factor: float


def summarise(steps: Sequence[BalanceStep]) -> BalanceSummary:
    """Return the summary of at least one step."""
    latency, processor = (
        1e3 * np.array([getattr(step, name) for step in steps]) for name in ("latency_s", "processor_s")
    )
    patch, proximity = (
        _errors([getattr(step, name) for step in steps], [step.true_rad for step in steps])
        for name in ("patch", "proximity")
    )
    return BalanceSummary(
        frames=len(steps),
        loop_hz=1.0 / float(np.mean([step.loop_s for step in steps])),
        latency_median_ms=float(np.median(latency)),
        latency_p95_ms=float(np.quantile(latency, 0.95)),
        processor_median_ms=float(np.median(processor)),
        processor_p95_ms=float(np.quantile(processor, 0.95)),
        settle_s=settle_times(steps),
        patch=patch,
        proximity=proximity,
        noise_factor=proximity.noise_deg / patch.noise_deg if patch.noise_deg else math.nan,
        rms_factor=proximity.rms_deg / patch.rms_deg if patch.rms_deg else math.nan,
    )


def settle_times(steps: Sequence[BalanceStep]) -> list[float | None]:
    """Return for each book put on before the last step how long the tray took to stay level; None if it never did."""
    times = np.array([step.time_s for step in steps])
    level = np.degrees(np.abs([step.roll_rad for step in steps])) <= LEVEL_DEG
    settled: list[float | None] = []
    put_on = [book.time_s for book in BOOKS if book.time_s < times[-1]]
    for begin, end in zip(put_on, [*put_on[1:], math.inf][: len(put_on)], strict=True):
        during = np.flatnonzero((times >= begin) & (times < end))
        off = during[~level[during]]
        if off.size and off[-1] == during[-1]:
            settled.append(None)
        else:
            settled.append(float(times[off[-1] + 1] - begin) if off.size else 0.0)
    return settled


def _errors(tilts: Sequence[Tilt], true_rad: Sequence[float]) -> AngleErrors:
    known = [(each.roll_rad, each.roll_sigma_rad, true) for each, true in zip(tilts, true_rad, strict=True)]
    rows: Float64Array = np.array([row for row in known if None not in row], dtype=np.float64).reshape(-1, 3)
    if len(rows) < 2:
        return AngleErrors(math.nan, math.nan, math.nan, math.nan, math.nan, len(tilts) - len(rows))
    error, sigma = rows[:, 0] - rows[:, 2], rows[:, 1]
    return AngleErrors(
        rms_deg=math.degrees(math.sqrt(float(np.mean(error**2)))),
        bias_deg=math.degrees(float(error.mean())),
        noise_deg=math.degrees(float(np.std(np.diff(error))) / math.sqrt(2)),
        within_1=float(np.mean(np.abs(error) <= sigma)),
        within_2=float(np.mean(np.abs(error) <= 2 * sigma)),
        missing=len(tilts) - len(rows),
    )
