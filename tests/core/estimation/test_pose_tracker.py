"""The pose of a known object, from patches of shapes whose free directions are known; meshes from files."""

import sys

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from rigs import rig_noise
from tactune.core import ContactPipeline, load_preset
from tactune.core.errors import CalibrationError, MissingExtraError, SourceError
from tactune.core.estimation.object_mesh import ObjectMesh, load_mesh, simulated_mesh
from tactune.core.estimation.pose import PoseTracker, pose_error
from tactune.core.model.clouds import ray_table
from tactune.core.model.patch import AlignedDepth, ContactPatch
from tactune.core.sources.simulator.scene import simulator_rig
from tactune.core.sources.simulator.simulator_source import SimulatorSource

RIG = simulator_rig()
PRESET = load_preset("simulator")
WHITE_M = 0.004
#: How many directions a patch of each shape leaves free, and in which it may slide.
FREE = {"cylinder": (2, (0, 1, 0)), "cube": (3, (1, 0, 0)), "sphere": (3, (0, 0, 0)), "wedge": (1, (0, 1, 0))}


def pose_of(turns_deg=(0.0, 0.0, 0.0), place_m=(0.0, 0.0, 0.33)):
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_euler("xyz", turns_deg, degrees=True).as_matrix(), place_m
    return pose


def mesh_of(shape):
    made = {
        "cylinder": lambda: trimesh.creation.cylinder(0.03, 0.12, sections=180),
        "cube": lambda: trimesh.creation.box((0.06, 0.06, 0.06)),
        "sphere": lambda: trimesh.creation.icosphere(5, 0.035),
        "wedge": lambda: trimesh.creation.box((0.06, 0.2, 0.06)),
        "egg": lambda: trimesh.creation.icosphere(5, 0.02).apply_scale((2.2, 1.4, 1.0)),
        "bolt": lambda: trimesh.util.concatenate(
            [trimesh.creation.icosphere(4, 0.02), trimesh.creation.box((0.07, 0.03, 0.01))]
        ),
    }[shape]()
    return ObjectMesh(np.array(made.vertices), np.array(made.faces, np.int32), shape)


def pressed(mesh, pose, deep_m=0.006, half_m=0.02, noise_m=0.0, sequence=0, seed=0):
    """Return the patch of what of a mesh is nearest to the camera, at most ``half_m`` from the centre of the patch."""
    rays = ray_table(RIG.proximity.intrinsics).reshape(-1, 2)
    rays = np.column_stack([rays, np.ones(len(rays))])
    depth, hit = mesh.hits(-pose[:3, 3] @ pose[:3, :3], rays @ pose[:3, :3])
    points = rays[hit] * depth[hit, None]
    near = (points[:, 2] < points[:, 2].min() + deep_m) & (np.abs(points - pose[:3, 3])[:, :2] < half_m).all(axis=1)
    points = points[near] * (1 + np.random.default_rng(seed).normal(0, noise_m, (near.sum(), 1)) / points[near, 2:])
    nowhere = AlignedDepth(*(np.full(RIG.proximity.intrinsics.shape, np.nan, np.float32) for _ in range(2)))
    return ContactPatch(sequence, points.astype(np.float32), np.zeros((480, 640), np.uint8), nowhere, RIG, {})


@pytest.mark.parametrize("shape", FREE)
def test_directions_that_a_shape_leaves_free_are_found_and_held(shape):
    mesh = mesh_of(shape)
    true = pose_of({"cylinder": (90, 0, 0), "wedge": (0, 45, 0)}.get(shape, (0, 0, 0)))
    tracker = PoseTracker(mesh, PRESET, RIG)
    start = true @ pose_of((0, 0, 0), (0.001, 0.0012, -0.001))
    tracker.start(start)
    found = tracker.track(pressed(mesh, true, deep_m=0.015, noise_m=0.0005), 0.0)
    free, axis = FREE[shape]
    assert found.free == free
    assert not found.lost
    turned = true @ pose_of((0, 0, 30), (0, 0, 0)) if shape == "cylinder" else true
    assert pose_error(found, turned, mesh).position_m < 5e-4, "the determined directions are solved"
    slid = axis @ (found.T_proximity_object[:3, 3] - start[:3, 3])
    assert abs(slid) < 2e-4, "a free slide stays where it was predicted"
    sigmas = np.sqrt(np.linalg.eigvalsh(found.covariance))
    assert sigmas[-1] > 0.02, "what is free is not certain"


def test_covariance_covers_the_errors_of_noise():
    mesh, true = mesh_of("egg"), pose_of((20, 15, 40))
    preset, sizes = PRESET.with_value("noise", rig_noise(WHITE_M).model_dump()), []
    for seed in range(16):
        tracker = PoseTracker(mesh, preset, RIG)
        tracker.start(true)
        found = tracker.track(pressed(mesh, true, 0.02, 0.05, WHITE_M, seed=seed), 0.0)
        assert not found.free
        pose = found.T_proximity_object
        turn = Rotation.from_matrix(pose[:3, :3] @ true[:3, :3].T).as_rotvec()
        values, vectors = np.linalg.eigh(found.covariance)
        sizes.append(np.abs(vectors.T @ np.concatenate([pose[:3, 3] - true[:3, 3], turn])) / np.sqrt(values))
    assert 0.55 < np.mean(np.array(sizes) < 1) < 0.85
    assert np.mean(np.array(sizes) < 2) > 0.9


def test_press_is_tracked_from_a_search_and_lost_without_contact():
    source = SimulatorSource("cup")
    pipeline, mesh = ContactPipeline(PRESET, source.rig), simulated_mesh(source.scene, source.name)
    tracker, errors = PoseTracker(mesh, PRESET, source.rig), []
    for number in [*range(36, 60, 8), *range(60, source.length, 5), source.length - 1]:
        frame = source.read(number)
        patch = pipeline.process(frame)
        found = tracker.track(patch, frame.proximity_time_s)
        touches = np.count_nonzero(frame.truth.contact) > 2500
        assert touches <= (not found.lost), f"frame {frame.sequence}"
        assert found.lost or len(patch.points), "no pose without a patch"
        if touches:
            error = pose_error(found, frame.truth.T_proximity_object, mesh)
            errors.append((1e3 * error.position_m, np.degrees(error.angle_rad)))
    assert found.lost, "the last frame has no contact"
    assert np.sqrt(np.mean(np.square(errors), axis=0)).max() < 1.5


def test_object_that_jumps_is_found_again_and_never_silently_wrong():
    mesh = mesh_of("bolt")
    tracker = PoseTracker(mesh, PRESET, RIG)
    poses = [pose_of((20, 15, 40))] * 3 + [pose_of((-15, 5, -70), (0.03, -0.02, 0.31))] * 3
    tracker.start(poses[0])
    for n, pose in enumerate(poses):
        found = tracker.track(pressed(mesh, pose, 0.03, 0.05, 0.0003, seed=n), n / 30)
        error = pose_error(found, pose, mesh)
        assert found.lost or (error.position_m < 2e-3 and error.angle_rad < np.radians(2))
    assert not found.lost


def test_wrong_mesh_and_small_patch_and_bad_pose_are_refused():
    bolt, true = mesh_of("bolt"), pose_of((20, 15, 40))
    patch = pressed(bolt, true, 0.03, 0.05)
    with pytest.raises(CalibrationError, match="sphere"):
        PoseTracker(mesh_of("sphere"), PRESET, RIG).find(patch)
    tracker = PoseTracker(bolt, PRESET, RIG)
    with pytest.raises(CalibrationError, match="too small"):
        tracker.find(pressed(bolt, true, 0.03, 0.003))
    with pytest.raises(CalibrationError):
        tracker.start(np.diag([2.0, 1, 1, 1]))
    assert not tracker.started
    assert PoseTracker(mesh_of("sphere"), PRESET, RIG).track(patch, 0.0).lost


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".stl"])
@pytest.mark.parametrize(("scale", "unit"), [(1.0, "m"), (1000.0, "mm")])
def test_unit_is_told_by_the_size(tmp_path, suffix, scale, unit):
    cup = trimesh.creation.cylinder(0.04 * scale, 0.095 * scale)
    cup.export(tmp_path / f"cup{suffix}")
    mesh = load_mesh(tmp_path / f"cup{suffix}")
    assert mesh.unit == unit
    assert mesh.size_m == pytest.approx([0.08, 0.08, 0.095], rel=0.01)
    assert len(mesh.vertices_m) == len(cup.vertices), "corners that triangles of an STL repeat are merged"
    assert f"read in {unit}: 80 x 80 x 95 mm" in mesh.assumed
    assert load_mesh(tmp_path / f"cup{suffix}", unit).size_m == pytest.approx(mesh.size_m)


def test_mesh_inside_out_is_turned(tmp_path):
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    box.invert()
    box.export(tmp_path / "box.ply")
    mesh = load_mesh(tmp_path / "box.ply")
    places, normals = mesh.closest(np.array([[0.0, 0.0, 0.1]]))
    assert normals[0] == pytest.approx([0, 0, 1], abs=1e-6)
    assert places[0] == pytest.approx([0, 0, 0.05], abs=1e-6)


def test_unusable_files_are_refused_in_one_sentence(tmp_path):
    trimesh.creation.box((3, 3, 3)).export(tmp_path / "nothing.stl")
    trimesh.PointCloud(np.eye(3)).export(tmp_path / "points.ply")
    (tmp_path / "text.obj").write_text("this is no mesh\n")
    (tmp_path / "torn.stl").write_bytes(b"solid \x00\x01" * 5)
    (tmp_path / "mesh.step").write_text("ISO-10303-21;")
    for name in ("nothing.stl", "points.ply", "text.obj", "torn.stl", "mesh.step", "absent.ply"):
        with pytest.raises(SourceError, match=name) as refused:
            load_mesh(tmp_path / name)
        assert "\n" not in str(refused.value)
    with pytest.raises(SourceError, match="no unit 'yd'"):
        load_mesh(tmp_path / "nothing.stl", "yd")


def test_without_open3d_the_extra_is_named(tmp_path, monkeypatch):
    trimesh.creation.box((0.1, 0.1, 0.1)).export(tmp_path / "box.ply")
    mesh = load_mesh(tmp_path / "box.ply")
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(MissingExtraError, match=r"tactune\[open3d\]"):
        PoseTracker(mesh, load_preset("simulator"), simulator_rig())
