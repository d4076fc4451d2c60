"""Print for each sensor the error of a still tray's tilt, and the share of errors within one and two sigma.

Most of an angle's error stays as long as the rig does, so the tray is drawn with one new noise after another. The rig
is measured again for every fourth noise. Sensors marked with * are held out: no method was developed on them.

    .venv/bin/python scripts/measure_tilt.py [--sensors l515-d405,worn] [--noises 32]
"""

from __future__ import annotations

import argparse

import numpy as np

from tactune.core import ContactPipeline, TiltEstimator, load_preset
from tactune.core.lab.table import measured_rig
from tactune.core.sources.simulator.scenes import TRAY_ROLLS_DEG
from tactune.core.sources.simulator.sensors import SENSORS
from tactune.core.sources.simulator.simulator_source import SimulatorSource

#: Where the tray is drawn, as places among the solved rolls: -4.5, 0.5 and 4.5 degrees.
PLACES, NOISES_PER_RIG, FIRST_NOISE = (7, 17, 25), 4, 5000


def measure(sensor: str, first_seed: int, noises: int) -> str:
    """Return a line of the table: roll and pitch of the still tray with many noises."""
    true = np.radians([(TRAY_ROLLS_DEG[place], 0.0) for place in PLACES])
    errors, sigmas = np.full((2, noises, len(PLACES), 2), np.nan)
    preset = load_preset("simulator")
    for number in range(noises):
        with SimulatorSource("tray", seed=first_seed + number, sensor=sensor) as source:
            if number % NOISES_PER_RIG == 0:
                preset = measured_rig(load_preset("simulator"), source)
            pipeline, estimator = ContactPipeline(preset, source.rig), TiltEstimator(preset, source.rig)
            found = [estimator.estimate(pipeline.process(source.draw(number, place))) for place in PLACES]
        errors[number] = np.array([(each.roll_rad, each.pitch_rad) for each in found], np.float64) - true
        sigmas[number] = np.array([(each.roll_sigma_rad, each.pitch_sigma_rad) for each in found], np.float64)
    error_deg, sigma_deg = (np.degrees(np.sqrt(np.nanmean(each**2))) for each in (errors, sigmas))
    within = [100 * float(np.mean(np.abs(errors) <= times * sigmas)) for times in (1, 2)]
    name = sensor + "*" * SENSORS[sensor].held_out
    return f"{name:13s} {error_deg:8.3f} {sigma_deg:10.3f} {within[0]:12.0f} % {within[1]:12.0f} %"


def main() -> None:
    """Print the table line by line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sensors", default=",".join(SENSORS), help="names, separated by commas")
    parser.add_argument("--noises", type=int, default=32)
    parser.add_argument("--first-seed", type=int, default=0)
    options = parser.parse_args()
    print("sensor         RMS deg  sigma deg  within sigma   within 2 sigma")
    for sensor in options.sensors.split(","):
        if not SENSORS[sensor].exact:  # it has one error, not a distribution of errors
            print(measure(sensor, options.first_seed + FIRST_NOISE, options.noises), flush=True)


if __name__ == "__main__":
    main()
