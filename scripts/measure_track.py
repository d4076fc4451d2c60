"""Measure the pose tracker on simulated objects that move across the membrane.

    python scripts/measure_track.py [--sensors l515-d405,worn | --sensors all] [--seeds 0] [SCENE...]

It starts at the true pose and goes from frame to frame. mm and degrees: root mean square errors over the frames in the
directions that the tracker says are determined. lost: frames that the tracker says are lost. ms: processor time per
frame without the patch, median. 1s and 2s: share of errors within one and two standard deviations, along the determined
axes.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
import numpy.typing as npt

from tactune.core import ContactPipeline, PoseTracker, load_preset, open_source
from tactune.core.estimation.object_mesh import ObjectMesh, simulated_mesh
from tactune.core.estimation.pose import PoseEstimate, pose_error
from tactune.core.lab.table import measured_rig
from tactune.core.sources.simulator.sensors import SENSORS

Array = npt.NDArray[np.float64]

_SCENES = ("cup?move=slide",)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sensors", default="l515-d405", help="names of sensors, separated by commas, or all")
    parser.add_argument("--seeds", default="0", help="seeds of the cameras' noise, separated by commas")
    parser.add_argument("scene", nargs="*", default=_SCENES, help="sim: without its prefix; the sliding cup by default")
    words = parser.parse_args()
    print(f"{'scene':16s}{'sensor':12s}{'mm':>7} {'degrees':>7} {'ms':>6}  lost   1s   2s")
    for scene in words.scene:
        for sensor in SENSORS if words.sensors == "all" else words.sensors.split(","):
            for seed in words.seeds.split(","):
                measure(scene, sensor, seed)


def measure(scene: str, sensor: str, seed: str) -> None:
    """Track the object of one scene and print its line."""
    source: Any = open_source(f"sim:{scene}{'&' if '?' in scene else '?'}sensor={sensor}&seed={seed}")
    preset = measured_rig(load_preset("simulator"), source)
    mesh, pipeline = simulated_mesh(source.scene, source.name), ContactPipeline(preset, source.rig)
    tracker = PoseTracker(mesh, preset, source.rig)
    rows, lost, sizes = list[tuple[float, float, float]](), 0, list[float]()
    for frame in source:
        patch, true = pipeline.process(frame), np.array(frame.truth.T_proximity_object)
        if not tracker.started:
            tracker.start(true)
        begun = time.process_time()
        found = tracker.track(patch, frame.proximity_time_s)
        ms = 1e3 * (time.process_time() - begun)
        lost += found.lost
        if not found.lost:
            rows.append((*errors(found, true, mesh), ms))
            sizes += in_sigmas(found, true, mesh)
    mm, degrees = np.sqrt(np.mean(np.square([row[:2] for row in rows]), axis=0))
    within = [np.mean(np.array(sizes) < times) for times in (1, 2)]
    print(
        f"{scene:16s}{sensor:12s}{mm:7.2f} {degrees:7.2f} {np.median([row[2] for row in rows]):6.1f}"
        f"{lost:6d} {within[0]:4.2f} {within[1]:4.2f}",
        flush=True,
    )


def errors(estimate: PoseEstimate, true: Array, mesh: ObjectMesh) -> tuple[float, float]:
    """Return the errors of position and rotation, mm and degrees."""
    error = pose_error(estimate, true, mesh)
    return 1e3 * error.position_m, float(np.degrees(error.angle_rad))


def in_sigmas(estimate: PoseEstimate, true: Array, mesh: ObjectMesh) -> list[float]:
    """Return the errors along the determined axes of the covariance, in standard deviations."""
    turn = estimate.T_proximity_object[:3, :3] @ true[:3, :3].T
    angle = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
    error = np.concatenate([estimate.T_proximity_object[:3, 3] - true[:3, 3], mesh.radius_m * angle])
    lengths = np.diag([1.0] * 3 + [mesh.radius_m] * 3)
    values, vectors = np.linalg.eigh(lengths @ estimate.covariance @ lengths)
    sizes: list[float] = np.abs(vectors.T @ error / np.sqrt(values))[: 6 - estimate.free].tolist()
    return sizes


if __name__ == "__main__":
    main()
