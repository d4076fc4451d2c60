"""Spoil a preset in five ways, each alone and all together, and see whether *Suggest all* brings the accuracy back.

For each simulated scene the RMSE against the simulator's truth is printed with the shipped preset, with the spoiled one
and with the suggestions applied. The exit status is 1 if a suggestion leaves the RMSE more than 10 % above the shipped
preset's.
"""

from __future__ import annotations

import argparse
import math
import sys
from itertools import product
from typing import Any, Final

from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.evaluation.metrics import compare_with_truth
from tactune.core.model.frames import Rig, SensorFrame
from tactune.core.preset import Preset
from tactune.core.rig.untouched import untouched_frame
from tactune.core.sources.presets import load_preset
from tactune.core.sources.registry import open_source
from tactune.core.tuning.advice.proposal import Evidence
from tactune.core.tuning.advice.suggest import suggest_all

#: What is wrong with a spoiled preset, by name.
SPOILED: Final[dict[str, dict[str, Any]]] = {
    "mask off": {"mask.enabled": False},
    "wrong colour": {"mask.hue": (80, 110)},
    "offset 12 mm": {"alignment.depth_offset_m": 0.012},
    "t = 0.03": {"contact_test": "tolerance", "tolerance.t": 0.03},
    "cluster 0": {"membrane.min_area_mm2": 0.0, "outliers.min_cluster_area_mm2": 0.0},
}
ALL: Final = "all five"
#: Largest RMSE after the suggestions, as a multiple of the shipped preset's.
LIMIT: Final = 1.10
#: Number of the newest frames that the suggestions see.
FRAMES: Final = 4


def spoiled_presets(shipped: Preset) -> dict[str, Preset]:
    """Return the shipped preset, spoiled in each way and in all ways."""
    together = {path: value for changes in SPOILED.values() for path, value in changes.items()}
    return {name: shipped.with_values(changes) for name, changes in (SPOILED | {ALL: together}).items()}


def rmse_mm(preset: Preset, rig: Rig, frame: SensorFrame) -> float:
    """Return the RMSE of the patch against the truth; nan without a patch."""
    assert frame.truth is not None, "the simulator knows the truth"
    return compare_with_truth(ContactPipeline(preset, rig).process(frame), frame.truth, rig)["rmse_mm"]


def main() -> int:
    """Measure all scenes; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--objects", default="cube,cup,octopus")
    parser.add_argument("--presses", default="medium")
    parser.add_argument("--sensors", default="l515-d405,datasheet,heavy")
    parser.add_argument("--seeds", default="1")
    options = parser.parse_args()
    shipped = load_preset("simulator")
    worst = 0.0
    print(f"{'scene':42} {'spoiled':14} {'shipped':>8} {'spoiled':>8} {'suggested':>9} {'ratio':>6}")
    names = (options.objects, options.presses, options.sensors, options.seeds)
    for pressed, press, sensor, seed in product(*(text.split(",") for text in names)):
        with open_source(f"sim:{pressed}?press={press}&sensor={sensor}&seed={seed}") as source:
            frames = tuple(frame for _, frame in zip(range(FRAMES), source, strict=False))
            untouched = untouched_frame(source)
            rig, scene = source.rig, f"{pressed}, {press}, {sensor}, seed {seed}"
        good = rmse_mm(shipped, rig, frames[-1])
        for name, preset in spoiled_presets(shipped).items():
            proposals = suggest_all(Evidence(preset, rig, frames, untouched))
            before = rmse_mm(preset, rig, frames[-1])
            after = rmse_mm(proposals.merged.apply(preset), rig, frames[-1])
            ratio = after / good if math.isfinite(after) else math.inf
            worst = max(worst, 0.0 if math.isnan(good) else ratio)
            print(f"{scene:42} {name:14} {good:8.2f} {before:8.2f} {after:9.2f} {ratio:6.2f}", flush=True)
    print(f"largest ratio {worst:.2f}, allowed {LIMIT:.2f}; RMSE in mm")
    return 0 if worst <= LIMIT else 1


if __name__ == "__main__":
    sys.exit(main())
