"""Compare the pose tracker with plain ICP on simulated objects that move across the membrane.

    python scripts/measure_track.py [--sensors l515-d405,worn | --sensors all] [--seeds 0] [--noise measured] [SCENE...]

All methods start at the true pose and go from frame to frame. *tracker* is `PoseTracker` on the fused patch. The others
are Open3D's point-to-plane ICP from the last pose to the whole mesh: on the proximity cloud alone, on the tactile cloud
alone (both cut to the mesh's box about the last pose, plus 10 mm), and on the fused patch.

mm and degrees: root mean square errors over the frames in the directions that the tracker says are determined. off:
frames with errors above 10 mm or 10 degrees in these directions. lost: frames that the tracker says are lost. ms:
processor time per frame without the patch, median. 1s and 2s: share of errors within one and two standard deviations,
along the axes of the covariance that are determined. For scenes with a lifted handle the last lines say after how many
frames the free direction is named, and after how many the full pose is back within 1.5 mm and 1.5 degrees.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import open3d

from tactune.core.contact.alignment import tactile_pose
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.estimation.object_mesh import ObjectMesh, simulated_mesh
from tactune.core.estimation.pose import PoseEstimate, PoseTracker, pose_error
from tactune.core.lab.table import measured_rig
from tactune.core.model.clouds import deproject_image
from tactune.core.preset import Preset
from tactune.core.sources.presets import load_preset
from tactune.core.sources.registry import open_source
from tactune.core.sources.simulator.sensors import SENSORS

Array = npt.NDArray[np.float64]

_SCENES = ("cup?move=slide", "cup?move=lift")
_MARGIN_M, _VOXEL_M, _REACH_M = 0.010, 0.003, 0.010
_OFF_MM, _OFF_DEG = 10.0, 10.0
_LIMIT_MM, _LIMIT_DEG = 1.5, 1.5


@dataclass
class Row:
    """Errors of one method in one scene: mm and degrees, and milliseconds, per frame."""

    errors: list[tuple[float, float]] = field(default_factory=list)
    ms: list[float] = field(default_factory=list)

    def words(self) -> str:
        """Return the columns of the table."""
        if not self.errors:
            return f"{'never found':>23}"
        errors = np.array(self.errors)
        rms = np.sqrt((errors**2).mean(axis=0))
        off = int(((errors[:, 0] > _OFF_MM) | (errors[:, 1] > _OFF_DEG)).sum())
        return f"{rms[0]:7.2f} {rms[1]:7.2f} {off:4d} {np.median(self.ms):6.1f}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Compare the pose tracker with plain ICP.")
    parser.add_argument("--sensors", default="l515-d405", help="names of sensors, separated by commas, or all")
    parser.add_argument("--seeds", default="0", help="seeds of the cameras' noise, separated by commas")
    parser.add_argument("--noise", choices=("measured", "none"), default="measured", help="what is known of the rig")
    parser.add_argument("--alone", action="store_true", help="the tracker without the other methods")
    parser.add_argument("scene", nargs="*", default=_SCENES, help="sim: without its prefix; the cup's moves by default")
    words = parser.parse_args()
    print(f"{'scene':16s}{'sensor':12s}{'method':12s}{'mm':>7} {'degrees':>7} {'off':>4} {'ms':>6}  lost   1s   2s")
    for scene in words.scene:
        for sensor in SENSORS if words.sensors == "all" else words.sensors.split(","):
            for seed in words.seeds.split(","):
                measure(scene, sensor, seed, words.noise, alone=words.alone)


def measure(scene: str, sensor: str, seed: str, noise: str, *, alone: bool) -> None:
    """Run all methods over one scene and print their lines."""
    source: Any = open_source(f"sim:{scene}{'&' if '?' in scene else '?'}sensor={sensor}&seed={seed}")
    preset = load_preset("simulator")
    if noise == "measured":
        preset = measured_rig(preset, source)
    mesh, pipeline = simulated_mesh(source.scene, source.name), ContactPipeline(preset, source.rig)
    tracker, estimates, truths = PoseTracker(mesh, preset, source.rig), [], []
    others = {} if alone else _others(mesh, preset, source.rig)
    rows = {name: Row() for name in ("tracker", *others)}
    poses: dict[str, Array] = {}
    for frame in source:
        patch, true = pipeline.process(frame), np.array(frame.truth.T_proximity_object)
        if not truths:
            tracker.start(true)
            poses = dict.fromkeys(others, true)
        truths.append(true)
        begun = time.process_time()
        estimate = tracker.track(patch, frame.proximity_time_s)
        rows["tracker"].ms.append(1e3 * (time.process_time() - begun))
        estimates.append(estimate)
        if not estimate.lost:
            rows["tracker"].errors.append(_error(estimate, true, mesh))
        for name, method in others.items():
            begun = time.process_time()
            poses[name] = method(frame, patch, poses[name])
            rows[name].ms.append(1e3 * (time.process_time() - begun))
            rows[name].errors.append(_error(_as_estimate(poses[name], estimate), true, mesh))
    within, lost = _coverage(estimates, truths, mesh), sum(estimate.lost for estimate in estimates)
    for name, row in rows.items():
        more = f"{lost:6d} {within[0]:4.2f} {within[1]:4.2f}" if name == "tracker" else ""
        print(f"{scene:16s}{sensor:12s}{name:12s}{row.words()}{more}", flush=True)
    if "lift" in scene:
        print(_lifted(source, estimates, truths, mesh), flush=True)


Method = Callable[[Any, Any, Array], Array]


def _others(mesh: ObjectMesh, preset: Preset, rig: Any) -> dict[str, Method]:
    surface = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(mesh.vertices_m), open3d.utility.Vector3iVector(mesh.triangles)
    )
    surface.compute_vertex_normals()
    open3d.utility.random.seed(0)
    model = surface.sample_points_uniformly(20_000, use_triangle_normal=True)
    to_proximity = tactile_pose(preset.alignment, rig)
    low, high = mesh.vertices_m.min(axis=0) - _MARGIN_M, mesh.vertices_m.max(axis=0) + _MARGIN_M

    def plain(points: Array, pose: Array) -> Array:
        if len(points) < 100:
            return pose
        cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points)).voxel_down_sample(_VOXEL_M)
        found = open3d.pipelines.registration.registration_icp(
            cloud, model, _REACH_M, np.linalg.inv(pose),
            open3d.pipelines.registration.TransformationEstimationPointToPlane(),
        )  # fmt: skip
        return np.linalg.inv(found.transformation)

    def cut(points: Array, pose: Array) -> Array:
        own = (points - pose[:3, 3]) @ pose[:3, :3]
        return points[((own > low) & (own < high)).all(axis=1)]

    def image(depth: Any, camera: Any) -> Array:
        points = deproject_image(depth, camera).reshape(-1, 3)
        return points[np.isfinite(points).all(axis=1)].astype(np.float64)

    def proximity(frame: Any, patch: Any, pose: Array) -> Array:
        return plain(cut(image(frame.proximity_depth, rig.proximity), pose), pose)

    def tactile(frame: Any, patch: Any, pose: Array) -> Array:
        points = image(frame.tactile_depth, rig.tactile) @ to_proximity[:3, :3].T + to_proximity[:3, 3]
        return plain(cut(points, pose), pose)

    methods: dict[str, Method] = {
        "proximity": proximity,
        "tactile": tactile,
        "patch": lambda frame, patch, pose: plain(patch.points.astype(np.float64), pose),
    }
    return methods


def _as_estimate(pose: Array, tracked: PoseEstimate) -> PoseEstimate:
    """Return another method's pose with the free directions that the tracker found."""
    free = () if tracked.lost else tracked.free
    return PoseEstimate(tracked.sequence, tracked.time_s, pose, tracked.covariance, free, 0.0, 1.0, False)


def _error(estimate: PoseEstimate, true: Array, mesh: ObjectMesh) -> tuple[float, float]:
    error = pose_error(estimate, true, mesh)
    return 1e3 * error.position_m, float(np.degrees(error.angle_rad))


def _coverage(estimates: list[PoseEstimate], truths: list[Array], mesh: ObjectMesh) -> tuple[float, float]:
    """Return the shares of errors within one and two standard deviations."""
    sizes = []
    for estimate, true in zip(estimates, truths, strict=True):
        if estimate.lost:
            continue
        turn = estimate.T_proximity_object[:3, :3] @ true[:3, :3].T
        angle = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
        error = np.concatenate([estimate.T_proximity_object[:3, 3] - true[:3, 3], mesh.radius_m * angle])
        lengths = np.diag([1.0] * 3 + [mesh.radius_m] * 3)
        values, vectors = np.linalg.eigh(lengths @ estimate.covariance @ lengths)
        determined = slice(0, 6 - len(estimate.free))
        sizes += list(np.abs(vectors.T @ error / np.sqrt(values))[determined])
    return float(np.mean(np.array(sizes) < 1)), float(np.mean(np.array(sizes) < 2))


def _lifted(source: Any, estimates: list[PoseEstimate], truths: list[Array], mesh: ObjectMesh) -> str:
    """Say how fast free directions are named after the handle has gone, and the pose is back after it returned."""
    touches = [_handle_touches(source.read(n).truth, truths[n]) for n in range(len(truths))]
    words = []
    for n in range(1, len(touches)):
        if touches[n - 1] and not touches[n]:
            named = next((k for k in range(n, len(touches)) if any(d.kind == "turn" for d in estimates[k].free)), None)
            words.append(
                f"  handle gone at {n}: free direction named after {'-' if named is None else named - n} frames"
            )
        if not touches[n - 1] and touches[n]:
            full = (pose_error(estimates[k], truths[k], mesh) for k in range(n, len(touches)))
            back = next(
                (
                    k
                    for k, error in enumerate(full)
                    if 1e3 * error.full_position_m < _LIMIT_MM and np.degrees(error.full_angle_rad) < _LIMIT_DEG
                ),
                None,
            )
            words.append(f"  handle back at {n}: pose back after {'-' if back is None else back} frames")
    return "\n".join(words)


def _handle_touches(truth: Any, pose: Array) -> bool:
    """Return whether any true contact lies outside the cup's body, which has a radius of 37 mm."""
    v, u = np.nonzero(truth.contact)
    if len(v) == 0:
        return False
    from tactune.core.model.clouds import ray_table
    from tactune.core.sources.simulator.scene import simulator_rig

    depth = truth.depth_m[v, u]
    points = np.column_stack([ray_table(simulator_rig().proximity.intrinsics)[v, u] * depth[:, None], depth])
    own = (points - pose[:3, 3]) @ pose[:3, :3]
    return bool((np.hypot(own[:, 0], own[:, 2]) > 0.040).any())


if __name__ == "__main__":
    main()
