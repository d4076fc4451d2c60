"""``tactune track``: poses as other programs read them, and what it refuses."""

import csv

import numpy as np
import pytest
import trimesh
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from fakes import FakeSource
from tactune.core.estimation.object_mesh import simulated_mesh
from tactune.core.sources.folder import export_folder
from tactune.core.sources.simulator.simulator_source import SimulatorSource

#: Of the simulator's press: without contact, and with more and more.
FRAMES = (0, 17, 18, 19)


@pytest.fixture(scope="module")
def cup(tmp_path_factory):
    """A folder with the simulator's cup in millimetres, and some frames of its press."""
    folder, source = tmp_path_factory.mktemp("cup"), SimulatorSource("cup")
    mesh = simulated_mesh(source.scene, source.name)
    trimesh.Trimesh(1000 * mesh.vertices_m, mesh.triangles, process=False).export(folder / "cup.stl")
    export_folder(FakeSource(frames=[source.read(index) for index in FRAMES], rig=source.rig), folder / "frames")
    return folder


def arguments(cup, *more, frames="", mesh="cup.stl"):
    return ["track", "-s", frames or cup / "frames", "-p", "simulator", "--mesh", cup / mesh, *more]


def test_table_has_every_frame_with_its_errors(tactune, cup, tmp_path):
    out = tmp_path / "poses.csv"
    done = tactune(*arguments(cup, "--out", out, "--truth", "-n", 20, frames="sim:cup"))  # no folder holds true poses
    assert done.status == 0
    assert "107 x 92 x 74 mm" in done.err
    assert "error in determined directions" in done.out
    with out.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["sequence"]) for row in rows] == list(range(20))
    assert rows[0]["lost"] == "1"
    assert rows[0]["position_error_mm"] == rows[0]["residual_mm"] == ""
    assert rows[-1]["lost"] == "0"
    assert float(rows[-1]["position_error_mm"]) < 2
    assert float(rows[-1]["angle_error_deg"]) < 3
    assert 0 < float(rows[-1]["sigma_x_m"]) < 0.01
    assert np.linalg.norm([float(rows[-1][key]) for key in ("qx", "qy", "qz", "qw")]) == pytest.approx(1)


def test_patches_and_poses_together_as_ros_reads_them(tactune, cup, tmp_path):
    out = tmp_path / "poses.mcap"
    assert tactune(*arguments(cup, "--out", out)).status == 0
    with out.open("rb") as file:
        read = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        found = {}
        for _, channel, message, decoded in read:
            found.setdefault(channel.topic, {})[message.sequence] = decoded
    assert sorted(found) == ["/contact/area_mm2", "/contact/doubt", "/contact/patch", "/object/pose", "/tf"]
    assert list(found["/contact/patch"]) == list(FRAMES)
    stamped = found["/object/pose"][FRAMES[-1]]
    pose, transform = stamped.pose.pose, found["/tf"][FRAMES[-1]].transforms[0]
    assert stamped.header.frame_id == transform.header.frame_id == "proximity_depth_optical_frame"
    assert transform.child_frame_id == "object"
    place = np.array([pose.position.x, pose.position.y, pose.position.z])
    true = np.array(SimulatorSource("cup").read(FRAMES[-1]).truth.T_proximity_object)
    assert place == pytest.approx(true[:3, 3], abs=0.003)
    assert transform.transform.translation.x == pose.position.x
    covariance = np.reshape(stamped.pose.covariance, (6, 6))
    assert np.linalg.eigvalsh(covariance).min() > 0
    assert 0 not in found["/object/pose"], "a lost pose is not published"


def test_wrong_mesh_and_wrong_options_end_with_one_sentence(tactune, cup, tmp_path):
    trimesh.creation.icosphere(3, 0.006).export(tmp_path / "pea.ply")
    (tmp_path / "file").touch()
    pea, out = tmp_path / "pea.ply", tmp_path / "poses.csv"
    refused = tactune(*arguments(cup, "--out", out, mesh=pea))
    assert refused.status == 2 and "pea.ply" in refused.err
    assert not out.exists()
    early = tactune(*arguments(cup, "--out", tmp_path / "file" / "a.csv", mesh=pea))
    assert early.status == 2 and "a.csv" in early.err and "fit" not in early.err, "told before anything is computed"
    assert ".mcap" in tactune(*arguments(cup, "--out", tmp_path / "poses.txt")).err
    assert tactune(*arguments(cup)).status == 2
