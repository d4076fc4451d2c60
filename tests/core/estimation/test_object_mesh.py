"""Meshes of objects from files: formats, units and refusals."""

import sys

import numpy as np
import pytest
import trimesh

from tactune.core import load_preset
from tactune.core.errors import MissingExtraError, SourceError
from tactune.core.estimation.object_mesh import load_mesh
from tactune.core.estimation.pose import PoseTracker
from tactune.core.sources.simulator.scene import simulator_rig


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
