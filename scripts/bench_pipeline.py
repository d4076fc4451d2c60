"""Print what each part of the pipeline costs, in processor time of one thread and in wall time of all.

    .venv/bin/python scripts/bench_pipeline.py [--rounds N]

Processor time does not depend on what else the machine does; wall times are medians of calls in turns with
copying both depth images, to compare. ``tactune bench`` compares with other ways to do the same.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tactune.core import ContactPipeline
from tactune.core.bench.scenes import BenchScene, make_scene
from tactune.core.contact.alignment import make_alignment
from tactune.core.contact.flat import flat
from tactune.core.contact.kernels.threads import available_threads, set_threads
from tactune.core.contact.outliers.statistical import statistical_inliers
from tactune.core.contact.tolerance import ToleranceFinder, drop_small_clusters

SCENES = ("empty", "untouched", "light-touch", "cup-medium", "octopus-high", "noisy-51k", "full-contact")


def processor_ms(call: Callable[[], object], rounds: int) -> float:
    """Return the median processor time of a call on one thread, milliseconds."""
    call()
    taken = []
    for _ in range(rounds):
        start = time.thread_time_ns()
        call()
        taken.append(time.thread_time_ns() - start)
    return statistics.median(taken) / 1e6


def wall_ms(calls: dict[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Return the median wall time of calls made in turns, milliseconds."""
    taken: dict[str, list[int]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            start = time.perf_counter_ns()
            call()
            taken[name].append(time.perf_counter_ns() - start)
    return {name: statistics.median(times) / 1e6 for name, times in taken.items()}


def measure(scene: BenchScene, rounds: int) -> None:
    """Print one scene's line of processor times and one of wall times."""
    rig, preset, frame = scene.rig, scene.preset, scene.frame
    finder = ToleranceFinder(preset, rig, make_alignment(preset.alignment, rig))
    images = flat(frame.proximity_depth), flat(frame.tactile_depth)
    found = finder.candidates(frame)
    lens = rig.proximity.intrinsics
    set_threads(1)
    parts = {
        "coarse": lambda: finder.coarse.tiles(*images, finder.limits),
        "fusion": lambda: finder.candidates(frame),
        "k = 20": lambda: statistical_inliers(found.points, found.pixels, lens, 20, 2.0),
        "k = 50": lambda: statistical_inliers(found.points, found.pixels, lens, 50, 2.0),
        "clusters": lambda: drop_small_clusters(found, rig, preset.outliers),
        "provenance": lambda: finder.classify(frame),
        "aligned": lambda: finder.aligned(frame),
    }
    costs = "  ".join(f"{name} {processor_ms(call, rounds):.3f}" for name, call in parts.items())
    print(f"{scene.name} ({len(found)} points): {costs} ms of one thread")

    copies = [np.empty_like(image) for image in images]
    pipeline = ContactPipeline(preset, rig)

    def whole(threads: int) -> None:
        set_threads(threads)
        patch = pipeline.process(replace(frame))
        _ = patch.points, patch.mask

    walls = wall_ms(
        {
            "copy": lambda: [np.copyto(copy, image) for copy, image in zip(copies, images, strict=True)],
            "one thread": lambda: whole(1),
            f"{available_threads()} threads": lambda: whole(available_threads()),
        },
        rounds,
    )
    print("    whole frame: " + "  ".join(f"{name} {ms:.3f}" for name, ms in walls.items()) + " ms of wall time")


def main() -> None:
    """Measure every scene."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=31)
    arguments = parser.parse_args()
    for name in SCENES:
        measure(make_scene(name), arguments.rounds)


if __name__ == "__main__":
    main()
