"""Cloud files: lossless round trip, readable by other programs, clear errors for bad files."""

import csv
import io

import numpy as np
import pytest
from trimesh.exchange.ply import load_ply

from tactune.core.contact.pipeline import ContactPatch
from tactune.core.errors import ExportError
from tactune.core.model.frames import ColorCamera, DepthCamera, Rig, SensorFrame
from tactune.core.model.intrinsics import Intrinsics
from tactune.core.model.patch import AlignedDepth, Provenance
from tactune.core.output.cloud_files import SUFFIXES, patch_columns, write_cloud


def make_columns(count=7):
    rng = np.random.default_rng(count)
    columns = dict(zip("xyz", rng.normal(size=(3, count)).astype(np.float32), strict=True))
    columns |= {name: rng.integers(0, 256, count).astype(np.uint8) for name in ("red", "green", "blue")}
    columns |= {"relative_difference": np.full(count, np.nan, np.float32), "u": np.arange(count).astype(np.uint16)}
    return columns


def points_in(path):
    """Read points by other programs' means."""
    if path.suffix.lower() == ".ply":
        return np.asarray(load_ply(io.BytesIO(path.read_bytes()))["vertices"])
    if path.suffix.lower() == ".npz":
        return np.load(path)["points"]
    return np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)[:, :3]


@pytest.mark.parametrize("suffix", [*SUFFIXES, ".PLY", ".NPZ"])
def test_points_come_back_bit_for_bit(tmp_path, suffix):
    columns = make_columns()
    write_cloud(tmp_path / f"cloud{suffix}", columns)
    expected = np.column_stack([columns[axis] for axis in "xyz"])
    assert points_in(tmp_path / f"cloud{suffix}").astype(np.float32).tobytes() == expected.tobytes()
    assert [path.name for path in tmp_path.iterdir()] == [f"cloud{suffix}"]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_frame_without_contact_is_an_empty_cloud(tmp_path, suffix):
    write_cloud(tmp_path / f"cloud{suffix}", make_columns(0))
    content = (tmp_path / f"cloud{suffix}").read_bytes()
    assert {".ply": b"element vertex 0\n", ".npz": b"points.npy", ".csv": b"x_m,y_m,z_m"}[suffix] in content


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
