"""Plans and runs: measures, keys, the order of work, and the journal."""

from __future__ import annotations

import itertools
import json
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from queue import SimpleQueue
from threading import Event, get_ident

import cv2
import pytest

from tactune.core.contact.kernels.threads import get_threads
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.errors import ExportError, TactuneError
from tactune.core.evaluation.metrics import compare_with_truth
from tactune.core.methods.registry import make_method
from tactune.core.preset import Preset
from tactune.core.sources.folder import FolderSource
from tactune.core.tuning.clips import FrameRange, parse_frames, seeded
from tactune.core.tuning.plan import STAGE_OF, Plan, Request, make_plan
from tactune.core.tuning.results import Result
from tactune.core.tuning.run import run_batch
from tactune.core.tuning.sweep import Journal, measure_sweep
from tactune.core.tuning.values import parse_axis, result_paths

BASE = Preset(contact_test="tolerance")


def plan_of(*sources: str, sets: tuple[str, ...] = ("tolerance.t=0.004,0.008",), base: Preset = BASE, **more) -> Plan:
    return make_plan(base, Request(tuple(map(parse_axis, sets)), sources, **more))


def engine(batches):
    return map(run_batch, batches)


def measure(plan: Plan, path: Path) -> dict[str, Result]:
    with Journal(path) as journal:
        for _ in measure_sweep(plan, journal, engine, workers=2):
            pass
        return {run.key: journal[run.key] for run in plan.runs}


def test_a_run_measures_what_the_pipeline_and_the_metrics_say(make_recording, tmp_path):
    rec = make_recording()
    sets = ("tolerance.t=0.004,0.008", "outliers.k=5,20", "outliers.min_cluster_area_mm2=0,40")
    plan = plan_of(rec, sets=sets)
    results = measure(plan, tmp_path / "j")
    source = FolderSource(tmp_path / "rec")
    for run in plan.runs:
        pipeline = ContactPipeline(BASE.with_values(run.setting.values), source.rig)
        patches = [(frame, pipeline.process(frame)) for frame in map(source.read, range(3))]
        scores = [compare_with_truth(patch, frame.truth, source.rig) for frame, patch in patches]
        found = results[run.key]
        for name in ("rmse_mm", "iou", "precision", "recall"):
            assert getattr(found, name) == pytest.approx(sum(score[name] for score in scores) / 3, rel=1e-9), name
        assert found.points == pytest.approx(sum(len(patch.points) for _, patch in patches) / 3)
        assert found.area_mm2 == pytest.approx(sum(patch.area_mm2 for _, patch in patches) / 3, rel=1e-6)
        masks = [patch.mask for _, patch in patches]
        steady = [(a & b).sum() / (a | b).sum() for a, b in itertools.pairwise(masks)]
        assert found.stability == pytest.approx(sum(steady) / 2)
        assert (found.frames, found.missed, found.failure) == (3, 0, "")
        assert found.ms > 0
    assert len({result.iou for result in results.values()}) > 2, "the parameters make a difference"


def test_a_remembered_stage_costs_what_it_cost(recording, tmp_path, monkeypatch):
    """Times of runs that share a stage with the run before them are not less by that stage."""
    asked = []
    original = ContactPipeline.process

    def process(self, frame):
        patch = original(self, frame)
        asked.append(patch.stage_ms)
        return patch.again(patch.sequence, {stage: 7.0 * (ms > 0) for stage, ms in patch.stage_ms.items()}, ())

    monkeypatch.setattr(ContactPipeline, "process", process)
    results = measure(plan_of(recording, sets=("outliers.min_cluster_area_mm2=0:30:31",)), tmp_path / "j")
    assert any(ms["fusion"] == 0 for ms in asked), "stages are remembered"
    assert {result.ms for result in results.values()} == {21.0}


def test_other_methods_are_run_as_they_are(recording, tmp_path):
    plan = plan_of(recording, sets=(), methods=("fusion-homography", "fusion", "mechanics"))
    homography, fusion, mechanics = (
        measure(plan, tmp_path / "j")[next(run.key for run in plan.runs if run.setting.method == name)]
        for name in ("fusion-homography", "fusion", "mechanics")
    )
    source = FolderSource(tmp_path / "rec")
    method = make_method("fusion-homography", BASE, source.rig)
    assert homography.points == pytest.approx(sum(len(method.find(source.read(i)).points) for i in range(3)) / 3)
    assert fusion.failure == ""
    assert "untouched" in mechanics.failure and mechanics.rmse_mm is None


def test_without_truth_no_error_is_claimed(make_recording, tmp_path):
    plan = plan_of(make_recording(with_truth=False))
    assert not plan.has_truth
    for result in measure(plan, tmp_path / "j").values():
        assert (result.rmse_mm, result.iou, result.area_error_mm2, result.missed) == (None, None, None, 0)
        assert result.stability is not None and result.area_mm2 > 0


def test_missed_contact_is_counted_and_finding_nothing_is_not_steady(recording, tmp_path):
    (result,) = measure(plan_of(recording, sets=("tolerance.t=0",)), tmp_path / "j").values()
    if result.points == 0:
        assert (result.missed, result.stability, result.rmse_mm) == (3, None, None)
    (result,) = measure(
        plan_of(recording, sets=("range.limits_m=[1,2]", "range.enabled=true")), tmp_path / "j"
    ).values()
    assert (result.points, result.missed, result.stability, result.rmse_mm, result.iou) == (0, 3, None, None, 0)


def test_a_key_stands_for_all_that_the_result_depends_on(make_recording):
    rec, other = make_recording(), make_recording("other", seed=1)
    one = {"sets": ("tolerance.t=0.02",)}

    def key(plan: Plan) -> str:
        (run,) = plan.runs
        return run.key

    first = key(plan_of(rec, **one))
    assert key(plan_of(rec, **one)) == first
    assert (
        key(plan_of(rec, sets=(), base=BASE.with_values({"tolerance.t": 0.02, "name": "else", "notes": "x"}))) == first
    )
    assert key(plan_of(other, **one)) != first
    assert key(plan_of(rec, frames=FrameRange(0, 2), **one)) != first
    assert key(plan_of(rec, methods=("fusion-rigid",), **one)) != first
    assert key(plan_of(rec, sets=("tolerance.t=0.02", "outliers.k=21"))) != first
    assert key(replace(plan_of(rec, **one), code="other")) != first
    image = Path(rec.removeprefix("folder:")) / "000002" / "tactile_depth.png"
    image.write_bytes((Path(other.removeprefix("folder:")) / "000002" / "proximity_depth.png").read_bytes())
    assert key(plan_of(rec, **one)) != first, "the recording was changed"


def test_late_stages_vary_fastest_and_batches_keep_to_one_take(make_recording):
    sets = ("outliers.min_cluster_area_mm2=0,40", "tolerance.t=0.02,0.01", "outliers.k=5,20")
    plan = plan_of(make_recording(), make_recording("other"), sets=sets)
    values = [tuple(run.setting.values[axis.partition("=")[0]] for axis in sets) for run in plan.runs[:8]]
    assert values[:4] == [(0.0, 0.02, 5), (40.0, 0.02, 5), (0.0, 0.02, 20), (40.0, 0.02, 20)]
    batches = list(plan.batches(lambda key: key == plan.runs[0].key, workers=1))
    assert [key for batch in batches for key, _, _ in batch.runs] == [run.key for run in plan.runs[1:]]
    assert all(batch.clip in plan.clips for batch in batches)
    assert len({batch.name for batch in batches}) == len(batches)


def test_a_batch_holds_few_methods_at_once(make_recording):
    plan = plan_of(make_recording(), sets=("outliers.k=1:400:400",))
    assert max(len(batch.runs) for batch in plan.batches(lambda key: False, workers=1)) == 50


def test_stages_are_named_of_fields_that_there_are():
    assert set(STAGE_OF) <= set(result_paths())


def test_both_contact_tests_in_one_sweep(recording, tmp_path):
    plan = plan_of(recording, sets=("contact_test=tolerance,membrane", "membrane.gap_m=0.001,0.002"))
    source = FolderSource(tmp_path / "rec")
    for key, found in measure(plan, tmp_path / "j").items():
        values = next(run.setting.values for run in plan.runs if run.key == key)
        pipeline = ContactPipeline(BASE.with_values(values), source.rig)
        assert found.points == pytest.approx(sum(len(pipeline.process(source.read(i)).points) for i in range(3)) / 3)


def test_only_what_is_missing_is_run_again(recording, tmp_path):
    plan = plan_of(recording, sets=("outliers.k=5:24:20",))
    with Journal(tmp_path / "j") as journal:
        steps = measure_sweep(plan, journal, engine, workers=1)
        assert [next(steps), next(steps)] == [0, 5]
        steps.close()
    begun = []

    def counting(batches):
        for batch in batches:
            begun.extend(key for key, _, _ in batch.runs)
            yield run_batch(batch)

    with Journal(tmp_path / "j") as journal:
        assert list(measure_sweep(plan, journal, counting, workers=1)) == [5, 9, 13, 17, 20]
    assert sorted(begun) == sorted(run.key for run in plan.runs[5:])


def test_a_journal_survives_a_torn_line_and_a_damaged_one(tmp_path):
    path = tmp_path / "j"
    with Journal(path) as journal:
        journal.add([Result("a", rmse_mm=0.1 + 0.2), Result("b", failure="no"), Result("a", rmse_mm=9.0)])
        journal.add([Result("a", rmse_mm=9.0), Result("c")])
    whole = path.read_text()
    assert whole.count("\n") == 4
    path.write_text(whole.replace('"key": "b"', '"key": 7') + '{"key": "d", "rms')
    with Journal(path) as journal:
        assert journal["a"].rmse_mm == 0.1 + 0.2
        assert "c" in journal and "b" not in journal and "d" not in journal
        journal.add([Result("b")])
    assert all(json.loads(line) for line in path.read_text().splitlines())


def test_a_journal_is_for_one_sweep_at_a_time_and_for_nothing_else(tmp_path):
    with Journal(tmp_path / "j"), pytest.raises(TactuneError, match="another sweep"), Journal(tmp_path / "j"):
        pass
    (tmp_path / "notes").write_text("mine\n")
    with pytest.raises(TactuneError, match="is not a sweep journal"), Journal(tmp_path / "notes"):
        pass
    assert (tmp_path / "notes").read_text() == "mine\n"


@contextmanager
def files_of_at_most(size):
    """Let the system refuse to write beyond this size, as on a full disk."""
    resource = pytest.importorskip("resource", reason="this system has no limit for files")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("opened_before", [False, True])
def test_a_full_disk_is_told_with_the_journals_name(tmp_path, opened_before):
    path = tmp_path / "runs"
    if opened_before:
        with Journal(path):
            pass
    room = path.stat().st_size if opened_before else 0
    with files_of_at_most(room), pytest.raises(ExportError, match=r"cannot write .*runs"), Journal(path) as journal:
        assert opened_before
        journal.add([Result("0" * 32)])


def test_a_worker_refuses_other_frames_and_other_code(make_recording):
    rec = make_recording()
    (batch,) = plan_of(rec, sets=()).batches(lambda key: False, 1)
    with pytest.raises(TactuneError, match="another version of Tactune"):
        run_batch(replace(batch, code="older"))
    with pytest.raises(TactuneError, match="other frames"):
        run_batch(replace(batch, clip=replace(batch.clip, identity="0")))


def test_a_batch_uses_one_thread_and_leaves_the_callers_setting(recording, monkeypatch):
    during = []
    original = ContactPipeline.process
    monkeypatch.setattr(
        ContactPipeline, "process", lambda self, frame: (during.append(get_threads()), original(self, frame))[1]
    )
    before = get_threads()
    (batch,) = plan_of(recording, sets=()).batches(lambda key: False, 1)
    run_batch(batch)
    assert set(during[-3:]) == {1}
    assert get_threads() == before


def test_batches_at_once_leave_opencv_the_threads_that_it_had(recording, monkeypatch):
    original, waiting, may_end = ContactPipeline.process, SimpleQueue(), {}

    def process(self, frame):
        event = may_end.setdefault(get_ident(), Event())
        waiting.put(event)
        assert event.wait(60)
        return original(self, frame)

    monkeypatch.setattr(ContactPipeline, "process", process)
    (batch,) = plan_of(recording, sets=()).batches(lambda key: False, 1)
    before = cv2.getNumThreads()
    cv2.setNumThreads(2)
    try:
        with ThreadPoolExecutor(2) as pool:
            runs = {}
            for _ in range(2):
                run = pool.submit(run_batch, batch)
                runs[waiting.get(timeout=60)] = run
            for event, run in runs.items():
                assert cv2.getNumThreads() == 1
                event.set()
                run.result(60)
        assert cv2.getNumThreads() == 2
    finally:
        cv2.setNumThreads(before)


def test_frames_and_seeds_as_people_write_them():
    assert [list(parse_frames(text).indices(6)) for text in ("2", "1:4", "::2", "4:", ":9")] == [
        [0, 1], [1, 2, 3], [0, 2, 4], [4, 5], [0, 1, 2, 3, 4, 5],
    ]  # fmt: skip
    for text in ("0", "4:2", "a", "1:2:0", "-1", ""):
        with pytest.raises(TactuneError, match="frames"):
            parse_frames(text)
    assert seeded("sim:cup?press=low", 2) == [("sim:cup?press=low&seed=0", 0), ("sim:cup?press=low&seed=1", 1)]
    assert seeded("sim", 1) == [("sim:?seed=0", 0)]
    assert seeded("sim:cup?seed=7", 1) == [("sim:cup?seed=7", 7)]
    for source in ("sim:cup?seed=7", "live:sim:cup", "realsense:"):
        with pytest.raises(TactuneError):
            seeded(source, 2)
    ((name, seed),) = seeded("folder:here", 3)
    assert (name, seed) == (f"folder:{Path('here').absolute()}", 0)
