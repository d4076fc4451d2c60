"""`tactune evaluate patch`: clouds from files of Tactune and of other programs."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from tactune.core.errors import SourceError
from tactune.core.evaluation.metrics import cloud_distances
from tactune.core.model.clouds import PointCloud
from tactune.core.output.cloud_files import read_points, write_cloud

RNG = np.random.default_rng(5)
PATCH = RNG.normal(0, 0.02, (150, 3)).astype(np.float32)
TRUTH = RNG.normal(0, 0.02, (120, 3)).astype(np.float32)


EXPECTED = {f"{name.removesuffix('_m')}_mm": 1e3 * m for name, m in asdict(cloud_distances(PATCH, TRUTH)).items()}


@pytest.mark.parametrize("suffix", ["ply", "npz", "csv"])
def test_a_device_behind_a_link_is_refused(tmp_path, suffix):
    (tmp_path / f"a.{suffix}").symlink_to("/dev/zero")
    with pytest.raises(SourceError, match="no ordinary file"):
        read_points(tmp_path / f"a.{suffix}")


@pytest.mark.parametrize("suffix", ["ply", "npz", "csv"])
def test_files_of_this_program(tmp_path, tactune, suffix):
    write_cloud(tmp_path / f"a.{suffix}", PointCloud(PATCH))
    write_cloud(tmp_path / f"b.{suffix}", PointCloud(TRUTH))
    files = ["--patch", tmp_path / f"a.{suffix}", "--truth", tmp_path / f"b.{suffix}"]
    status, out, _ = tactune("evaluate", "patch", *files, "--json")
    assert status == 0
    found = json.loads(out)
    assert (found.pop("patch_points"), found.pop("truth_points")) == (150, 120)
    assert found == pytest.approx(EXPECTED, rel=1e-6)
    status, out, _ = tactune("evaluate", "patch", *files)
    assert status == 0
    assert f"{EXPECTED['symmetric_rmse_mm']:.3f} mm" in out


@pytest.mark.parametrize("suffix", ["ply"])
@pytest.mark.parametrize("ascii_text", [True, False])
def test_files_of_open3d(tmp_path, suffix, ascii_text):
    open3d = pytest.importorskip("open3d")
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(PATCH.astype(float)))
    cloud.paint_uniform_color([0.1, 0.5, 0.9])
    path = tmp_path / f"a.{suffix}"
    assert open3d.io.write_point_cloud(str(path), cloud, write_ascii=ascii_text)
    np.testing.assert_allclose(read_points(path)[0], PATCH, atol=1e-6 if ascii_text else 1e-8)


@pytest.mark.parametrize("empty", [PATCH[:0], np.full((2, 3), np.nan, np.float32)])
@pytest.mark.parametrize("which", ["--patch", "--truth"])
def test_an_empty_cloud_is_refused(tmp_path, tactune, empty, which):
    write_cloud(tmp_path / "a.ply", PointCloud(empty))
    write_cloud(tmp_path / "b.ply", PointCloud(TRUTH))
    (other,) = {"--patch", "--truth"} - {which}
    files = [which, tmp_path / "a.ply", other, tmp_path / "b.ply"]
    status, out, err = tactune("evaluate", "patch", *files, "--json")
    assert (status, out) == (2, "")
    assert "a.ply holds no point" in err


def test_points_with_a_nan_are_counted(tmp_path, tactune):
    write_cloud(tmp_path / "a.npz", PointCloud(np.vstack([PATCH, np.full((3, 3), np.nan, np.float32)])))
    write_cloud(tmp_path / "b.ply", PointCloud(TRUTH))
    files = ["--patch", tmp_path / "a.npz", "--truth", tmp_path / "b.ply"]
    status, out, err = tactune("evaluate", "patch", *files, "--json")
    assert status == 0
    assert json.loads(out)["patch_points"] == 150
    assert "a.npz: 3 points of 153 ignored" in err


PLY = b"ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n"


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.ply", b""),
        ("a.ply", PLY + b"1 2 3\n"),
        ("a.ply", PLY + b"1 2\n1 2\n"),
        ("a.ply", PLY.replace(b"vertex 2", b"vertex 99999999999999") + b"1 2 3\n"),
        ("a.ply", PLY.replace(b"vertex 2", b"vertex -2") + b"1 2 3\n"),
        ("a.ply", PLY.replace(b"vertex 2", b"vertex")),
        ("a.ply", PLY.replace(b"float z", b"float w") + b"1 2 3\n1 2 3\n"),
        ("a.ply", PLY + b"\xff\xfe\x00 2 3\n1 2 3\n"),
        ("a.npz", b"PK\x03\x04garbage"),
        ("a.csv", b"x,y\n1,2\n"),
        ("a.txt", b"1 2 3\n"),
        ("missing.ply", None),
        ("a.ply", RNG.bytes(5000)),
    ],
)
def test_garbage_is_one_sentence(tmp_path: Path, tactune, name, data):
    if data is not None:
        (tmp_path / name).write_bytes(data)
    write_cloud(tmp_path / "b.ply", PointCloud(TRUTH))
    done = tactune("evaluate", "patch", "--patch", tmp_path / name, "--truth", tmp_path / "b.ply")
    assert name in done.sentence
