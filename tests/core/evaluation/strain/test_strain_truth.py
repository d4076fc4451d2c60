"""The solver's strain in frames, in the table and in ``tactune run --truth``."""

from __future__ import annotations

import csv
import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from tactune.core.evaluation.table import Table
from tactune.core.evaluation.table_cell import TableCell
from tactune.core.evaluation.table_report import scene_strains, table_as_json, table_as_text
from tactune.core.model.files import write_csv
from tactune.core.sources.registry import open_source
from tactune.core.sources.simulator.grid_strain import dots_shown, grid_strain
from tactune.core.sources.simulator.membrane import Membrane
from tactune.core.sources.simulator.mesh import MembraneDesign
from tactune.core.sources.simulator.scene import cameras, simulator_rig
from tactune.core.sources.simulator.sheet import DOT_RADIUS_M, dot_grid

LOW = "sim:cup?press=low&grid=dots&sensor=datasheet"


@pytest.fixture(scope="module")
def flat():
    """A membrane that has not been inflated, and the tactile camera before it."""
    membrane = Membrane(MembraneDesign(cells=(60, 36)))
    return membrane, cameras(simulator_rig(), membrane.design)[1]


def test_a_stretched_sheet_has_the_strain_of_its_stretch(flat):
    membrane, camera = flat
    nodes = membrane.mesh.flat * (1.5, 1.25, 1.0)
    strain = grid_strain(membrane, nodes, camera)
    assert (strain.length, strain.width) == pytest.approx((0.5, 0.25))


def test_only_pairs_of_which_both_dots_are_seen_whole_count_as_seen(flat):
    """The sheet is stretched most between 20 and 50 mm; a camera further aside does not see that."""
    membrane, camera = flat
    nodes = membrane.mesh.flat.copy()
    assert grid_strain(membrane, nodes, camera).length_seen == pytest.approx(0.0)
    nodes[:, 0] += 0.5 * np.clip(nodes[:, 0] - 0.02, 0.0, 0.03)  # 50 % from 20 to 50 mm
    assert grid_strain(membrane, nodes, camera).length_seen == pytest.approx(0.5)
    x, _, z = camera.pose @ (0.015, 0.0, 0.0, 1.0)
    lens = camera.intrinsics
    aside = replace(camera, pose=camera.pose.copy())
    aside.pose[0, 3] += (lens.width - lens.cx) / lens.fx * z - x  # 15 mm is the edge of the picture
    beside = grid_strain(membrane, nodes, aside)
    assert (beside.length, beside.length_seen) == pytest.approx((0.5, 0.0))


def hooded(membrane, nodes):
    """Lift a strip of the sheet towards the cameras, so that it covers what is behind it."""
    hood = np.abs(nodes[:, 0] - 0.07) < 0.012
    lifted = nodes.copy()
    lifted[hood] += (-0.035, 0.0, -0.15)
    return lifted


def test_the_share_of_a_dot_that_is_shown_is_that_of_rays_which_meet_nothing_before_it(flat):
    """Compare with random points of the disc, whose rays are intersected with every triangle of the membrane."""
    membrane, camera = flat
    nodes = hooded(membrane, membrane.mesh.flat)
    share = dots_shown(membrane, nodes, camera)
    design = membrane.design
    assert (np.histogram(share, (0.0, 0.05, 0.95, 1.01))[0] > (30, 20, 300)).all()
    cut = np.flatnonzero((share > 0.05) & (share < 0.95))[::4]
    some = np.concatenate([cut, np.flatnonzero(share == 0.0)[:2], np.flatnonzero(share == 1.0)[:2]])
    rng, grid = np.random.default_rng(0), dot_grid(design.width_m, design.height_m)
    for dot in some:
        radius, angle = DOT_RADIUS_M * np.sqrt(rng.uniform(size=60)), rng.uniform(0, 2 * np.pi, 60)
        places = grid[dot] + np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
        assert share[dot] == pytest.approx(shows(membrane, nodes, camera, places).mean(), abs=0.2)
    assert dots_shown(membrane, nodes + np.array((1.0, 0.0, 0.0)), camera).max() == 0.0  # beside the picture


def shows(membrane, nodes, camera, places):
    """Tell which places, (N, 2), of the flat sheet a camera sees (Moeller and Trumbore)."""
    triangles, eye = membrane.mesh.triangles, -camera.pose[:, :3].T @ camera.pose[:, 3]
    (a, b, c), corners = np.moveaxis(nodes[triangles], 1, 0), np.moveaxis(membrane.mesh.flat[triangles], 1, 0)[..., :2]
    away = np.cross(eye - a, b - a)
    seen = []
    for place in places:
        twice = [
            np.linalg.det(np.stack([corners[i] - place, corners[j] - place], 1)) for i, j in ((1, 2), (2, 0), (0, 1))
        ]
        shares = np.array(twice) / sum(twice)
        own = int(np.argmax(shares.min(axis=0)))
        ray = shares[:, own] @ nodes[triangles[own]] - eye
        across = np.cross(ray, c - a)
        det = ((b - a) * across).sum(axis=1)
        met = det != 0.0
        det = np.where(met, det, 1.0)
        u, v = ((eye - a) * across).sum(axis=1) / det, away @ ray / det
        reach = ((c - a) * away).sum(axis=1) / det
        seen.append(not (met & (u >= 0) & (v >= 0) & (u + v <= 1) & (reach > 0) & (reach < 1 - 1e-5)).any())
    return np.array(seen)


def test_a_simulated_frame_tells_its_strain():
    with open_source(LOW) as source:
        facts, strain = source.facts(0), source.next_frame().truth.strain
    assert (strain.largest, strain.length, strain.width) == (facts.max_strain, facts.strain_length, facts.strain_width)
    assert 0.0 < strain.length_seen <= strain.length < strain.largest


def cell(press, side="", group="main", **strain):
    return TableCell("straight", "cup", "cup", press, side, group, f"sim:cup?press={press}", 0, rmse_mm=1.0, **strain)


def test_the_table_reports_the_strain_of_each_scene_once(tmp_path):
    known = {"max_strain": 0.284, "strain_length": 0.2, "strain_width": 0.227}
    table = Table(
        [
            cell("medium", **known),
            replace(cell("medium", **known), method="fusion-rigid"),
            cell("high", "left", max_strain=1.27, strain_length=0.86, strain_width=0.7),
            cell("2", group="hover", max_strain=0.3, strain_length=0.1, strain_width=0.1),
            cell("low"),
        ]
    )
    scenes = [(it["scene"], it["press"], it["side"], it["largest"]) for it in scene_strains(table)]
    assert scenes == [("cup", "medium", "", 0.284), ("cup", "high", "left", 1.27)]
    assert table_as_json(table)["strain"] == scene_strains(table)
    lines = table_as_text(table).splitlines()
    start = next(number for number, line in enumerate(lines) if line.startswith("largest in-plane strain"))
    assert [line.split() for line in lines[start + 1 : start + 3]] == [
        ["cup", "medium", "20", "23", "28"],
        ["cup", "high", "left", "86", "70", "127"],
    ]
    write_csv(tmp_path / "table.csv", [asdict(cell) for cell in table.cells])
    rows = list(csv.DictReader((tmp_path / "table.csv").read_text().splitlines()))
    assert rows[0]["max_strain"] == "0.284"
    assert rows[-1]["max_strain"] == ""
    assert "largest in-plane strain" not in table_as_text(Table([cell("low")]))


def test_run_reports_the_true_strain(tactune):
    def run(*words):
        done = tactune("run", "-s", LOW, "-p", "simulator", "-n", 1, "--truth", *words)
        assert done.status == 0
        return done.out

    with open_source(LOW) as source:
        strain = source.next_frame().truth.strain
    record = json.loads(run("--json"))
    assert record["true_strain_length_percent"] == pytest.approx(100 * strain.length, abs=0.01)
    assert record["true_max_strain_percent"] == pytest.approx(100 * strain.largest, abs=0.01)
    assert f"true strain up to {100 * strain.length:.1f} % along the length" in run()
