"""Scan files: vertex colours, textures, and invalid files."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from tactune.core.errors import MissingExtraError, SourceError
from tactune.core.evaluation.scan.scan import load_scan

trimesh = pytest.importorskip("trimesh")
Image = pytest.importorskip("PIL.Image")

PINK, PURPLE = (235, 110, 170), (90, 50, 140)

#: A 40 mm square of two triangles whose texture is pink where u < 0.25 or v > 0.5.
SQUARE_OBJ = """mtllib square.mtl
v 0 0 0
v 0.04 0 0
v 0.04 0.04 0
v 0 0.04 0
vt 0 0
vt 1 0
vt 1 1
vt 0 1
usemtl paint
f 1/1 2/2 3/3
f 1/1 3/3 4/4
"""


def ball(colors=True):
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.04)
    if colors:
        rgb = np.where(mesh.vertices[:, 2:] < 0, PINK, PURPLE).astype(np.uint8)
        mesh.visual.vertex_colors = np.column_stack([rgb, np.full(len(rgb), 255, np.uint8)])
    return mesh


@pytest.fixture
def square(tmp_path):
    image = np.full((200, 200, 3), PURPLE, np.uint8)
    image[:, :50] = PINK
    image[:100] = PINK  # the image's first row is v = 1
    Image.fromarray(image).save(tmp_path / "square.png")
    (tmp_path / "square.mtl").write_text("newmtl paint\nmap_Kd square.png\n")
    (tmp_path / "square.obj").write_text(SQUARE_OBJ)
    return tmp_path / "square.obj"


@pytest.mark.parametrize("suffix", ["ply", "obj"])
@pytest.mark.parametrize("unit_m", [1.0, 0.001])
def test_vertex_colours_and_the_unit(tmp_path, suffix, unit_m):
    mesh = ball()
    mesh.apply_scale(1 / unit_m)
    mesh.export(tmp_path / f"ball.{suffix}")
    scan = load_scan(tmp_path / f"ball.{suffix}", unit_m)
    assert scan.vertices_m.shape == (642, 3) and scan.triangles.shape == (1280, 3)
    assert (scan.vertices_m.dtype, scan.triangles.dtype, scan.colors.dtype) == (np.float64, np.int32, np.uint8)
    np.testing.assert_allclose(np.linalg.norm(scan.vertices_m, axis=1), 0.04, atol=1e-7)
    np.testing.assert_array_equal(scan.colors, np.where(scan.vertices_m[:, 2:] < -1e-9, PINK, PURPLE))
    assert scan.areas_m2.sum() == pytest.approx(ball().area, rel=1e-6)


def test_a_text_ply_of_any_program(tmp_path):
    ball().export(tmp_path / "ball.ply", encoding="ascii")
    assert len(load_scan(tmp_path / "ball.ply").vertices_m) == 642


def test_a_coarse_mesh_shows_its_textures_detail(square):
    scan = load_scan(square)
    x, y = scan.vertices_m[:, 0], scan.vertices_m[:, 1]
    clear = (np.abs(x - 0.01) > 3e-4) & (np.abs(y - 0.02) > 3e-4)
    pink = (x < 0.01) | (y > 0.02)
    assert clear.sum() > 1000
    np.testing.assert_array_equal(scan.colors[clear], np.where(pink[clear, None], PINK, PURPLE))
    edges = np.diff(scan.vertices_m[scan.triangles[:, [0, 1, 2, 0]]], axis=1)
    assert np.linalg.norm(edges, axis=2).max() <= 0.0008
    assert scan.areas_m2.sum() == pytest.approx(0.04**2)


def test_vertices_on_a_texture_seam_are_one(square):
    seam = SQUARE_OBJ.replace("f 1/1 3/3 4/4", "vt 0.1 0.1\nvt 0.9 0.9\nf 1/5 3/6 4/4")
    square.write_text(seam)
    scan = load_scan(square)
    assert len(np.unique(scan.vertices_m, axis=0)) == len(scan.vertices_m)


def test_a_textured_ply(square):
    loaded = trimesh.load_mesh(square)
    uv = loaded.visual.uv
    header = [
        "ply", "format ascii 1.0", "comment TextureFile square.png", "element vertex 4", "property float x",
        "property float y", "property float z", "property float s", "property float t", "element face 2",
        "property list uchar int vertex_indices", "end_header",
    ]  # fmt: skip
    rows = [" ".join(f"{n:.6g}" for n in (*xyz, *st)) for xyz, st in zip(loaded.vertices, uv, strict=True)]
    rows += ["3 " + " ".join(map(str, face)) for face in loaded.faces]
    path = square.with_suffix(".ply")
    path.write_text("\n".join([*header, *rows]) + "\n")
    scan = load_scan(path)
    share = (scan.colors == PINK).all(axis=1).mean()
    assert len(scan.vertices_m) > 1000 and share == pytest.approx(0.625, abs=0.03)


@pytest.mark.parametrize("sliver_m", [0.04, 1e-6])
def test_a_texture_makes_no_more_triangles_than_memory_takes(square, monkeypatch, sliver_m):
    square.write_text(SQUARE_OBJ.replace("0.04 0\n", f"{sliver_m} 0\n"))
    monkeypatch.setattr("tactune.core.evaluation.scan.scan.MAX_TEXTURE_TRIANGLES", 60)
    assert 10 < len(load_scan(square).triangles) <= 60


def test_a_small_part_is_no_small_object(square):
    small = "v 0.05 0 0\nv 0.051 0 0\nv 0.05 0.001 0\nusemtl other\nf 5/1 6/2 7/3\n"
    square.with_suffix(".mtl").write_text("newmtl paint\nmap_Kd square.png\nnewmtl other\nmap_Kd square.png\n")
    square.write_text(SQUARE_OBJ + small)
    assert load_scan(square).vertices_m[:, 0].max() == pytest.approx(0.051)


def test_several_textures_in_one_file(square):
    image = np.full((8, 8, 3), (10, 200, 30), np.uint8)
    Image.fromarray(image).save(square.with_name("green.png"))
    square.with_suffix(".mtl").write_text("newmtl paint\nmap_Kd square.png\nnewmtl other\nmap_Kd green.png\n")
    square.write_text(SQUARE_OBJ.replace("f 1/1 3/3 4/4", "usemtl other\nf 1/1 3/3 4/4"))
    scan = load_scan(square)
    green = (scan.colors == (10, 200, 30)).all(axis=1)
    below = scan.vertices_m[:, 1] < scan.vertices_m[:, 0] - 1e-6
    assert green[~below].mean() > 0.9 and not green[below].any()


def without(line):
    return SQUARE_OBJ.replace(line, "")


@pytest.mark.parametrize(
    "name, text, words",
    [
        ("scan.stl", "solid", ("'.stl'", ".ply, .obj")),
        ("scan.ply", "", ("0 bytes",)),
        ("scan.ply", "ply\n", ("no readable .ply mesh",)),
        ("scan.ply", "ply\nformat ascii 1.0\nelement vertex 999999999\nproperty float x\nend_header\n", ("scan.ply",)),
        ("scan.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n", ("no triangles", "as a mesh")),
        ("scan.obj", "v 0 0 0\nv .1 0 0\nv 0 .1 0\nf 1 2 3\n", ("no colours", "vertex colours")),
        ("scan.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", ("scan.obj",)),
        (
            "scan.obj",
            "v 0 0 0 1 0 0\nv nan 0 0 1 0 0\nv 0 1 0 1 0 0\nf 1 2 3\n",
            ("nan, infinite or beyond 1e+09 (1)",),
        ),
        ("scan.obj", "v 0 0 0 1 0 0\nv 1e300 0 0 1 0 0\nv 0 1 0 1 0 0\nf 1 2 3\n", ("beyond 1e+09 (1)",)),
        ("scan.obj", "v 0 0 0 1 0 0\nv .1 0 0 1 0 0\nv .2 0 0 1 0 0\nf 1 2 3\n", ("without area",)),
        ("scan.obj", SQUARE_OBJ, ("texture that is missing", "same folder")),
        ("scan.obj", without("mtllib square.mtl\n"), ("texture that is missing",)),
    ],
)
def test_what_is_no_scan_is_refused_in_words(tmp_path, name, text, words):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(SourceError) as caught:
        load_scan(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)
    for word in words:
        assert word in str(caught.value)


def test_a_damaged_texture_and_a_missing_file(square, capfd):
    square.with_suffix(".png").write_bytes(b"\x89PNG no")
    with pytest.raises(SourceError, match="cannot be read"):
        load_scan(square)
    with pytest.raises(SourceError, match="check the path"):
        load_scan(square.with_name("other.obj"))
    assert capfd.readouterr().err == ""


def test_a_cut_off_file(tmp_path):
    ball().export(tmp_path / "ball.ply")
    data = (tmp_path / "ball.ply").read_bytes()
    for share in (0.1, 0.5, 0.95):
        (tmp_path / "ball.ply").write_bytes(data[: int(share * len(data))])
        with pytest.raises(SourceError, match="export it again"):
            load_scan(tmp_path / "ball.ply")


@pytest.mark.parametrize("scale, unit_m, words", [(1000, 1.0, "set the unit to mm"), (1, 1e-3, "set the unit to m")])
def test_another_unit_is_told(tmp_path, scale, unit_m, words):
    mesh = ball()
    mesh.apply_scale(scale)
    mesh.export(tmp_path / "ball.ply")
    with pytest.raises(SourceError, match=words):
        load_scan(tmp_path / "ball.ply", unit_m)


@pytest.mark.parametrize("unit_m", [0.0, -1.0, np.nan, np.inf])
def test_a_unit_has_a_length(tmp_path, unit_m):
    ball().export(tmp_path / "ball.ply")
    with pytest.raises(SourceError, match="the unit of"):
        load_scan(tmp_path / "ball.ply", unit_m)


def test_without_the_extra_a_sentence_says_how_to_install_it(tmp_path, monkeypatch):
    ball().export(tmp_path / "ball.ply")
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(MissingExtraError, match=r'needs trimesh.*pip install "tactune\[scan\]"'):
        load_scan(tmp_path / "ball.ply")


def test_damaged_files_end_with_a_sentence(tmp_path):
    random, path = np.random.default_rng(0), tmp_path / "ball.ply"
    ball().export(path)
    data, refused = path.read_bytes(), 0
    for _ in range(60):
        damaged = bytearray(data)
        for place in random.integers(0, 500, 3):
            damaged[place] = random.integers(256)
        path.write_bytes(bytes(damaged))
        try:
            load_scan(path)
        except SourceError as error:
            refused += str(path) in str(error)
    assert refused > 30
