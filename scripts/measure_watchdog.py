"""Measure the drift watchdog: which injected changes it finds and when, its false alarms, and the cost of a look.

    .venv/bin/python scripts/measure_watchdog.py [found|ordinary|all] [--sensors NAME,...] [--minutes 30]

*found*: a simulated rig at rest; after two minutes a camera moves, the pressure changes or a lens gets dirty. One look
every ten seconds. The seconds count from the change. *ordinary*: looks at random frames of objects that approach,
press, hold and leave, with the light dimmed for a third of the time, and at the end an object that stays; every report
is a false alarm.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))

from drifted import Drift, DriftedSimulator
from tactune.core.calibration.snapshots import take_snapshot
from tactune.core.model.frames import SensorFrame
from tactune.core.rig.watch import INTERVAL_S, Watchdog
from tactune.core.sources.presets import load_preset
from tactune.core.sources.simulator.scenes import Light, Variant
from tactune.core.sources.simulator.sensors import DEFAULT_SENSOR

SENSORS = f"{DEFAULT_SENSOR},datasheet,stereo,heavy,worn,far-offset"
OBJECTS = ("cup", "cube", "octopus", "star")
#: Frames that are averaged into the untouched frame, and looks before the change.
AVERAGED, BEFORE = 15, 12
#: A change that is not found within these looks, ten minutes, counts as not found.
LONGEST = 60
#: Looks after a change was told: a second report mistakes one change for another.
MORE = 6
#: Growth of the apex, metres, for a percent of gauge pressure in the simulator; measured below for each change.
APEX_M_PER_PERCENT = 0.00038


@dataclass(frozen=True)
class Injected:
    """One change, in words, its size and unit, and the press during which it happens."""

    words: str
    size: str
    drift: Drift
    press: str = "none"


def injected() -> Iterator[Injected]:
    """Yield all changes."""
    for camera in ("tactile", "proximity"):
        for mm in (0.5, 1.0, 2.0, 5.0, 20.0):
            yield Injected(f"{camera} camera sideways", f"{mm:g} mm", Drift(camera, (mm / 1e3, 0.0, 0.0)))
        for mm in (0.5, 1.0):
            yield Injected(f"{camera} camera towards the membrane", f"{mm:g} mm", Drift(camera, (0.0, 0.0, mm / 1e3)))
        for degrees in (0.1, 0.5, 5.0):
            yield Injected(f"{camera} camera turned", f"{degrees:g} deg", Drift(camera, turn_deg=(0.0, degrees, 0.0)))
    for percent in (1, 2, 5, 20, -1, -2, -5, -20):
        yield Injected("pressure", f"{percent:+d} %", Drift(apex_m=percent * APEX_M_PER_PERCENT))
    for camera in ("tactile", "proximity"):
        for px in (0.7, 1.0, 2.0, 4.0):
            yield Injected(f"{camera} lens, all blurred", f"{px:g} px", Drift(camera, blur_px=px))
        yield Injected(f"{camera} lens, smear", "30 % of the width", Drift(camera, smear=0.3))
    for mm in (0.5, 1.0, 2.0, 5.0):
        yield Injected(
            "tactile camera sideways, cup pressed", f"{mm:g} mm", Drift("tactile", (mm / 1e3, 0, 0)), "medium"
        )


def source(
    sensor: str, drift: Drift, press: str = "none", scene: str = "cup", light: Light = "normal"
) -> DriftedSimulator:
    """Return a scene of the one rig that all looks belong to, after a drift."""
    return DriftedSimulator(drift, scene=scene, variant=Variant(press=press), sensor=sensor, light=light)


def watchdog(sensor: str) -> Watchdog:
    """Return a watchdog with an untouched frame of this rig."""
    rest = source(sensor, Drift())
    untouched = take_snapshot([rest.read(index) for index in range(AVERAGED)]).frame
    return Watchdog(load_preset("simulator"), rest.rig, untouched)


def later(frames: DriftedSimulator) -> Callable[[int], SensorFrame]:
    """Return frames by look, with other noise than that of the untouched frame."""
    return lambda look: frames.read(AVERAGED + look % (frames.length - AVERAGED))


def measure_found(sensor: str) -> None:
    """Print a row for each change."""
    rest = source(sensor, Drift())
    pressure_pa = rest.facts(0).gauge_pressure_pa
    for change in injected():
        after = source(sensor, change.drift, change.press)
        watch = watchdog(sensor)
        before = later(source(sensor, Drift(), change.press))
        said = [watch.look(before(look), look * INTERVAL_S) for look in range(BEFORE)]
        assert not any(said), said
        seen = later(after)
        report = None
        looks = 0
        while report is None and looks < LONGEST:
            report = watch.look(seen(looks), (BEFORE + looks) * INTERVAL_S)
            looks += 1
        later_on = (watch.look(seen(looks + look), (BEFORE + looks + look) * INTERVAL_S) for look in range(MORE))
        more = [again.sentence for again in later_on if again is not None]
        risen = after.facts(0).gauge_pressure_pa / pressure_pa - 1
        size = (
            f"{change.size} ({100 * risen:+.1f} %, apex {1e3 * change.drift.apex_m:+.1f} mm)"
            if change.drift.apex_m
            else change.size
        )
        found = (
            f"{looks * INTERVAL_S:4.0f} s  {' '.join([report.sentence, *more])}" if report is not None else "not found"
        )
        print(f"{sensor:10} {change.words:38} {size:34} {found}", flush=True)


def measure_ordinary(sensor: str, minutes: float) -> int:
    """Print false alarms and the cost of a look for each object; return the number of false alarms."""
    alarms = 0
    for name in OBJECTS:
        watch, rng = watchdog(sensor), np.random.default_rng(7)
        lights: tuple[Light, ...] = ("normal", "dim")
        scenes = {
            (light, press): source(sensor, Drift(), press, name, light)
            for light in lights
            for press in ("", "none", "low", "medium")
        }
        costs, judged, said = [], 0, []
        looks = round(60 * minutes / INTERVAL_S)
        for look in range(looks):
            light = lights[looks // 3 <= look < 2 * looks // 3]
            press = ("", "none", "low", "medium")[rng.choice(4, p=(0.6, 0.2, 0.1, 0.1))]
            frames = scenes[light, "medium" if look >= looks * 5 // 6 else press]
            frame = frames.read(int(rng.integers(frames.length)))
            started = time.process_time()
            report = watch.look(frame, look * INTERVAL_S)
            costs.append(1e3 * (time.process_time() - started))
            judged += "tactile" in watch.readings
            if report is not None:
                said.append(report.sentence)
        alarms += len(said)
        usual = 1e3 * INTERVAL_S / 100
        print(
            f"{sensor:10} {name:8} {looks} looks, {judged} of them untouched, {len(said)} false alarms; "
            f"{np.median(costs):.0f} ms per look, mean {np.mean(costs):.0f} ms, "
            f"{np.mean(costs) / usual:.2f} % of a core",
            *said,
            sep="\n    " if said else "",
            flush=True,
        )
    return alarms


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", choices=("found", "ordinary", "all"), default="all")
    parser.add_argument("--sensors", default=SENSORS)
    parser.add_argument("--minutes", type=float, default=30.0)
    asked = parser.parse_args()
    sensors = asked.sensors.split(",")
    if asked.what in ("found", "all"):
        for sensor in sensors:
            measure_found(sensor)
    if asked.what in ("ordinary", "all"):
        print(f"{sum(measure_ordinary(sensor, asked.minutes) for sensor in sensors)} false alarms in all")


if __name__ == "__main__":
    main()
