"""Contact by paint: the clean-up, and the way from the simulator's painted scan to the scores of a recording."""

import csv

import cv2
import numpy as np
import pytest

from painted_scan import PINK, PURPLE, write_painted_scan
from tactune.core.calibration.geometry import moved
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.lab.scan import PAINT, Scan, load_scan, load_transform, painted_contact, scan_truth, surface_points
from tactune.core.model.clouds import pixel_areas_m2, truth_points
from tactune.core.model.metrics import compare_with_truth, symmetric_rmse_m
from tactune.core.sources.presets import load_preset
from tactune.core.sources.registry import open_source

pytest.importorskip("trimesh")

SOURCE = "sim:cup?press=medium&sensor=datasheet"
FRAME = 3
SIDE_M = 0.001


def plate(pink, count=101):
    """A flat mesh of 1 mm squares, pink where the function of x and y (millimetres) says so."""
    y, x = np.mgrid[:count, :count].astype(float)
    number = np.arange(count * count).reshape(count, count)
    a, b, c, d = (part.ravel() for part in (number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]))
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(count * count)], 1) * SIDE_M
    colors = np.where(pink(x, y).ravel()[:, None], PINK, PURPLE).astype(np.uint8)
    return Scan(vertices, triangles, colors)


def disc(x0, y0, radius):
    return lambda x, y: np.hypot(x - x0, y - y0) < radius


def spots(x, y):
    """Three spots of 707, 314 and 28 mm2, the first with a hole of 28 mm2."""
    large = disc(30, 30, 15)(x, y) & ~disc(30, 30, 3)(x, y)
    return large | disc(70, 70, 10)(x, y) | disc(10, 80, 3)(x, y)


def area_mm2(scan, contact):
    return contact.sum() * SIDE_M**2 * 1e6


@pytest.mark.parametrize(
    ("least", "expected"),
    [(40, 707 + 314), (800, 0)],  # the hole is filled, the small spot dropped
)
def test_small_spots_and_holes_go(least, expected):
    scan = plate(spots)
    contact = painted_contact(scan, PAINT.model_copy(update={"least_area_mm2": least}))
    assert area_mm2(scan, contact) == pytest.approx(expected, abs=30)


def test_a_texture_colours_a_surface(tmp_path):
    """A square of 100 mm whose left 30 % are painted."""
    corners = "v 0 0 0\nv .1 0 0\nv .1 .1 0\nv 0 .1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
    (tmp_path / "a.obj").write_text(f"mtllib a.mtl\n{corners}usemtl a\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n")
    (tmp_path / "a.mtl").write_text("newmtl a\nKd 1 1 1\nmap_Kd a.png\n")
    picture = np.full((200, 200, 3), PURPLE, np.uint8)
    picture[:, :60] = PINK
    cv2.imwrite(str(tmp_path / "a.png"), picture[..., ::-1])
    scan = load_scan(tmp_path / "a.obj")
    points, _ = surface_points(scan, painted_contact(scan))
    assert points[:, 0].max() == pytest.approx(0.030, abs=0.002)


@pytest.fixture(scope="module")
def source():
    with open_source(SOURCE) as opened:
        yield opened


@pytest.fixture(scope="module")
def painted(source, tmp_path_factory):
    """The cup as a mesh with coloured vertices, and its pose."""
    return write_painted_scan(source, FRAME, tmp_path_factory.mktemp("my scans") / "cup.ply")


@pytest.fixture(scope="module")
def direct_mm(source):
    """RMSE of the preset's pipeline against the simulator's own truth."""
    frame = source.read(FRAME)
    patch = ContactPipeline(load_preset("simulator"), source.rig).process(frame)
    return compare_with_truth(patch, frame.truth, source.rig)["rmse_mm"]


def test_a_scan_shows_the_solvers_contact(source, painted):
    scan, pose = load_scan(painted[0]), load_transform(painted[1])
    np.testing.assert_array_equal(pose, source.facts(FRAME).T_proximity_object)
    contact = painted_contact(scan)
    truth = truth_points(source.read(FRAME).truth, source.rig)
    # Points 0.6 mm apart, as the truth's pixels are, lie 0.27 mm from the nearest of others on the same surface.
    assert symmetric_rmse_m(moved(pose, surface_points(scan, contact)[0]), truth) < 0.35e-3
    area_mm2 = 1e6 * pixel_areas_m2(truth[:, 2], source.rig.proximity.intrinsics).sum()
    assert scan_truth(scan, contact, pose).area_mm2 == pytest.approx(area_mm2, rel=0.03)


def test_the_scores_with_the_true_transform_are_the_direct_ones(tactune, painted, direct_mm, tmp_path):
    status, _, err = tactune(
        "lab", "scan", "--source", SOURCE, "--scan", painted[0], "--transform", painted[1],
        "--frame", FRAME, "--frames", 1, "--csv", tmp_path / "scores.csv",
    )  # fmt: skip
    assert (status, err) == (0, "")
    (row,) = csv.DictReader((tmp_path / "scores.csv").read_text().splitlines())
    assert float(row["rmse_mm"]) == pytest.approx(direct_mm, abs=0.1)
    assert (row["sequence"], row["failure"]) == (str(FRAME), "")


@pytest.mark.parametrize(
    "more, words",
    [
        ((), ("--transform",)),
        (("--transform", "{pose}", "--paint", "hue=[20,30]"), ("--paint",)),
        (("--transform", "{pose}", "--paint", "hue=pink"), ("hue", "pink")),
        (("--transform", "{pose}", "--frame", "4000"), ("no frame 4000",)),
        (("--transform", "{pose}", "--unit", "mm"), ("the unit",)),
        (("--transform", "{away}"), ("behind the proximity camera",)),
    ],
)
def test_what_cannot_be_evaluated_ends_with_a_sentence(tactune, painted, tmp_path, more, words):
    away = tmp_path / "away.txt"
    away.write_text("1 0 0 0\n0 1 0 0\n0 0 1 -1\n0 0 0 1\n")
    names = {"{pose}": painted[1], "{away}": away}
    command = ["lab", "scan", "--source", SOURCE, "--scan", painted[0]]
    status, _, err = tactune(*command, *(names.get(word, word) for word in more))
    assert status == 2
    assert all(word in err for word in words), err
