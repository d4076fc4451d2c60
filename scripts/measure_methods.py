"""Measure every method on simulated table cells, and the contribution of each part of fusion-membrane.

    .venv/bin/python scripts/measure_methods.py [table] [ablation] [turned] [heldout] [hover] [--seeds=0,1,2]

Default: table and ablation. Parameters were chosen on cube, cup, octopus, knobs and star with seeds 0 to 4; those of
the equilibrium step also on the ``turned`` shapes. ``heldout`` uses the shapes mug and hand, and the other scenes with
seeds from 100. Each number is the mean over the seeds, one frame per seed: average symmetric RMSE in millimetres, and
IoU. Times are medians of alternating runs. The two ``simulator`` methods use the preset made for the simulator
(t = 0.008); all others use the preset ``default`` (t = 0.03) with the simulator's mask. The straight method is
fusion-homography.
"""

from __future__ import annotations

import statistics
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
from turned_shapes import TURNED

from tactune.core.bench.measure import time_in_turns
from tactune.core.evaluation.metrics import pixel_scores, symmetric_rmse_m, truth_cloud
from tactune.core.methods.fusion import Fusion
from tactune.core.methods.method import ContactMethod, MethodPatch
from tactune.core.methods.registry import make_method, method_names
from tactune.core.model.frames import Rig, SensorFrame
from tactune.core.sources.presets import load_preset
from tactune.core.sources.simulator.scenes import Variant
from tactune.core.sources.simulator.source import SimulatorSource

SIMULATOR = load_preset("simulator")
STRAIGHT = load_preset("default").model_copy(update={"mask": SIMULATOR.mask})
PRESSES = ("low", "medium", "high")
DEVELOPED = tuple((name, press) for press in PRESSES for name in ("cube", "cup", "octopus", "knobs", "star"))
SPECIAL = (("stiff", ""), ("wrinkled", ""))
NEW_SHAPES = tuple((name, press) for press in PRESSES for name in ("mug", "hand"))
TURNED_PRESSES = tuple((name, press) for press in ("low", "medium") for name in TURNED)
HELD_OUT_SEEDS = (100, 101, 102)
OURS, AVERAGED = "fusion-membrane", "fusion-averaged"
MEMBRANE = {"contact_test": "membrane", "alignment.model": "rigid"}
#: Number of time measurements per method and table cell.
ROUNDS = 9

#: Preset fields that turn off or change one part of the membrane test.
PARTS: dict[str, dict[str, float | bool]] = {
    "all parts": {},
    "15 frames averaged": {"membrane.frames": 15},
    "no bias correction": {"membrane.bias": False},
    "no cluster rule": {"membrane.min_area_mm2": 0.0},
    "gap 0.3 mm": {"membrane.gap_m": 0.0003},
    "equilibrium length 8 mm": {"membrane.trust_m": 0.008},
    "equilibrium length 30 mm": {"membrane.trust_m": 0.03},
    "shape over 2 px": {"membrane.shape_px": 2.0},
    "shape over 8 px": {"membrane.shape_px": 8.0},
}

Cell = tuple[str, str]
Build = Callable[[Rig, SensorFrame], ContactMethod]


@dataclass(frozen=True)
class Result:
    """Means over seeds; RMSE is nan where a method found nothing with any of them."""

    rmse_mm: float
    iou: float
    ms: float


@cache
def source(cell: Cell, seed: int) -> SimulatorSource:
    """Open a still press once."""
    name, press = cell
    return SimulatorSource(name, seed=seed, variant=Variant(press=press), sensor="datasheet")


@cache
def untouched() -> SensorFrame:
    """Return the untouched frame for methods that need one."""
    return SimulatorSource("hover", seed=7, variant=Variant(gap_mm=20.0), sensor="datasheet").read(0)


def measure(builds: dict[str, Build], cell: Cell, seeds: Sequence[int]) -> dict[str, Result]:
    """Run methods on one frame of each seed and score them; the methods' times are measured in turns."""
    rig = source(cell, seeds[0]).rig
    methods = {label: build(rig, untouched()) for label, build in builds.items()}
    rmse: dict[str, list[float]] = {label: [] for label in builds}
    iou: dict[str, list[float]] = {label: [] for label in builds}
    for seed in seeds:
        frame = frame_of(cell, seed)
        truth = truth_cloud(frame.truth, rig).points
        for label, method in list(methods.items()):
            if method.remembers > 1:
                method = methods[label] = builds[label](rig, untouched())  # noqa: PLW2901 - one seed's frames only
            for earlier in range(frame.sequence - method.remembers + 1, frame.sequence):
                method.find(source(cell, seed).read(earlier))
            patch = method.find(replace(frame, truth=None))
            rmse[label].append(1e3 * symmetric_rmse_m(patch.points, truth))
            iou[label].append(pixel_scores(patch.mask, frame.truth.contact).iou)
    timed = frame_of(cell, seeds[0])
    runs = {label: partial(_run, method, timed) for label, method in methods.items()}
    ms = {label: timing.median_ms for label, timing in time_in_turns(runs, ROUNDS).items()}
    return {label: Result(float(np.mean(rmse[label])), float(np.mean(iou[label])), ms[label]) for label in builds}


def frame_of(cell: Cell, seed: int) -> SensorFrame:
    """Return the measured frame of a seed."""
    return source(cell, seed).read(15 + 7 * (seed % 3))


def _run(method: ContactMethod, frame: SensorFrame) -> MethodPatch:
    """Find the patch of a frame without cached results."""
    return method.find(replace(frame, truth=None))


def show(builds: dict[str, Build], cells: Sequence[Cell], seeds: Sequence[int]) -> None:
    """Print a line per method: RMSE per cell, then mean RMSE, mean IoU, median time; and which is the best."""
    print(f"\nRMSE in mm, seeds {', '.join(map(str, seeds))}; ms: median over the cells, measured in turns")
    print(f"{'':26s}" + "".join(f"{name[:7]:>9s}" for name, _ in cells) + "     mean     IoU      ms")
    print(f"{'':26s}" + "".join(f"{press:>9s}" for _, press in cells))
    by_cell = [measure(builds, cell, seeds) for cell in cells]
    rows = {label: [results[label] for results in by_cell] for label in builds}
    for label, row in rows.items():
        found = [result.rmse_mm for result in row]
        print(
            f"{label:26s}" + "".join(f"{value:9.2f}" for value in found) + f"{np.mean(found):9.2f}"
            f"{np.mean([result.iou for result in row]):8.2f}"
            f"{statistics.median(result.ms for result in row):8.2f}",
            flush=True,
        )
    if "fusion-homography" in rows:
        for label in (OURS, AVERAGED):
            shares = [
                ours.rmse_mm / straight.rmse_mm
                for ours, straight in zip(rows[label], rows["fusion-homography"], strict=True)
            ]
            print(f"{label:18s}of straight" + "".join(f"{share:9.2f}" for share in shares))
        best = [
            min(rows, key=lambda label: np.nan_to_num(rows[label][i].rmse_mm, nan=np.inf)) for i in range(len(cells))
        ]
        print(f"lowest: {OURS} in {best.count(OURS)}, {AVERAGED} in {best.count(AVERAGED)} of {len(cells)} cells")


def methods() -> dict[str, Build]:
    """Return every method with the straight preset, and fusion also with the simulator's preset."""
    builds: dict[str, Build] = {
        name: (lambda rig, untouched, name=name: make_method(name, STRAIGHT, rig, untouched)) for name in method_names()
    }
    for name in ("fusion-rigid", "fusion-homography"):
        builds[f"{name} simulator"] = lambda rig, untouched, name=name: make_method(name, SIMULATOR, rig, untouched)
    return builds


def parts() -> dict[str, Build]:
    """Return variants of fusion-membrane, each without one part."""
    return {
        label: (lambda rig, untouched, values=values: Fusion(STRAIGHT.with_values(values), rig, OURS, MEMBRANE))
        for label, values in PARTS.items()
    }


def hover() -> None:
    """Print the number of false points for hovering objects."""
    print("\nFalse points of fusion-membrane (maximum of 3 frames) by distance to the object")
    for shape in ("cube", "cup", "octopus"):
        found = []
        for gap_mm in (1.0, 2.0, 3.0, 4.0, 5.0, 10.0):
            still = SimulatorSource("hover", seed=100, variant=Variant(object=shape, gap_mm=gap_mm), sensor="datasheet")
            method = make_method(OURS, STRAIGHT, still.rig)
            most = max(len(method.find(still.read(index)).points) for index in (0, 7, 14))
            found.append(f"{gap_mm:g} mm: {most}")
        print(f"{shape:8s} " + "   ".join(found), flush=True)


def main(arguments: Sequence[str]) -> None:
    """Run the measurements that the arguments name."""
    if "-h" in arguments or "--help" in arguments:
        print(__doc__)
        return
    names = [name for name in arguments if not name.startswith("--")] or ["table", "ablation"]
    seeds = (0, 1, 2)
    for option in arguments:
        if option.startswith("--seeds="):
            seeds = tuple(int(seed) for seed in option.partition("=")[2].split(","))
    if "table" in names:
        show(methods(), DEVELOPED + SPECIAL, seeds)
    if "ablation" in names:
        show(parts(), DEVELOPED + SPECIAL, seeds)
    if "turned" in names:
        both = {
            label: build
            for label, build in parts().items()
            if label in {"all parts", "shape over 2 px", "shape over 8 px"}
        }
        show(both, TURNED_PRESSES, seeds)
    if "heldout" in names:
        show(methods(), NEW_SHAPES, HELD_OUT_SEEDS)
        show(methods(), DEVELOPED + SPECIAL, HELD_OUT_SEEDS)
    if "hover" in names:
        hover()


if __name__ == "__main__":
    main(sys.argv[1:])
