"""The table of methods: its plan, cells on the simulator, what is stored, and averages by hand."""

from dataclasses import replace

import pytest

from tactune.core.errors import TactuneError
from tactune.core.lab import table
from tactune.core.lab.table import BEST_T, Cell, mean_rmse_mm, measure_table, plan_table, table_methods, table_text
from tactune.core.preset import Preset
from tactune.core.sources.presets import load_preset
from tactune.core.sources.simulator.scenes import MEMBRANES
from tactune.core.sources.simulator.sensors import SENSORS

METHODS = ("straight", "best-t", "fusion-membrane", "proximity-only")


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    work = tmp_path_factory.mktemp("table")
    return plan_table(
        load_preset("simulator"), work, methods=METHODS, objects=("cup",), presses=("medium",), membranes=("standard",),
        seeds=1,
    )  # fmt: skip


@pytest.fixture(scope="module")
def cells(plan):
    return [cell for cells in measure_table(plan, 1) for cell in cells]


def test_every_method_has_a_cell_and_the_membrane_test_is_best(plan, cells):
    assert [cell.method for cell in cells] == list(METHODS)
    rmse = {cell.method: cell.rmse_mm for cell in cells}
    assert rmse["fusion-membrane"] < rmse["best-t"] < rmse["straight"]
    assert all(cell.failure == "" and cell.points > 1000 and 0 < cell.iou < 1 for cell in cells)
    assert {cell.true_mm2 for cell in cells} == {cells[0].true_mm2} != {0.0}


def test_stored_cells_are_not_measured_again_unless_another_method_is_asked_for(plan, cells, monkeypatch):
    def refuse(name):
        raise TactuneError(f"{name} was opened")

    monkeypatch.setattr(table, "open_source", refuse)
    assert [cell for found in measure_table(plan, 1) for cell in found] == cells
    assert list(measure_table(replace(plan, methods=METHODS[:1]), 1)) == [cells[:1]]
    for other in (
        replace(plan, methods=(*METHODS, "tactile-only")),
        replace(plan, seeds=(1,)),
        replace(plan, preset=plan.preset.with_value("tolerance.t", 0.011)),
    ):
        with pytest.raises(TactuneError, match="was opened"):
            next(measure_table(other, 1))
    for file in plan.work.iterdir():
        damaged = replace(plan, work=plan.work.parent / "damaged")
        damaged.work.mkdir(exist_ok=True)
        (damaged.work / file.name).write_text(file.read_text()[:-9])
    with pytest.raises(TactuneError, match="was opened"):
        next(measure_table(damaged, 1))


def test_a_plan_holds_what_methods_are_developed_on_or_what_is_held_out(tmp_path):
    plan = plan_table(Preset(), tmp_path)
    known = {name for name in MEMBRANES if name != "held-membrane"}
    assert {scene.membrane for scene in plan.scenes} == known
    assert len(plan.scenes) == len(known) * 3 * 4 and plan.seeds == (0, 1) and plan.methods == table_methods()
    held = plan_table(Preset(), tmp_path, sensors=(), held_out=True, seeds=3)
    assert {scene.sensor for scene in held.scenes} == {name for name, entry in SENSORS.items() if entry.held_out}
    assert {scene.object for scene in held.scenes}.isdisjoint(table.OBJECTS) and held.seeds == (100, 101, 102)


def cell(rmse_mm, **more):
    return Cell(
        **{"sensor": "a", "membrane": "m", "object": "cup", "press": "low", "side": "", "seed": 0, "method": "straight"}
        | more, rmse_mm=rmse_mm,
    )  # fmt: skip


def test_averages_are_over_sides_then_objects_then_seeds_then_membranes():
    cells = [
        cell(1.0, side="left"), cell(3.0, side="right"), cell(4.0, object="cube"), cell(None, object="octopus"),
        cell(5.0, seed=1), cell(10.0, membrane="n"),
    ]  # fmt: skip
    assert mean_rmse_mm(cells) == pytest.approx((((2 + 4) / 2 + 5) / 2 + 10) / 2)


def test_the_text_tells_missing_patches():
    cells = [
        cell(1.0, method="fusion-membrane", iou=0.8), cell(0.5, method=BEST_T),
        cell(None, object="cube", method="fusion-membrane", failure=table.NO_CONTACT_FOUND, true_mm2=500.0),
        cell(None, object="cube", method="mechanics", failure="it gave up", true_mm2=500.0),
    ]  # fmt: skip
    text = table_text(cells, {("a", "fusion-membrane", "low"): 3.14})
    line = next(line for line in text.splitlines() if "fusion-membrane" in line)
    assert line.split() == ["a", "fusion-membrane", "1.00", "0.40", "-", "1", "3.1"]
    assert "mechanics: it gave up" in text
