"""From the simulator's painted scan to the scores of a recording, against known truth."""

from __future__ import annotations

import csv
import json
import re

import numpy as np
import pytest

from painted_scan import PaintFlaws, write_painted_scan
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.evaluation.metrics import cloud_distances, compare_with_truth, truth_cloud
from tactune.core.evaluation.scan.paint import PaintSettings, contact_points, painted_contact, scan_truth
from tactune.core.evaluation.scan.pose import HEADER, load_transform, pose_from_pairs, transformed
from tactune.core.evaluation.scan.scan import load_scan
from tactune.core.methods.registry import make_method, method_names, needs_untouched
from tactune.core.model.clouds import pixel_areas_m2
from tactune.core.output.writer import SessionWriter
from tactune.core.sources.presets import load_preset
from tactune.core.sources.registry import open_source

pytest.importorskip("trimesh")

SOURCE = "sim:cup?press=medium&sensor=datasheet"
FRAME = 3


@pytest.fixture(scope="module")
def source():
    with open_source(SOURCE) as opened:
        yield opened


@pytest.fixture(scope="module")
def scans(source, tmp_path_factory):
    """The cup as a clean and a flawed mesh with coloured vertices, and as a coarse one with a texture."""
    folder = tmp_path_factory.mktemp("my scans")
    flaws = PaintFlaws(noise=12, specks=40, seed=1)
    return {
        "clean": write_painted_scan(source, FRAME, folder / "clean.ply"),
        "flawed": write_painted_scan(source, FRAME, folder / "flawed.ply", flaws),
        "texture": write_painted_scan(source, FRAME, folder / "a cup.obj", flaws),
    }


@pytest.fixture(scope="module")
def direct_mm(source):
    """RMSE of the preset's pipeline against the simulator's own truth."""
    frame = source.read(FRAME)
    patch = ContactPipeline(load_preset("simulator"), source.rig).process(frame)
    return compare_with_truth(patch, frame.truth, source.rig)["rmse_mm"]


@pytest.mark.parametrize("kind", ["clean", "flawed", "texture"])
def test_a_scan_shows_the_solvers_contact(source, scans, kind):
    scan, pose = load_scan(scans[kind][0]), load_transform(scans[kind][-1])
    np.testing.assert_array_equal(pose, source.facts(FRAME).T_proximity_object)
    contact = painted_contact(scan, PaintSettings())
    truth = truth_cloud(source.read(FRAME).truth, source.rig).points
    apart = cloud_distances(transformed(pose, contact_points(scan, contact)), truth)
    # Points 0.6 mm apart, as the truth's pixels are, lie 0.27 mm from the nearest of others on the same surface.
    assert apart.symmetric_rmse_m < 0.35e-3
    assert apart.percentile_95_m < 0.8e-3
    area_mm2 = 1e6 * pixel_areas_m2(truth[:, 2], source.rig.proximity.intrinsics).sum()
    assert scan_truth(scan, contact, pose).area_mm2 == pytest.approx(area_mm2, rel=0.03)


def test_the_texture_is_coarse_as_a_mesh(scans):
    fine, coarse = (scans[kind][0].stat().st_size for kind in ("clean", "texture"))
    assert coarse < fine / 3
    assert [path.suffix for path in scans["texture"]] == [".obj", ".mtl", ".png", ".json"]


def test_the_scores_with_the_true_transform_are_the_direct_ones(tactune, scans, direct_mm):
    for kind in ("clean", "texture"):
        status, out, err = tactune(
            "evaluate", "recording", "--source", SOURCE, "--scan", scans[kind][0], "--transform", scans[kind][-1],
            "--frame", FRAME, "--json",
        )  # fmt: skip
        assert status == 0
        assert re.search(rf"{scans[kind][0].name} was read in m: \d+ x \d+ x \d+ mm; say --unit", err)
        found = json.loads(out)
        (record,) = found["results"]
        assert record["symmetric_rmse_mm"] == pytest.approx(direct_mm, abs=0.1)
        rms = record["patch_to_truth_rms_mm"], record["truth_to_patch_rms_mm"]
        assert record["symmetric_rmse_mm"] == pytest.approx(sum(rms) / 2)
        assert record["hausdorff_mm"] >= record["percentile_95_mm"] > 0 and record["chamfer_mm"] > 0
        assert (record["sequence"], record["method"], record["failure"]) == (FRAME, "fusion", "")
        assert found["refined"] is None


def test_noisy_pairs_and_icp_come_near_the_direct_scores(tactune, scans, direct_mm, tmp_path):
    """Four points picked 2 mm off; the scan's numbers are millimetres."""
    scan, true = load_scan(scans["flawed"][0]), load_transform(scans["flawed"][-1])
    random = np.random.default_rng(11)
    touched = contact_points(scan, painted_contact(scan, PaintSettings()))
    extremes = [np.argmin(touched @ way) for way in ([1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0])]
    picked = touched[extremes].astype(np.float64)
    there = transformed(true, picked) + random.normal(0, 0.002, (4, 3))
    pairs = tmp_path / "pairs.csv"
    rows = [",".join(map(repr, map(float, row))) for row in np.column_stack([1e3 * picked, there])]
    pairs.write_text("\n".join([",".join(HEADER), *rows]) + "\n")
    in_mm = tmp_path / "mm.ply"
    _scale_ply(scans["flawed"][0], in_mm, 1e3)
    kept = tmp_path / "kept.json"
    common = ["evaluate", "recording", "--source", SOURCE, "--scan", in_mm, "--unit", "mm", "--frame", FRAME, "--json"]
    status, out, err = tactune(*common, "--pairs", pairs, "--refine", "--save-transform", kept)
    assert status == 0 and f"wrote {kept}" in err and "--unit" not in err
    found = json.loads(out)
    assert found["refined"]["converged"]

    def off_m(pose):
        return np.sqrt(np.mean(np.sum((transformed(pose, touched) - transformed(true, touched)) ** 2, axis=1)))

    assert off_m(load_transform(kept)) < min(1.2e-3, off_m(pose_from_pairs(picked, there)))
    assert found["results"][0]["symmetric_rmse_mm"] == pytest.approx(direct_mm, abs=0.35)


def _scale_ply(path, out, factor):
    import trimesh

    mesh = trimesh.load_mesh(path, process=False)
    mesh.apply_scale(factor)
    mesh.export(out)


def test_methods_frames_and_a_csv(tactune, scans, tmp_path):
    table = tmp_path / "scores.csv"
    status, out, err = tactune(
        "evaluate", "recording", "--source", SOURCE, "--scan", scans["clean"][0], "--transform", scans["clean"][-1],
        "--frames", "2:3", "--method", "fusion-rigid", "--method", "fusion-homography", "--refine", "--csv", table,
    )  # fmt: skip
    assert status == 0 and f"wrote {table}" in err
    lines = out.splitlines()
    assert lines[0].startswith("painted contact: ") and lines[1].startswith("ICP to the first method's patch: ")
    assert [line.split()[:2] for line in lines[3:]] == [
        ["2", "fusion-rigid"], ["2", "fusion-homography"], ["3", "fusion-rigid"], ["3", "fusion-homography"],
        ["mean", "fusion-rigid"], ["mean", "fusion-homography"],
    ]  # fmt: skip
    rows = list(csv.DictReader(table.read_text().splitlines()))
    assert [(row["sequence"], row["method"]) for row in rows[:2]] == [("2", "fusion-rigid"), ("2", "fusion-homography")]
    assert float(rows[0]["symmetric_rmse_mm"]) < float(rows[1]["symmetric_rmse_mm"])


def test_all_methods_leave_out_what_cannot_work(tactune, source, scans, tmp_path):
    recording = tmp_path / "no untouched frame.mcap"
    with SessionWriter(recording, source.rig) as writer:
        writer.put(source.read(FRAME), wait=True)
    command = ["evaluate", "recording", "--source", recording, "--scan", scans["clean"][0], "--preset", "simulator"]
    command += ["--transform", scans["clean"][-1], "--json", "--method"]
    status, out, err = tactune(*command, "all")
    assert status == 0
    found = {record["method"] for record in json.loads(out)["results"]}
    left_out = {name for name in method_names() if needs_untouched(name)}
    assert found == {"fusion", *method_names()} - left_out
    assert err.count("skipped: ") == len(left_out) and all(f"skipped: {name} needs" in err for name in left_out)
    status, out, err = tactune(*command, "proximity-only")
    assert (status, out) == (2, "") and "proximity-only needs a frame of the untouched membrane" in err


@pytest.mark.parametrize("frames, shown", [("--frame=3", (0, 3)), ("--frame=16", (2, 16)), ("--frames=16:17", (2, 17))])
def test_a_method_that_averages_is_shown_the_frames_before(tactune, source, scans, frames, shown):
    status, out, _ = tactune(
        "evaluate", "recording", "--source", SOURCE, "--scan", scans["clean"][0], "--transform", scans["clean"][-1],
        frames, "--method", "fusion-averaged", "--method", "fusion-membrane", "--json",
    )  # fmt: skip
    assert status == 0
    found = [record["points"] for record in json.loads(out)["results"] if record["method"] == "fusion-averaged"]
    preset = load_preset("simulator")
    method = make_method("fusion-averaged", preset, source.rig)
    patches = [method.find(source.read(index)) for index in range(shown[0], shown[1] + 1)]
    assert found == [len(patch.points) for patch in patches[-len(found) :]]
    alone = make_method("fusion-averaged", preset, source.rig).find(source.read(shown[1]))
    assert not np.array_equal(patches[-1].points, alone.points), "the frames before change the patch"


@pytest.mark.parametrize(
    "more, words",
    [
        ((), ("is not given", "--transform", "--pairs", "Analysis > Ground truth")),
        (("--transform", "{pose}", "--pairs", "{pose}"), ("both",)),
        (("--transform", "{scan}"), ("more than the 0.1 MB",)),
        (("--transform", "{pose}", "--paint", "hue=20:30"), ("hue 20:30", "--paint")),
        (("--transform", "{pose}", "--paint", "colour=pink"), ("'colour'", "known are")),
        (("--transform", "{pose}", "--paint", "hue=pink"), ("hue=150:179",)),
        (("--transform", "{pose}", "--method", "magic"), ("'magic'",)),
        (("--transform", "{pose}", "--frames", "5:2"), ("'5:2'", "0:9")),
        (("--transform", "{pose}", "--frame", "4000"), ("no frame 4000",)),
        (("--transform", "{pose}", "--frames", "0:4000"), ("no frame 4000",)),
        (("--transform", "{pose}", "--untouched", "sim"), ("remove --untouched",)),
        (("--transform", "{pose}", "--unit", "mm"), ("set the unit",)),
        (("--transform", "{away}"), ("behind the proximity camera",)),
    ],
)
def test_what_cannot_be_evaluated_ends_with_a_sentence(tactune, scans, tmp_path, more, words):
    away = tmp_path / "away.txt"
    away.write_text("1 0 0 0\n0 1 0 0\n0 0 1 -1\n0 0 0 1\n")
    names = {"{pose}": scans["clean"][-1], "{scan}": scans["clean"][0], "{away}": away}
    command = ["evaluate", "recording", "--source", SOURCE, "--scan", scans["clean"][0]]
    sentence = tactune(*command, *(names.get(word, word) for word in more)).sentence
    for word in words:
        assert word in sentence
