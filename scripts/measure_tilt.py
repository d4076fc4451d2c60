"""Balance the tray with every sensor and seed, and print a table: angle error, latency, rate, settle times.

Each seed is a rig of its own: its noise is measured first. Sensors marked with * are held out: no method was developed
on them. Times are those of this computer while it measures; *cpu* is processor time of all threads.

Most of an angle's error stays as long as the rig does, so a run of the loop tells little about its standard deviation.
A second table, or with --honesty that alone, draws the tray with one new noise after another, and prints how many
errors of roll and pitch lie within one and two standard deviations, with the standard error of that share over noises.

    .venv/bin/python scripts/measure_tilt.py [--sensors l515-d405,worn] [--seeds 3] [--control patch]
    .venv/bin/python scripts/measure_tilt.py --honesty [--noises 40]
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.estimation.balance import BalanceLoop, BalanceSummary, summarise
from tactune.core.estimation.tilt import TiltEstimator
from tactune.core.evaluation.sensor_table import measured_rig
from tactune.core.sources.presets import load_preset
from tactune.core.sources.simulator.scenes import TRAY_ROLLS_DEG
from tactune.core.sources.simulator.sensors import DEFAULT_SENSOR, SENSORS
from tactune.core.sources.simulator.source import SimulatorSource

#: What must hold: RMS on the default and on any sensor, degrees; coverage; rate, frames/s; latency, ms; settling, s.
DEFAULT_RMS_DEG, WORST_RMS_DEG = 0.3, 0.6
COVERAGE, COVERAGE_MARGIN = (0.68, 0.95), 0.05
MIN_HZ, MAX_P95_MS, MAX_SETTLE_S = 29.0, 10.0, 1.5
#: Rolls at which the second table draws the tray, as places among the solved rolls: -4.5, 0.3 and 4.6 degrees. A rig is
#: measured once for this number of noises; the first noise has this seed.
PLACES, NOISES_PER_RIG, FIRST_NOISE = (7.0, 16.6, 25.2), 4, 5000

HEADER = "sensor         RMS deg  largest   noise  missing   p95 ms  cpu p95  loop Hz settle s prox RMS  x RMS x noise"
HONESTY_HEADER = "sensor         RMS deg  sigma   within 1 sigma   within 2 sigma"


def run(sensor: str, seed: int, seconds: float, control: str) -> BalanceSummary:
    """Balance once."""
    with SimulatorSource("tray", seed=seed, sensor=sensor) as source:
        loop = BalanceLoop(source, measured_rig(load_preset("simulator"), source), control)
        return summarise([loop.step() for _ in range(round(seconds * source.frame_rate_hz))])


def rms(values: Sequence[float]) -> float:
    """Return the root mean square of the numbers that are known, nan if none is."""
    known = [value for value in values if not math.isnan(value)]
    return math.sqrt(float(np.mean(np.square(known)))) if known else math.nan


def row(name: str, runs: list[BalanceSummary]) -> str:
    """Return a line of the table: means over seeds, RMS for errors, the largest latency and settle time."""
    patch, alone = [each.patch for each in runs], [each.proximity for each in runs]
    settle = [time for each in runs for time in each.settle_s]
    worst = "never" if None in settle else f"{max(time for time in settle if time is not None):.2f}"
    latency, processor = (max(getattr(each, key) for each in runs) for key in ("latency_p95_ms", "processor_p95_ms"))
    return (
        f"{name:13s} {rms([e.rms_deg for e in patch]):8.3f} {max(e.rms_deg for e in patch):8.3f} "
        f"{rms([e.noise_deg for e in patch]):7.3f} {sum(e.missing for e in patch):8d} "
        f"{latency:8.1f} {processor:8.1f} {min(e.loop_hz for e in runs):8.0f} {worst:>7s} "
        f"{rms([e.rms_deg for e in alone]):8.3f} "
        f"{rms([e.rms_deg for e in alone]) / rms([e.rms_deg for e in patch]):6.2f} "
        f"{rms([e.noise_deg for e in alone]) / rms([e.noise_deg for e in patch]):6.2f}"
    )


def verdicts(tables: dict[str, list[BalanceSummary]]) -> Iterator[tuple[str, bool]]:
    """Yield what must hold, with its number, and whether it does."""
    runs = [each for of_sensor in tables.values() for each in of_sensor]
    error = {sensor: rms([each.patch.rms_deg for each in of_sensor]) for sensor, of_sensor in tables.items()}
    worst = max(error, key=lambda sensor: error[sensor])
    if DEFAULT_SENSOR in error:
        usual = error[DEFAULT_SENSOR]
        yield f"{usual:.2f} degrees RMS on {DEFAULT_SENSOR}, at most {DEFAULT_RMS_DEG}", usual <= DEFAULT_RMS_DEG
    yield f"{error[worst]:.2f} degrees RMS on {worst}, at most {WORST_RMS_DEG}", error[worst] <= WORST_RMS_DEG
    slowest, latest = min(each.loop_hz for each in runs), max(each.latency_p95_ms for each in runs)
    busy = max(each.processor_p95_ms for each in runs)
    yield f"{slowest:.0f} frames/s, at least {MIN_HZ:g}", slowest >= MIN_HZ
    yield f"{latest:.1f} ms from frame to angle at the 95th percentile, at most {MAX_P95_MS:g}", latest <= MAX_P95_MS
    yield f"{busy:.1f} ms of processor time, at most {MAX_P95_MS:g}", busy <= MAX_P95_MS
    settle = [math.inf if time is None else time for each in runs for time in each.settle_s]
    yield f"level after {max(settle):.2f} s at the latest, at most {MAX_SETTLE_S}", max(settle) <= MAX_SETTLE_S
    both = [each for each in runs if not math.isnan(each.rms_factor)]
    noisier = rms([each.proximity.rms_deg for each in both]) / rms([each.patch.rms_deg for each in both])
    yield f"proximity alone has {noisier:.2f} times the RMS error, where it finds an angle", noisier > 1.0


@dataclass(frozen=True)
class Honesty:
    """RMS error and stated sigma, degrees; shares within one and two sigma, and their standard errors."""

    rms_deg: float
    sigma_deg: float
    within: tuple[float, float]
    error: tuple[float, float]


def honesty(sensor: str, first_seed: int, noises: int) -> Honesty:
    """Measure roll and pitch of the still tray with many noises."""
    errors, sigmas = np.full((2, noises, 2 * len(PLACES)), np.nan)
    preset = load_preset("simulator")
    for number in range(noises):
        with SimulatorSource("tray", seed=first_seed + number, sensor=sensor) as source:
            if number % NOISES_PER_RIG == 0:
                preset = measured_rig(load_preset("simulator"), source)
            pipeline, estimator = ContactPipeline(preset, source.rig), TiltEstimator(preset, source.rig)
            found = [estimator.estimate(pipeline.process(source.draw(number, place))) for place in PLACES]
        angles = [(each.roll_rad, each.pitch_rad) for each in found]
        true = np.radians([(np.interp(place, range(len(TRAY_ROLLS_DEG)), TRAY_ROLLS_DEG), 0.0) for place in PLACES])
        errors[number] = (np.array(angles, np.float64) - true).reshape(-1)
        sigmas[number] = np.array([(each.roll_sigma_rad, each.pitch_sigma_rad) for each in found], float).reshape(-1)
    inside = [np.mean(np.abs(errors) <= sigma * sigmas, axis=1) for sigma in (1, 2)]
    one, two = (float(each.mean()) for each in inside)
    least = [math.sqrt(share * (1 - share) / errors.size) for share in COVERAGE]  # were all errors independent
    error_1, error_2 = (
        max(float(each.std(ddof=1)) / math.sqrt(noises), low) for each, low in zip(inside, least, strict=True)
    )
    rms_deg, sigma_deg = (math.degrees(rms(each.reshape(-1).tolist())) for each in (errors, sigmas))
    return Honesty(rms_deg, sigma_deg, (one, two), (error_1, error_2))


def honesty_row(name: str, found: Honesty) -> str:
    """Return a line of the second table, with a verdict for both shares."""
    row = f"{name:13s} {found.rms_deg:8.3f} {found.sigma_deg:6.3f}"
    for share, error, wanted in zip(found.within, found.error, COVERAGE, strict=True):
        away = abs(share - wanted) - COVERAGE_MARGIN
        verdict = "holds" if away <= 0 else "cannot tell" if away <= 2 * error else "DOES NOT"
        row += f"   {100 * share:3.0f} +- {100 * error:.0f} % {verdict}"
    return row


def main() -> None:
    """Print the table line by line, then what holds."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sensors", default=",".join(SENSORS), help="names, separated by commas")
    parser.add_argument("--seeds", type=int, default=3, help="number of seeds")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=12.0)
    parser.add_argument("--control", choices=("patch", "proximity"), default="patch", help="which angle controls")
    parser.add_argument("--honesty", action="store_true", help="print the second table only")
    parser.add_argument("--noises", type=int, default=40, help="number of noises of the second table")
    options = parser.parse_args()
    names = options.sensors.split(",")
    if not options.honesty:
        balance(names, options)
    print(HONESTY_HEADER)
    for sensor in names:
        if not SENSORS[sensor].exact:  # it has one error, not a distribution of errors
            found = honesty(sensor, options.first_seed + FIRST_NOISE, options.noises)
            print(honesty_row(sensor + "*" * SENSORS[sensor].held_out, found), flush=True)


def balance(names: Sequence[str], options: argparse.Namespace) -> None:
    """Print the first table and what holds."""
    print(HEADER)
    tables: dict[str, list[BalanceSummary]] = {}
    for sensor in names:
        seeds = range(options.first_seed, options.first_seed + options.seeds)
        tables[sensor] = [run(sensor, seed, options.seconds, options.control) for seed in seeds]
        print(row(sensor + "*" * SENSORS[sensor].held_out, tables[sensor]), flush=True)
    runs = [each for of_sensor in tables.values() for each in of_sensor]
    print(row("all", runs))
    for sentence, holds in verdicts(tables):
        print(f"{'holds   ' if holds else 'DOES NOT'} {sentence}")


if __name__ == "__main__":
    main()
