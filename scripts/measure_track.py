"""Measure the pose tracker on simulated objects that move across the membrane, beside plain ICP on the same patches.

    python scripts/measure_track.py [--sensors l515-d405,worn | --sensors all] [--seeds 0] [--alone] [SCENE...]

Both start at the true pose and go from frame to frame. *tracker* is `PoseTracker`, *icp* Open3D's point-to-plane ICP
from the last pose to the whole mesh. mm and degrees: root mean square errors over the frames in the directions that the
tracker says are determined. lost: frames that the tracker says are lost. ms: processor time per frame without the
patch, median. 1s and 2s: share of errors within one and two standard deviations, along the determined axes.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import open3d

from tactune.core import ContactPipeline, PoseTracker, load_preset, open_source
from tactune.core.estimation.object_mesh import ObjectMesh, simulated_mesh
from tactune.core.estimation.pose import PoseEstimate, pose_error
from tactune.core.lab.table import measured_rig
from tactune.core.sources.simulator.sensors import SENSORS

Array = npt.NDArray[np.float64]

_SCENES = ("cup?move=slide",)
_VOXEL_M, _REACH_M = 0.003, 0.010


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sensors", default="l515-d405", help="names of sensors, separated by commas, or all")
    parser.add_argument("--seeds", default="0", help="seeds of the cameras' noise, separated by commas")
    parser.add_argument("--alone", action="store_true", help="the tracker without plain ICP")
    parser.add_argument("scene", nargs="*", default=_SCENES, help="sim: without its prefix; the sliding cup by default")
    words = parser.parse_args()
    print(f"{'scene':16s}{'sensor':12s}{'method':10s}{'mm':>7} {'degrees':>7} {'ms':>6}  lost   1s   2s")
    for scene in words.scene:
        for sensor in SENSORS if words.sensors == "all" else words.sensors.split(","):
            for seed in words.seeds.split(","):
                measure(scene, sensor, seed, alone=words.alone)


def measure(scene: str, sensor: str, seed: str, *, alone: bool) -> None:
    """Run both methods over one scene and print their lines."""
    source: Any = open_source(f"sim:{scene}{'&' if '?' in scene else '?'}sensor={sensor}&seed={seed}")
    preset = measured_rig(load_preset("simulator"), source)
    mesh, pipeline = simulated_mesh(source.scene, source.name), ContactPipeline(preset, source.rig)
    tracker, model, pose = PoseTracker(mesh, preset, source.rig), cloud_of(mesh), np.eye(4)
    rows: dict[str, list[tuple[float, float, float]]] = {"tracker": [], "icp": []}
    lost, sizes = 0, list[float]()
    for frame in source:
        patch, true = pipeline.process(frame), np.array(frame.truth.T_proximity_object)
        if not tracker.started:
            tracker.start(true)
            pose = true
        begun = time.process_time()
        found = tracker.track(patch, frame.proximity_time_s)
        ms = 1e3 * (time.process_time() - begun)
        lost += found.lost
        if not found.lost:
            rows["tracker"].append((*errors(found, true, mesh), ms))
            sizes += in_sigmas(found, true, mesh)
        if not alone:
            begun = time.process_time()
            pose = plain_icp(patch.points.astype(np.float64), model, pose)
            ms = 1e3 * (time.process_time() - begun)
            rows["icp"].append((*errors(replace(found, T_proximity_object=pose), true, mesh), ms))
    for name, row in rows.items():
        if row:
            mm, degrees = np.sqrt(np.mean(np.square([each[:2] for each in row]), axis=0))
            within = [np.mean(np.array(sizes) < times) for times in (1, 2)]
            more = f"{lost:6d} {within[0]:4.2f} {within[1]:4.2f}" if name == "tracker" else ""
            median_ms = np.median([each[2] for each in row])
            print(f"{scene:16s}{sensor:12s}{name:10s}{mm:7.2f} {degrees:7.2f} {median_ms:6.1f}{more}", flush=True)


def cloud_of(mesh: ObjectMesh) -> Any:
    """Return points of the mesh with their normals, for Open3D."""
    places, normals = mesh.sample(20_000)
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(places))
    cloud.normals = open3d.utility.Vector3dVector(normals)
    return cloud


def plain_icp(points: Array, model: Any, pose: Array) -> Array:
    """Return the next pose by Open3D's point-to-plane ICP."""
    if len(points) < 100:
        return pose
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points)).voxel_down_sample(_VOXEL_M)
    method = open3d.pipelines.registration.TransformationEstimationPointToPlane()
    found = open3d.pipelines.registration.registration_icp(cloud, model, _REACH_M, np.linalg.inv(pose), method)
    return np.linalg.inv(found.transformation)


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
