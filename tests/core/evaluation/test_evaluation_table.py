"""The table: cells, resuming, averages, text, JSON, CSV and figure, with cheap methods on a small scene."""

from __future__ import annotations

import csv
import itertools
import json
import math
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from urllib.parse import parse_qsl

import numpy as np
import pytest

from small_scene import RIG, SmallScene
from tactune.core.errors import ExportError, TactuneError
from tactune.core.evaluation.metrics import symmetric_rmse_m, truth_cloud
from tactune.core.evaluation.table import Table, TablePlan, average, measure_table
from tactune.core.evaluation.table_cell import (
    NO_CONTACT_FOUND,
    PlannedScene,
    TableCell,
    plan_scenes,
    table_cell_from_json,
)
from tactune.core.evaluation.table_report import check_plot, draw_patches, table_as_json, table_as_text
from tactune.core.methods.method import ContactMethod, MethodPatch, failed
from tactune.core.model.files import write_csv
from tactune.core.model.frames import SensorFrame
from tactune.core.preset import Preset
from tactune.core.rig.untouched import untouched_frame
from tactune.core.sources.registry import open_source
from tactune.core.sources.simulator.scenes import read_options, resolve_scene


class Shifted(ContactMethod):
    """Finds the truth moved by some millimetres towards the cameras."""

    def __init__(self, name: str, by_mm: float, calls: list[str]) -> None:
        self.name, self._by_mm, self._calls = name, by_mm, calls
        self._seen: set[int] = set()

    def find(self, frame: SensorFrame) -> MethodPatch:
        assert id(frame) not in self._seen, "a frame was timed twice"
        self._seen.add(id(frame))
        self._calls.append(self.name)
        if self.name == "mechanics":
            return failed((48, 64), "it did not converge")
        points = truth_cloud(frame.truth, RIG).points - np.float32([0, 0, self._by_mm / 1e3])
        if self.name == "tactile-only":
            return MethodPatch(points[:0], lambda: np.zeros((48, 64), bool))
        return MethodPatch(points, lambda: frame.truth.contact)


class Bench:
    """Counts how often methods and scenes are used."""

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.opened: list[str] = []

    def make(self, name, preset, rig, untouched):
        if name == "proximity-only":
            raise TactuneError("it lacks a lens")
        return Shifted(name, {"fusion-rigid": 1.0}.get(name, 4.0), self.calls)

    def open(self, name):
        self.opened.append(name)
        return SmallScene(name)

    def measure(self, plan):
        return measure_table(plan, self.make, self.open)


def plan(work: Path, methods=("straight", "fusion-rigid", "mechanics"), scenes=None, seeds=(0, 1), preset=None):
    scenes = plan_scenes(["cup"], ["medium", "high"], extra=False) if scenes is None else scenes
    return TablePlan(tuple(methods), tuple(scenes), tuple(seeds), preset or Preset(), work)


def test_each_cell_is_measured_against_the_truth(tmp_path):
    cells = list(Bench().measure(plan(tmp_path)))
    assert len(cells) == 3 * 3 * 2
    rigid = [cell for cell in cells if cell.method == "fusion-rigid"]
    truth = truth_cloud(SmallScene("x").read(0).truth, RIG).points
    expected = 1e3 * symmetric_rmse_m(truth - np.float32([0, 0, 1e-3]), truth)
    assert [cell.rmse_mm for cell in rigid] == pytest.approx([expected] * 6)
    assert all((cell.iou, cell.contacts, cell.true_contacts, cell.failure) == (1.0, 1, 1, "") for cell in rigid)
    assert all(cell.ms is not None and cell.ms >= 0 for cell in rigid)
    assert all(cell.area_error_mm2 == pytest.approx(15_000 * (0.299**2 / 0.3**2 - 1), rel=1e-3)
               for cell in rigid)  # fmt: skip


def test_failures_are_cells_with_a_reason(tmp_path):
    cells = list(Bench().measure(plan(tmp_path, ["mechanics", "proximity-only", "tactile-only"], seeds=[0])))
    reasons = {cell.method: cell.failure for cell in cells}
    assert reasons == {
        "mechanics": "it did not converge",
        "proximity-only": "it lacks a lens",
        "tactile-only": NO_CONTACT_FOUND,
    }
    assert all(cell.rmse_mm is None for cell in cells)
    text = table_as_text(Table(cells))
    assert "Fail" in text and "it did not converge" in text


def test_no_patch_where_nothing_touches_is_right(tmp_path):
    hover = [PlannedScene("hover", "cup", "5", group="hover")]
    (cell,) = Bench().measure(plan(tmp_path, ["tactile-only"], hover, [0]))
    assert (cell.failure, cell.points, cell.precision) == ("", 0, 1.0)


def test_an_interrupted_table_goes_on_without_repeating(tmp_path):
    first = Bench()
    done = list(itertools.islice(first.measure(plan(tmp_path)), 7))
    again = Bench()
    cells = list(again.measure(plan(tmp_path)))
    assert cells[:7] == done
    whole = Bench()
    list(whole.measure(plan(tmp_path / "new")))
    assert len(first.calls) + len(again.calls) == len(whole.calls)
    third = Bench()
    assert list(third.measure(plan(tmp_path))) == cells
    assert third.calls == [] and third.opened == []


def test_a_preset_s_name_and_dates_change_no_result(tmp_path):
    cells = list(Bench().measure(plan(tmp_path)))
    renamed = Preset(name="other", notes="later", modified=datetime(2030, 1, 1, tzinfo=UTC))
    again = Bench()
    assert list(again.measure(plan(tmp_path, preset=renamed))) == cells
    assert again.calls == []


def test_ctrl_c_in_a_method_keeps_what_was_done(tmp_path):
    class Interrupted(Bench):
        def make(self, name, preset, rig, untouched):
            if name == "mechanics":
                raise KeyboardInterrupt
            return super().make(name, preset, rig, untouched)

    got = []
    with pytest.raises(KeyboardInterrupt):
        for cell in Interrupted().measure(plan(tmp_path)):
            got.append(cell)  # noqa: PERF402  # the loop is interrupted
    assert [cell.method for cell in got] == ["straight", "fusion-rigid"]
    assert len(list(tmp_path.iterdir())) == 2
    again = Bench()
    list(again.measure(plan(tmp_path, seeds=[0], scenes=plan_scenes(["cup"], ["medium"], extra=False))))
    assert set(again.calls) == {"mechanics"}


def test_other_settings_and_damaged_cells_are_measured_anew(tmp_path):
    small = {"methods": ["fusion-rigid"], "scenes": plan_scenes(["cup"], ["low"], extra=False), "seeds": [0]}
    list(Bench().measure(plan(tmp_path, **small)))
    other = Bench()
    list(other.measure(plan(tmp_path, **small, preset=Preset().with_values({"tolerance.t": 0.02}))))
    assert other.calls
    for file in tmp_path.iterdir():
        file.write_text(file.read_text()[:-20])
    damaged = Bench()
    list(damaged.measure(plan(tmp_path, **small)))
    assert damaged.calls


def test_straight_is_the_papers_homography_and_tolerance(tmp_path):
    made = []

    class Noting(Bench):
        def make(self, name, preset, rig, untouched):
            made.append((name, preset.tolerance.t))
            return super().make(name, preset, rig, untouched)

    list(Noting().measure(plan(tmp_path, ["straight"], seeds=[0])))
    assert set(made) == {("fusion-homography", 0.03)}


def cell(rmse_mm, seed=0, side="", press="high", row="cup", failure=""):
    return TableCell("m", row, row, press, side, "main", "sim", seed, rmse_mm=rmse_mm, failure=failure)


def test_average_takes_sides_then_scenes_then_seeds():
    cells = [cell(1.0, side="left"), cell(3.0, side="right"), cell(5.0, row="cube")]
    assert average(cells, "rmse_mm").mean == 3.5
    assert math.isnan(average(cells, "rmse_mm").half_width)


def test_confidence_bounds_are_students():
    found = average([cell(value, seed) for seed, value in enumerate([1.0, 2.0, 3.0])], "rmse_mm")
    assert found.half_width == pytest.approx(4.302653 / math.sqrt(3), rel=1e-6)  # t of 2 degrees of freedom
    assert (found.low + found.high) / 2 == pytest.approx(2.0)


def test_failed_cells_are_left_out_and_counted():
    found = average([cell(1.0), cell(None, 1, failure="no")], "rmse_mm")
    assert (found.mean, found.failed, found.cells) == (1.0, 1, 2)


def test_csv_and_json_give_every_cell_back(tmp_path):
    table = Table(list(Bench().measure(plan(tmp_path / "work"))))
    document = json.loads(json.dumps(table_as_json(table), allow_nan=False))
    assert [table_cell_from_json(found) for found in document["cells"]] == table.cells
    assert document["averages"][0]["rmse_mm"]["mean"] == pytest.approx(
        average(table.pick("straight", "main", press="medium"), "rmse_mm").mean
    )
    write_csv(tmp_path / "table.csv", [asdict(cell) for cell in table.cells])
    with (tmp_path / "table.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(table.cells)
    for row, kept in zip(rows, table.cells, strict=True):
        assert (row["method"], row["press"], row["failure"]) == (kept.method, kept.press, kept.failure)
        assert (float(row["rmse_mm"]) if row["rmse_mm"] else None) == kept.rmse_mm


def test_text_stands_beside_the_papers_figures(tmp_path):
    text = table_as_text(Table(list(Bench().measure(plan(tmp_path)))))
    line = next(line for line in text.splitlines() if line.startswith("straight"))
    assert line.split()[-4:] == ["fusion", "2.33", "2.78", "70"]
    assert "boundary_px: mean distance between the outlines" in text
    assert "contacts right: share of" in text


def test_plan_has_both_sides_of_high_presses_and_keeps_held_out_objects_apart():
    high = [scene for scene in plan_scenes(extra=False) if scene.press == "high"]
    assert [scene.side for scene in high] == ["right", "left"] * 3
    assert {scene.object for scene in plan_scenes(["mug", "hand"], held_out=True)} == {"mug", "hand"}
    with pytest.raises(TactuneError, match="held-out"):
        plan_scenes(["mug"])
    with pytest.raises(TactuneError, match="no press 'hard'"):
        plan_scenes(presses=["hard"])


def test_every_planned_scene_is_one_of_the_simulators():
    for scene in [*plan_scenes(), *plan_scenes(["mug", "hand"], held_out=True)]:
        name, _, query = scene.source.removeprefix("sim:").partition("?")
        options = dict(parse_qsl(query))
        assert options.pop("sensor") == "datasheet"
        variant, _ = read_options(scene.source, options)
        assert resolve_scene(name, variant).frames


def test_figure_is_drawn_and_wrong_names_are_refused_first(tmp_path, monkeypatch):
    bench, captions = Bench(), []
    monkeypatch.setattr("matplotlib.figure.Figure.supxlabel", lambda figure, text, **looks: captions.append(text))
    scenes = plan_scenes(["cup"], ["medium", "high"], extra=False)
    draw_patches(
        tmp_path / "grid.png", ["fusion-rigid", "mechanics", "proximity-only"], scenes, Preset(), 0, bench.make,
        bench.open,
    )  # fmt: skip
    assert (tmp_path / "grid.png").read_bytes().startswith(b"\x89PNG")
    assert "in this one frame, with the noise of seed 0" in captions[0]
    with pytest.raises(ExportError, match="suffix"):
        check_plot(tmp_path / "grid.xyz")


def test_the_figure_shows_what_the_table_judges(tmp_path, monkeypatch):
    """A method that remembers is shown as many frames as it remembers; the last one's patch is drawn."""
    shown: dict[str, list[int]] = {}
    words: list[str] = []

    class Remembering(Shifted):
        def find(self, frame):
            shown.setdefault(self.name, []).append(frame.sequence)
            return super().find(frame) if frame.sequence == 5 else failed((48, 64), "it has seen too little")

    def make(name, preset, rig, untouched):
        method = Remembering(name, 1.0, [])
        method.remembers = 4 if name == "fusion-averaged" else 1
        return method

    monkeypatch.setattr("matplotlib.axes.Axes.text", lambda axis, x, y, text, **looks: words.append(text))
    scenes = plan_scenes(["cup"], ["medium"], extra=False)
    draw_patches(tmp_path / "grid.png", ["fusion-averaged", "fusion-rigid"], scenes, Preset(), 0, make, Bench().open)
    assert shown == {"fusion-averaged": [2, 3, 4, 5], "fusion-rigid": [5]}
    assert "Fail" not in words


def test_the_simulators_untouched_frame_is_a_measured_untouched_membrane():
    with open_source("sim:cup?press=medium&sensor=datasheet") as source:
        untouched, pressed = untouched_frame(source), source.read(0)
    assert untouched is not None and not untouched.truth
    depth = 1e-4 * untouched.tactile_depth[pressed.truth.contact].astype(float)
    moved = np.median(depth) - np.median(1e-4 * pressed.tactile_depth[pressed.truth.contact].astype(float))
    assert 0.010 < moved < 0.030, "a press of 24 mm moves the membrane towards the cameras"
