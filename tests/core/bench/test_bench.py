"""The benchmark: exact engines agree, slower engines take longer, shortfalls are found."""

from __future__ import annotations

import json
import math
import subprocess
import sys
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactune.core.bench import gate, run
from tactune.core.bench.gate import Check, least_bytes
from tactune.core.bench.measure import (
    OURS,
    bandwidth_bytes_per_s,
    import_seconds,
    peak_bytes,
    time_in_turns,
)
from tactune.core.bench.registry import Job, engines, find_engine
from tactune.core.bench.report import BenchReport, draw_pareto, draw_sensors, write_report
from tactune.core.bench.run import compare_engines, expected_mask, rows_as_json, rows_as_text
from tactune.core.bench.scenes import BenchScene, make_scene, scene_names, synthetic_scene
from tactune.core.bench.sensors import sensor_timings, timings_as_text
from tactune.core.bench.stability import LongRunReport, check_stability
from tactune.core.errors import TactuneError
from tactune.core.evaluation.table_cell import TableCell

# Importing it takes 2 s in every test process that collects this file.
pytestmark = [
    pytest.mark.skipif(find_spec("open3d") is None, reason="needs the extra bench"),
    pytest.mark.filterwarnings("ignore:Open3D was built with CUDA:ImportWarning"),
]


def allocated_bytes(run: Callable[[], Any], calls: int = 5) -> int:
    """Return the peak rise of traced Python and NumPy memory during one call, after ``calls`` warm-up calls."""
    for _ in range(calls):
        run()
    tracemalloc.start()
    try:
        run()
        tracemalloc.reset_peak()
        before, _ = tracemalloc.get_traced_memory()
        run()
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    return peak - before


@pytest.fixture(scope="module")
def scene() -> BenchScene:
    return replace(synthetic_scene(3000, 160, 120), name="small")


def test_exact_engines_agree_with_the_float64_reference(scene: BenchScene) -> None:
    checked = 0
    for found in engines():
        if found.exact and not found.missing:
            mask = found.make(scene)().mask
            assert np.array_equal(mask, expected_mask(scene, found.job)), found.name
            checked += 1
    assert checked >= 6


def test_a_slower_engine_takes_longer() -> None:
    timings = time_in_turns({"fast": lambda: None, "slow": lambda: time.sleep(0.003)}, 5)
    assert timings["slow"].median_ms >= 3.0
    assert timings["slow"].median_ms > 10 * timings["fast"].median_ms
    assert timings["fast"].lower_ms <= timings["fast"].median_ms <= timings["fast"].upper_ms
    assert timings["slow"].calls >= 5


def test_memory_is_seen() -> None:
    kept: list[np.ndarray] = []

    def wasteful() -> None:
        kept[:] = [np.ones(8 << 20)]

    peak = peak_bytes(wasteful)
    assert peak is None or peak >= 30 << 20


def test_the_pipeline_allocates_little_but_its_result(scene: BenchScene) -> None:
    runner = find_engine("tactune").make(scene)
    points = runner().points
    assert points is not None
    image = scene.frame.proximity_depth.size
    assert allocated_bytes(runner) < 4 * points.nbytes + image


def test_rows_are_told_as_text_and_json() -> None:
    rows = compare_engines(["empty"], [Job.PIPELINE], rounds=3, only=["tactune", "copy-depths"])
    assert [row.engine for row in rows] == ["reference", "tactune", "copy-depths"]
    assert rows[0].ratio == 1.0
    assert all(row.differing_px == 0 for row in rows)
    text = rows_as_text(rows)
    assert "empty, pipeline" in text
    assert "copy-depths" in text
    record = rows_as_json(rows)[1]
    assert record["rmse_mm"] is None
    assert json.loads(json.dumps(record, allow_nan=False))["engine"] == "tactune"


def test_unknown_names_are_refused() -> None:
    with pytest.raises(TactuneError, match="no scene 'nowhere'"):
        make_scene("nowhere")
    with pytest.raises(TactuneError, match="no engine 'magic'"):
        compare_engines(["empty"], [Job.PIPELINE], only=["magic"])
    assert "empty" in scene_names()


def test_a_check_that_falls_short_says_so() -> None:
    assert str(Check("speed", 5.9, 6)).startswith("SHORT speed: 5.90 (must be >= 6)")
    assert Check("speed", 6.0, 6).holds
    assert not Check("pixels", 1, 0, at_least=False).holds
    assert not Check("nothing measured", math.nan, 6).holds


def test_the_gate_finds_a_slow_pipeline(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the ratio of the baseline in place of ours, 1, the gate must fail."""
    monkeypatch.setattr(gate, "compare_engines", lambda *args, **kwargs: _slowed(run.compare_engines(*args, **kwargs)))
    checks = gate.whole_pipeline(3, ["empty"])
    assert [check.holds for check in checks] == [False, True]


def _slowed(rows: list[run.Row]) -> list[run.Row]:
    return [replace(row, ratio=rows[0].ratio) for row in rows]


def test_the_roofline_counts_each_byte_once(scene: BenchScene) -> None:
    pixels = 160 * 120
    assert least_bytes(scene, 100, 90) == 2 * 2 * pixels + pixels + 90 * 12 + 100 * 3
    assert bandwidth_bytes_per_s(8 << 20) > 1e8


def test_the_figure_is_written(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    measured = compare_engines(["empty"], [Job.PIPELINE], rounds=3, only=["tactune-no-outliers"])
    rows = [replace(row, rmse_mm=1.0 + number) for number, row in enumerate(measured)]
    written = draw_pareto(rows, tmp_path)
    assert [path.name for path in written] == ["run-time-against-error.png", "run-time-against-error.svg"]
    assert all(path.stat().st_size > 5000 for path in written)
    assert draw_pareto(measured, tmp_path / "none") == [], "an empty scene has no error to draw"


def test_contact_tests_are_drawn_for_each_sensor(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")

    def cell(sensor: str, method: str, seed: int, rmse_mm: float | None, ms: float) -> TableCell:
        failure = "" if rmse_mm else "it failed"
        return TableCell(
            method, "cup", "cup", "low", "", "main", "sim", seed, rmse_mm=rmse_mm, ms=ms, failure=failure, sensor=sensor
        )

    methods = ("straight", "tolerance-0.008", "tolerance-0.010", "fusion-membrane")
    cells = [cell(sensor, method, seed, 1.0 + seed, 5.0 + 2 * seed)
             for sensor in ("clean", "heavy") for method in methods for seed in (0, 1)]  # fmt: skip
    timings = sensor_timings([*cells, cell("heavy", "fusion-averaged", 0, None, 1.0)])
    assert [(it.sensor, it.test) for it in timings] == [
        (sensor, test) for sensor in ("clean", "heavy") for test in ("tolerance", "tolerance", "membrane")
    ]
    assert all((it.ms, it.rmse_mm) == (6.0, 1.5) for it in timings)
    assert len(timings_as_text(timings).splitlines()) == 7
    assert [path.name for path in draw_sensors(timings, tmp_path)] == ["sensors.png", "sensors.svg"]
    assert draw_sensors([], tmp_path / "none") == []


def test_the_page_holds_every_part(tmp_path: Path) -> None:
    rows = compare_engines(["empty"], [Job.PIPELINE], rounds=3, only=["tactune"])
    report = BenchReport(
        machine="a machine",
        checks=[Check("speed", 5.0, 6)],
        rows=rows,
        stability=check_stability(2),
        long_run=LongRunReport(5, 0),
    )
    page = tmp_path / "docs" / "benchmarks.md"
    write_report(report, page, [tmp_path / "docs" / "images" / "bench" / "engines.png"])
    text = page.read_text()
    assert "SHORT speed: 5.00" in text
    assert "![engines](images/bench/engines.png)" in text
    assert "5 changes of parameters" in text
    assert "a machine" in text


def test_imports_are_timed_in_processes_of_their_own() -> None:
    slow, quick = import_seconds(("time.sleep(0.2)", "pass"), 3)
    assert slow > 0.2 > quick


def test_the_pipeline_imports_no_large_library_before_it_needs_one() -> None:
    large = {"scipy.spatial", "scipy.ndimage", "cv2", "open3d", "matplotlib"}
    program = f"import sys; {OURS}; print(sorted({large} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    assert done.stdout == "[]\n"
