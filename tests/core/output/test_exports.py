"""Calibrations, recordings and clouds as files of other tools, read back by parsers of these formats."""

import argparse
import csv
import io
import json
import shlex
from xml.etree import ElementTree

import h5py
import numpy as np
import pytest
from ruamel.yaml import YAML
from scipy.spatial.transform import Rotation
from trimesh.exchange.ply import load_ply

from folder_scenes import RIG, list_source, make_frame
from tactune.core.contact.pipeline import ContactPatch
from tactune.core.errors import ExportError, TactuneError
from tactune.core.model.frames import ColorCamera, DepthCamera, Rig, SensorFrame, Shot
from tactune.core.model.intrinsics import Distortion, Intrinsics
from tactune.core.model.patch import AlignedDepth, Provenance
from tactune.core.model.rig_file import parse_rig
from tactune.core.output.calibration_files import export_calibration
from tactune.core.output.cloud_files import SUFFIXES, patch_columns, write_cloud
from tactune.core.output.hdf5 import export_hdf5
from tactune.core.preset import Preset
from tactune.core.sources.lens_files import choose_lens, pose_between, read_lenses

TACTILE, COLOR = "tactile_depth_optical_frame", "proximity_color_optical_frame"


def turned(*degrees):
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("zyx", degrees, degrees=True).as_matrix()
    pose[:3, 3] = 0.04, -0.01, 1e-5
    return pose.tolist()


def rig_with(pose, k3=0.0, distortion=Distortion.BROWN_CONRADY):
    coefficients = (0.1, -0.05, 0.001, 1e-5, k3)
    lens = RIG.tactile.intrinsics.model_copy(update={"coefficients": coefficients, "distortion": distortion, "fy": 9.5})
    tactile = RIG.tactile.model_copy(update={"intrinsics": lens})
    return Rig.model_validate(RIG.model_dump() | {"tactile": tactile.model_dump(), "T_proximity_tactile": pose})


def urdf_poses(path):
    """URDF: rpy are turns about the fixed axes x, y, z, in this order."""
    poses = {}
    for joint in ElementTree.parse(path).getroot().iter("joint"):
        assert joint.attrib["type"] == "fixed"
        assert joint.find("parent").attrib["link"] == "proximity_depth_optical_frame"
        origin = joint.find("origin").attrib
        roll, pitch, yaw = map(float, origin["rpy"].split())
        pose = np.eye(4)
        for axis, angle in zip("xyz", (roll, pitch, yaw), strict=True):
            pose[:3, :3] = Rotation.from_euler(axis, angle).as_matrix() @ pose[:3, :3]
        pose[:3, 3] = list(map(float, origin["xyz"].split()))
        poses[joint.find("child").attrib["link"]] = pose
    return poses


def launch_poses(path):
    """The arguments of tf2_ros's static_transform_publisher."""
    parser = argparse.ArgumentParser()
    for name in ("x", "y", "z", "qx", "qy", "qz", "qw"):
        parser.add_argument(f"--{name}", type=float, required=True)
    parser.add_argument("--frame-id", required=True)
    parser.add_argument("--child-frame-id", required=True)
    poses = {}
    for entry in YAML(typ="safe").load(path)["launch"]:
        assert (entry["node"]["pkg"], entry["node"]["exec"]) == ("tf2_ros", "static_transform_publisher")
        args = parser.parse_args(shlex.split(entry["node"]["args"]))
        assert args.frame_id == "proximity_depth_optical_frame"
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_quat([args.qx, args.qy, args.qz, args.qw]).as_matrix()
        pose[:3, 3] = args.x, args.y, args.z
        poses[args.child_frame_id] = pose
    return poses


def kalibr_poses(path):
    """Our own reader, and the file as plain YAML: T_cn_cnm1 takes points of the camera before to this one."""
    lenses = read_lenses(path)
    for camera in YAML(typ="safe").load(path).values():
        numbers = camera["intrinsics"] + camera["distortion_coeffs"]
        assert all(isinstance(number, float) for number in numbers)
    chosen = [choose_lens(lenses, role, (1, 1)) for role in ("proximity", "tactile", "colour")]
    assert [lens.size for lens in chosen] == [(7, 5), (6, 4), (9, 8)]
    assert chosen[1].lens((6, 4)).intrinsics.coefficients == pytest.approx((0.1, -0.05, 0.001, 1e-5, 0))
    poses = [pose_between(chosen[0], other, lenses) for other in chosen[1:]]
    return dict(zip((TACTILE, COLOR), map(np.array, poses), strict=True))


READERS = {"urdf": urdf_poses, "ros": launch_poses, "kalibr": kalibr_poses}


@pytest.mark.parametrize("angles", [(0, 0, 0), (10, -20, 30), (0, 90, 0), (170, 0, -179)])
@pytest.mark.parametrize("kind", READERS)
def test_other_tools_read_the_poses(tmp_path, kind, angles):
    rig = rig_with(turned(*angles))
    path = tmp_path / "rig.yaml"
    export_calibration(path, kind, rig)
    poses = READERS[kind](path)
    np.testing.assert_allclose(poses[TACTILE], rig.T_proximity_tactile, atol=1e-9)
    color = np.linalg.inv(np.array(rig.proximity_color.T_color_depth))
    np.testing.assert_allclose(poses[COLOR], color, atol=1e-9)


def test_the_pose_of_a_preset_replaces_that_of_the_rig(tmp_path):
    preset = Preset().with_value("alignment.rigid.T_proximity_tactile", turned(5, 6, 7))
    export_calibration(tmp_path / "a.urdf", "urdf", rig_with(turned(0, 0, 0)), preset)
    np.testing.assert_allclose(urdf_poses(tmp_path / "a.urdf")[TACTILE], turned(5, 6, 7), atol=1e-9)


REFUSED = {
    "no pose": (rig_with(None), Preset(), "urdf", "pose of the tactile camera is not known"),
    "homography": (RIG, Preset().with_value("alignment.model", "homography"), "ros", "homography"),
    "k3": (rig_with(turned(0, 0, 0), k3=0.1), None, "kalibr", "k3 = 0.1"),
    "lens": (rig_with(turned(0, 0, 0), distortion=Distortion.INVERSE_BROWN_CONRADY), None, "kalibr", "inverse_brown"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_a_format_cannot_hold_is_refused_and_nothing_is_written(tmp_path, case):
    rig, preset, kind, sentence = REFUSED[case]
    with pytest.raises(TactuneError, match=sentence):
        export_calibration(tmp_path / "a", kind, rig, preset)
    assert not list(tmp_path.iterdir())


def test_h5py_reads_every_image_time_and_unit(tmp_path):
    frames = [make_frame(0), make_frame(1, tactile_color=None, truth=None), make_frame(2)]
    untouched = make_frame(9)
    told = []
    source = list_source(frames, untouched=untouched)
    assert export_hdf5(source, tmp_path / "a.h5", progress=lambda share, _: told.append(share)) == 3
    assert told[-1] == 1.0
    with h5py.File(tmp_path / "a.h5") as file:
        for index, frame in enumerate(frames):
            for role in ("proximity", "tactile"):
                np.testing.assert_array_equal(file[role]["depth"][index], getattr(frame, f"{role}_depth"))
                assert file[role]["time_s"][index] == getattr(frame, f"{role}_time_s")
            np.testing.assert_array_equal(file["proximity/color"][index], frame.proximity_color)
            assert file["sequence"][index] == frame.sequence
        np.testing.assert_array_equal(file["tactile/color"][2], frames[2].tactile_color)
        np.testing.assert_array_equal(file["truth/contact"][0], frames[0].truth.contact)
        np.testing.assert_array_equal(file["truth/depth_m"][2], frames[2].truth.depth_m)
        assert not file["tactile/color"][1].any() and np.isnan(file["truth/depth_m"][1]).all()
        np.testing.assert_array_equal(file["untouched/tactile/depth"][0], untouched.tactile_depth)
        assert file["tactile/depth"].attrs["unit_m"] == RIG.tactile.depth_unit_m
        np.testing.assert_array_equal(file["proximity/depth"].attrs["K"], RIG.proximity.intrinsics.camera_matrix())
        assert parse_rig(json.loads(file.attrs["rig"]), "rig") == RIG


def test_one_camera_alone_is_the_tactile_one(tmp_path):
    rig = Rig.of_one_camera(RIG.proximity)
    frame = SensorFrame.of_shots(rig, 0, None, Shot(make_frame(0).proximity_depth, None, 0.0))
    export_hdf5(list_source([frame], rig), tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5") as file:
        assert "proximity" not in file
        np.testing.assert_array_equal(file["tactile/depth"][0], frame.tactile_depth)
    export_calibration(tmp_path / "a.yaml", "kalibr", rig)
    assert [lens.name for lens in read_lenses(tmp_path / "a.yaml")] == ["cam0 /tactile/depth/image"]
    export_calibration(tmp_path / "a.urdf", "urdf", rig)
    assert not urdf_poses(tmp_path / "a.urdf")
    with pytest.raises(TactuneError, match="one camera"):
        export_calibration(tmp_path / "b", "ros", rig)


def make_columns(count=7):
    rng = np.random.default_rng(count)
    columns = dict(zip("xyz", rng.normal(size=(3, count)).astype(np.float32), strict=True))
    columns |= {name: rng.integers(0, 256, count).astype(np.uint8) for name in ("red", "green", "blue")}
    columns |= {"relative_difference": np.full(count, np.nan, np.float32), "u": np.arange(count).astype(np.uint16)}
    return columns


def points_in(path):
    """Read points by other programs' means."""
    if path.suffix.lower() == ".ply":
        return np.asarray(load_ply(io.BytesIO(path.read_bytes())).get("vertices", np.empty((0, 3))))
    if path.suffix.lower() == ".npz":
        return np.load(path)["points"]
    return np.array([row.split(",")[:3] for row in path.read_text().split()[1:]], np.float64).reshape(-1, 3)


@pytest.mark.parametrize("suffix", [*SUFFIXES, ".PLY", ".NPZ"])
def test_points_come_back_bit_for_bit_and_none_are_an_empty_cloud(tmp_path, suffix):
    for count in (7, 0):
        columns = make_columns(count)
        write_cloud(tmp_path / f"cloud{suffix}", columns)
        expected = np.column_stack([columns[axis] for axis in "xyz"])
        assert points_in(tmp_path / f"cloud{suffix}").astype(np.float32).tobytes() == expected.tobytes()
    assert [path.name for path in tmp_path.iterdir()] == [f"cloud{suffix}"]


def test_a_csv_file_has_titles_with_units(tmp_path):
    values = {"x": 0.1, "y": 0.2, "z": 0.3, "red": 1, "green": 2, "blue": 3, "relative_difference": 0.5, "u": 7}
    columns = {name: np.array([value], make_columns()[name].dtype) for name, value in values.items()}
    write_cloud(tmp_path / "cloud.csv", columns)
    with (tmp_path / "cloud.csv").open(newline="") as file:
        titles, row = csv.reader(file)
    assert titles == ["x_m", "y_m", "z_m", "red", "green", "blue", "relative_difference", "u"]
    assert row == ["0.100000001", "0.200000003", "0.300000012", "1", "2", "3", "0.5", "7"]


def test_open3d_reads_the_ply(tmp_path):
    o3d = pytest.importorskip("open3d", reason="open3d is not installed", exc_type=ImportError)
    columns = make_columns()
    write_cloud(tmp_path / "cloud.ply", columns)
    theirs = o3d.t.io.read_point_cloud(str(tmp_path / "cloud.ply")).point
    for name, parts in (("positions", "xyz"), ("colors", ("red", "green", "blue"))):
        np.testing.assert_array_equal(theirs[name].numpy(), np.column_stack([columns[part] for part in parts]))
    for name in ("relative_difference", "u"):
        np.testing.assert_array_equal(theirs[name].numpy()[:, 0], columns[name], err_msg=name)
        assert theirs[name].numpy().dtype == columns[name].dtype


@pytest.mark.parametrize("suffix", [".xyz", ""])
def test_an_unknown_suffix_is_refused_and_leaves_no_file(tmp_path, suffix):
    with pytest.raises(ExportError, match="suffix"):
        write_cloud(tmp_path / f"cloud{suffix}", make_columns())
    assert list(tmp_path.iterdir()) == []


LENS = Intrinsics(width=4, height=3, fx=2.0, fy=2.0, cx=1.5, cy=1.0)
COLOR_LENS = Intrinsics(width=8, height=6, fx=4.0, fy=4.0, cx=3.0, cy=2.0)
SHIFT = ((1.0, 0.0, 0.0, 0.25), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))


@pytest.mark.parametrize("own_color_camera", [False, True])
def test_a_patch_carries_colour_difference_and_pixels(own_color_camera):
    camera = DepthCamera(intrinsics=LENS, depth_unit_m=0.001)
    color_camera = ColorCamera(intrinsics=COLOR_LENS, T_color_depth=SHIFT) if own_color_camera else None
    rig = Rig(proximity=camera, tactile=camera, proximity_color=color_camera)
    rng = np.random.default_rng(0)
    image = rng.integers(1, 256, (*rig.proximity_color_shape, 3)).astype(np.uint8)
    depth = np.full((3, 4), 500, np.uint16)
    frame = SensorFrame(0, depth, depth, image)

    pixels = [(3, 0), (0, 1), (2, 2)]
    provenance = np.full((3, 4), Provenance.OUTSIDE_TOLERANCE, np.uint8)
    for u, v in pixels:
        provenance[v, u] = Provenance.CONTACT
    expected = np.full((3, 4), 0.5, np.float32)
    measured = np.linspace(0.4, 0.6, 12, dtype=np.float32).reshape(3, 4)
    points = np.float32([[(u - 1.5) / 2.0 * 0.5, (v - 1.0) / 2.0 * 0.5, 0.5] for u, v in pixels])
    patch = ContactPatch(0, points, provenance, AlignedDepth(expected, measured), rig, {})

    columns = patch_columns(patch, frame, rig)
    np.testing.assert_array_equal(np.column_stack([columns[axis] for axis in "xyz"]), points)
    assert list(zip(columns["u"], columns["v"], strict=True)) == pixels
    differences = [(0.5 - measured[v, u]) / 0.5 for u, v in pixels]
    np.testing.assert_allclose(columns["relative_difference"], differences, rtol=1e-5)
    colors = np.column_stack([columns[name] for name in ("red", "green", "blue")])
    for (u, v), (x, y, z), color in zip(pixels, points, colors, strict=True):
        if own_color_camera:
            u, v = round((x + 0.25) / z * 4.0 + 3.0), round(y / z * 4.0 + 2.0)  # noqa: PLW2901  # the other camera
            inside = 0 <= u < 8 and 0 <= v < 6
        else:
            inside = True
        assert color.tolist() == (image[v, u].tolist() if inside else [0, 0, 0])
