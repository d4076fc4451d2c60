"""Compare strain measured from the simulated dots with the solver's, in percent.

    python scripts/measure_strain.py [--sensors NAMES] [--seeds 0,1,2,3,4] [--frames N] [SCENE...]

Each line gives, along length and width: the largest strain measured from the dots; the solver's largest between
neighbouring dots that the tactile camera sees whole (at least 90 % of each dot's area); the solver's largest of all,
hidden dots included; and measured minus whole, in percentage points. The N frames at rest (default 30) are averaged.
The last lines name the largest strain and say how many differences are within two of the stated standard deviations,
and whether all are within 2 points; the exit code is 1 if not.
"""

from __future__ import annotations

import argparse
import math
from itertools import islice

from tactune.core.evaluation.strain.average import average_still
from tactune.core.evaluation.strain.strain import measure_strain
from tactune.core.sources.registry import open_source

_SCENES = {
    " ".join(filter(None, (shape, press, side))): f"sim:{shape}?press={press}&grid=dots" + f"&side={side}" * bool(side)
    for press, sides in (("low", ("",)), ("medium", ("",)), ("high", ("right", "left")))
    for shape in ("cube", "cup", "octopus")
    for side in sides
} | {"stiff cube high right": "sim:stiff?press=high&object=cube&grid=dots"}
_WITHIN_POINTS = 2.0

_COLUMNS = "dots, whole, all, off"
_HEAD = f"""Largest strain between neighbouring dots, percent. dots: measured. whole: the solver's, where the tactile
camera sees both dots whole. all: the solver's, hidden dots included. off: dots minus whole, points.
{"scene":23s}{"seed":>4s}{"dots":>6s} | {"length: " + _COLUMNS:^31s} | {"width: " + _COLUMNS:^31s} | sensor"""


def main() -> int:
    """Print one line per scene and seed, and the verdict."""
    parser = argparse.ArgumentParser(description="Compare measured strain with the solver's.")
    parser.add_argument("--sensors", default="datasheet", help="sensors of the simulator, separated by commas")
    parser.add_argument("--seeds", default="0,1,2,3,4", help="seeds of the cameras' noise, separated by commas")
    parser.add_argument("--frames", type=int, default=30, help="frames at rest that are averaged")
    parser.add_argument("scene", nargs="*", default=[], help="'cup high right', ...; all by default")
    words = parser.parse_args()
    if missing := set(words.scene) - set(_SCENES):
        parser.error(f"no such scene: {', '.join(sorted(missing))}; choose from {', '.join(_SCENES)}")
    print(_HEAD)
    results = []
    for name in words.scene or _SCENES:
        for seed in map(int, words.seeds.split(",")):
            for sensor in words.sensors.split(","):
                results += [(*line, name, seed) for line in _compare(name, seed, words.frames, sensor)]
    whole, axis, name = max((whole, axis, name) for _, _, whole, axis, name, _ in results)
    print(f"largest strain over whole dots: {whole:.1f} %, {axis} of {name}")
    off, _, _, axis, name, seed = max(results, key=lambda result: abs(result[0]))
    stated = sum(abs(off) <= 2 * sigma for off, sigma, *_ in results)
    print(f"within two standard deviations: {stated} of {len(results)}")
    within = sum(abs(result[0]) <= _WITHIN_POINTS for result in results)
    print(
        f"within {_WITHIN_POINTS:g} points: {'yes' if within == len(results) else 'no'}, {within} of {len(results)}; "
        f"worst {off:+.1f}, {axis} of {name}, seed {seed}; "
        f"root mean square {math.sqrt(sum(result[0] ** 2 for result in results) / len(results)):.2f}"
    )
    return int(within < len(results))


def _compare(name: str, seed: int, frames: int, sensor: str) -> list[tuple[float, float, float, str]]:
    """Print the line of a scene; return error and its stated sigma, points, the solver's percent, and the direction."""
    with open_source(f"{_SCENES[name]}&sensor={sensor}&seed={seed}") as source:
        frame, _ = average_still(list(islice(source, frames)), source.rig)
        measured = measure_strain(frame, source.rig)
    assert frame.truth is not None and frame.truth.strain is not None
    known, words, results = frame.truth.strain, [f"{name:23s}{seed:4d}{measured.dots:6d}"], []
    for axis, found, whole, every in (
        ("length", measured.length, known.length_seen, known.length),
        ("width", measured.width, known.width_seen, known.width),
    ):
        off = 100 * (found.largest - whole)
        words.append(f"{100 * found.largest:7.1f} {100 * whole:7.1f} {100 * every:7.1f} {off:+7.1f}")
        results.append((off, 100 * found.largest_sigma, 100 * whole, axis))
    print(" | ".join([*words, sensor]), flush=True)
    return results


if __name__ == "__main__":
    raise SystemExit(main())
