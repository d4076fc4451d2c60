"""Cloud files: lossless round trip, readable by other programs, clear errors for bad files."""

import csv
import io

import numpy as np
import pytest
from trimesh.exchange.ply import load_ply

from tactune.core.contact.pipeline import ContactPatch
from tactune.core.errors import ExportError
from tactune.core.model.clouds import PointCloud
from tactune.core.model.frames import ColorCamera, DepthCamera, Rig, SensorFrame
from tactune.core.model.intrinsics import Intrinsics
from tactune.core.model.patch import AlignedDepth, Provenance
from tactune.core.output.cloud_files import SUFFIXES, patch_cloud, write_cloud

TYPES = (np.int8, np.uint8, np.int16, np.uint16, np.int32, np.uint32, np.float32, np.float64)


def make_cloud(count=7, colors=True):
    rng = np.random.default_rng(count)
    attributes = {np.dtype(kind).name + "_x": (rng.normal(size=count) * 99).astype(kind) for kind in TYPES[4:]}
    attributes |= {np.dtype(kind).name: rng.integers(0, 99, count).astype(kind) for kind in TYPES[:4]}
    if count > 1:
        attributes["float32_x"][1] = np.nan
    points = rng.normal(size=(count, 3)).astype(np.float32)
    return PointCloud(points, rng.integers(0, 256, (count, 3)).astype(np.uint8) if colors else None, attributes)


def points_in(path):
    """Read points by other programs' means."""
    if path.suffix.lower() == ".ply":
        return np.asarray(load_ply(io.BytesIO(path.read_bytes()))["vertices"])
    if path.suffix.lower() == ".npz":
        return np.load(path)["points"]
    return np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)[:, :3]


@pytest.mark.parametrize("suffix", [*SUFFIXES, ".PLY", ".NPZ"])
@pytest.mark.parametrize("colors", [False, True])
def test_points_come_back_bit_for_bit(tmp_path, suffix, colors):
    cloud = make_cloud(colors=colors)
    write_cloud(tmp_path / f"cloud{suffix}", cloud)
    assert points_in(tmp_path / f"cloud{suffix}").astype(np.float32).tobytes() == cloud.points.tobytes()
    assert [path.name for path in tmp_path.iterdir()] == [f"cloud{suffix}"]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_frame_without_contact_is_an_empty_cloud(tmp_path, suffix):
    write_cloud(tmp_path / f"cloud{suffix}", make_cloud(0))
    content = (tmp_path / f"cloud{suffix}").read_bytes()
    assert {".ply": b"element vertex 0\n", ".npz": b"points.npy", ".csv": b"x_m,y_m,z_m"}[suffix] in content


def test_a_csv_file_has_titles_with_units(tmp_path):
    cloud = PointCloud(
        np.float32([[0.1, 0.2, 0.3]]),
        np.uint8([[1, 2, 3]]),
        {"relative_difference": np.float32([0.5]), "u": np.uint16([7]), "touched": np.array([True])},
    )
    write_cloud(tmp_path / "cloud.csv", cloud)
    with (tmp_path / "cloud.csv").open(newline="") as file:
        titles, row = csv.reader(file)
    assert titles == ["x_m", "y_m", "z_m", "red", "green", "blue", "relative_difference", "u", "touched"]
    assert row == ["0.100000001", "0.200000003", "0.300000012", "1", "2", "3", "0.5", "7", "1"]


def test_open3d_reads_the_ply(tmp_path):
    o3d = pytest.importorskip("open3d", reason="open3d is not installed", exc_type=ImportError)
    cloud = make_cloud()
    kept = {"float32_x", "float64_x", "int32_x", "uint16", "uint8"}
    cloud = PointCloud(cloud.points, cloud.colors, {name: cloud.attributes[name] for name in kept})
    write_cloud(tmp_path / "cloud.ply", cloud)
    theirs = o3d.t.io.read_point_cloud(str(tmp_path / "cloud.ply")).point
    assert theirs["positions"].numpy().tobytes() == cloud.points.tobytes()
    np.testing.assert_array_equal(theirs["colors"].numpy(), cloud.colors)
    for name, values in cloud.attributes.items():
        np.testing.assert_array_equal(theirs[name].numpy()[:, 0], values, err_msg=name)
        assert theirs[name].numpy().dtype == values.dtype


@pytest.mark.parametrize(
    ("suffix", "attributes", "word"),
    [
        (".xyz", {}, "suffix"),
        ("", {}, "suffix"),
        (".ply", {"count": np.zeros(7, np.int64)}, "int64"),
        (".npz", {"u": np.zeros(6)}, "there are 7 points"),
        (".npz", {"points": np.zeros(7)}, "'points'"),
        (".npz", {"file": np.zeros(7)}, "'file'"),
        (".ply", {"red": np.zeros(7)}, "'red'"),
        (".ply", {"two words": np.zeros(7)}, "'two words'"),
        (".csv", {"a,b": np.zeros(7)}, "'a,b'"),
    ],
)
def test_what_cannot_be_written_is_refused_and_leaves_no_file(tmp_path, suffix, attributes, word):
    cloud = PointCloud(make_cloud().points, None, attributes)
    with pytest.raises(ExportError, match=word):
        write_cloud(tmp_path / f"cloud{suffix}", cloud)
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

    cloud = patch_cloud(patch, frame, rig)
    assert cloud.points is points
    assert list(zip(cloud.attributes["u"], cloud.attributes["v"], strict=True)) == pixels
    np.testing.assert_allclose(
        cloud.attributes["relative_difference"], [(0.5 - measured[v, u]) / 0.5 for u, v in pixels], rtol=1e-5
    )
    assert cloud.colors is not None
    for (u, v), (x, y, z), color in zip(pixels, points, cloud.colors, strict=True):
        if own_color_camera:
            u, v = round((x + 0.25) / z * 4.0 + 3.0), round(y / z * 4.0 + 2.0)  # noqa: PLW2901  # the other camera
            inside = 0 <= u < 8 and 0 <= v < 6
        else:
            inside = True
        assert color.tolist() == (image[v, u].tolist() if inside else [0, 0, 0])
