"""Measure the membrane mechanics on the simulator: time and accuracy.

    .venv/bin/python scripts/measure_mechanics.py

The paper (Yin et al.) reports 0.3 s per frame for a mesh of about 440 nodes. Times are medians over the frames of one
press, on one thread; processor time does not depend on the machine's load.
"""

from __future__ import annotations

import statistics
import time

import numpy as np

from tactune.core.evaluation.metrics import cloud_distances, truth_cloud
from tactune.core.methods.mechanics import MembraneMechanics
from tactune.core.preset import Preset
from tactune.core.sources.simulator.source import SimulatorSource

NODES = (440, 1000, 2000)
#: Frames of a press; the first one is the untouched frame.
PRESSED = range(6, 42, 2)
PAPER_MS = 300.0


def measure_time():
    """Time of a whole frame and of the solver in it, and the patch's error, for meshes of three sizes."""
    for scene in ("cup", "cube", "octopus"):
        source = SimulatorSource(scene=scene, sensor="datasheet")
        frames = [source.read(index) for index in PRESSED]
        for nodes in NODES:
            method = MembraneMechanics(Preset(), source.rig, source.read(0), nodes=nodes)
            method.find(frames[0])
            whole, solving, errors = [], [], []
            for frame in frames:
                whole.append(timed(method.find, frame))
                solving.append(timed(method.solve, method.way_m(frame.tactile_depth)))
                found = cloud_distances(method.find(frame).points, truth_cloud(frame.truth, source.rig).points)
                errors.append(1e3 * found.symmetric_rmse_m)
            wall, processor = medians(whole)
            print(
                f"{scene:8s} {len(method.problem.mesh.pixels):5d} nodes: {wall:6.1f} ms a frame "
                f"({processor:.1f} ms of processor, {medians(solving)[1]:.1f} of it the solver; "
                f"{PAPER_MS / wall:.0f} times the paper's), RMSE {np.nanmedian(errors):.2f} mm"
            )


def timed(work, *arguments):
    """Return seconds of wall and of processor."""
    wall, processor = time.perf_counter(), time.process_time()
    work(*arguments)
    return time.perf_counter() - wall, time.process_time() - processor


def medians(times):
    """Return the median milliseconds of wall and of processor."""
    return tuple(1e3 * statistics.median(part) for part in zip(*times, strict=True))


if __name__ == "__main__":
    measure_time()
