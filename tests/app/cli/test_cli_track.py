"""``tactune track``: poses as other programs read them, and what it refuses."""

import csv

import numpy as np
import pytest
import trimesh
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from tactune.core.estimation.object_mesh import simulated_mesh
from tactune.core.sources.simulator.source import SimulatorSource

FRAMES = 20


@pytest.fixture(scope="module")
def truths():
    source = SimulatorSource("cup")
    return [np.array(source.read(n).truth.T_proximity_object) for n in range(FRAMES)]


@pytest.fixture(scope="module")
def cup(tmp_path_factory):
    """The simulator's cup in millimetres."""
    folder, source = tmp_path_factory.mktemp("cup"), SimulatorSource("cup")
    mesh = simulated_mesh(source.scene, source.name)
    trimesh.Trimesh(1000 * mesh.vertices_m, mesh.triangles, process=False).export(folder / "cup.stl")
    return folder / "cup.stl"


def arguments(cup, *more):
    return ["track", "--source", "sim:cup", "--mesh", str(cup), "-n", str(FRAMES), *map(str, more)]


def test_table_has_every_frame_with_its_errors(tactune, cup, tmp_path):
    out = tmp_path / "poses.csv"
    done = tactune(*arguments(cup, "--out", out, "--truth"))
    assert done.status == 0
    assert "107 x 92 x 74 mm" in done.err
    assert "error in determined directions" in done.out
    with out.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["sequence"]) for row in rows] == list(range(FRAMES))
    assert rows[0]["lost"] == "1"
    assert rows[0]["position_error_mm"] == rows[0]["residual_mm"] == ""
    assert rows[-1]["lost"] == "0"
    assert float(rows[-1]["position_error_mm"]) < 2
    assert float(rows[-1]["angle_error_deg"]) < 3
    assert 0 < float(rows[-1]["sigma_x_m"]) < 0.01
    assert np.linalg.norm([float(rows[-1][key]) for key in ("qx", "qy", "qz", "qw")]) == pytest.approx(1)


def test_patches_and_poses_together_as_ros_reads_them(tactune, cup, truths, tmp_path):
    out = tmp_path / "poses.mcap"
    assert tactune(*arguments(cup, "--out", out)).status == 0
    with out.open("rb") as file:
        read = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        found = {}
        for _, channel, message, decoded in read:
            found.setdefault(channel.topic, {})[message.sequence] = decoded
    assert sorted(found) == ["/contact/patch", "/object/pose", "/tf"]
    assert list(found["/contact/patch"]) == list(range(FRAMES))
    stamped = found["/object/pose"][FRAMES - 1]
    pose, transform = stamped.pose.pose, found["/tf"][FRAMES - 1].transforms[0]
    assert stamped.header.frame_id == transform.header.frame_id == "proximity_depth_optical_frame"
    assert transform.child_frame_id == "object"
    place = np.array([pose.position.x, pose.position.y, pose.position.z])
    assert place == pytest.approx(truths[-1][:3, 3], abs=0.003)
    assert transform.transform.translation.x == pose.position.x
    covariance = np.reshape(stamped.pose.covariance, (6, 6))
    assert np.linalg.eigvalsh(covariance).min() > 0
    assert 0 not in found["/object/pose"], "a lost pose is not published"


def test_wrong_mesh_and_wrong_options_end_with_one_sentence(tactune, cup, tmp_path):
    trimesh.creation.icosphere(3, 0.006).export(tmp_path / "pea.ply")
    out = tmp_path / "poses.csv"
    done = tactune("track", "--source", "sim:cup", "--mesh", tmp_path / "pea.ply", "-n", FRAMES, "--out", out)
    assert done.status == 2
    assert "pea.ply" in done.err
    assert not out.exists()
    (tmp_path / "file").touch()
    done = tactune("track", "--source", "sim:cup", "--mesh", tmp_path / "pea.ply", "--out", tmp_path / "file" / "a.csv")
    assert done.status == 2
    assert "a.csv" in done.err and "fit" not in done.err, "told before anything is computed"
    done = tactune(*arguments(cup, "--out", tmp_path / "poses.txt"))
    assert done.status == 2
    assert ".mcap" in done.err
    assert tactune(*arguments(cup)).status == 2


def test_a_source_that_fails_leaves_the_poses_until_then(tactune, cup, tmp_path):
    frames, out = tmp_path / "frames", tmp_path / "poses.csv"
    assert tactune("convert", "sim:cup", frames, "-n", FRAMES).status == 0
    broken = sorted(frames.glob("*/proximity_depth.png"))[FRAMES - 2]
    broken.write_bytes(broken.read_bytes()[:1000])
    command = arguments(cup, "--out", out, "--preset", "simulator")
    command[command.index("sim:cup")] = f"folder:{frames}"
    done = tactune(*command)
    assert done.status == 2
    assert broken.name in done.err
    with out.open(encoding="utf-8", newline="") as file:
        assert len(list(csv.DictReader(file))) == FRAMES - 2
