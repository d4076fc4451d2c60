"""How a trial is measured: frames, truth, shared steps, times, failures."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import pytest

from tactune.core.contact.kernels.threads import get_threads
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.errors import TactuneError
from tactune.core.evaluation.metrics import compare_with_truth
from tactune.core.evaluation.table_cell import code_version
from tactune.core.sources.folder import FolderSource
from tactune.core.sources.presets import load_preset
from tactune.core.tuning.clips import ALL_FRAMES, FrameRange, inspect_clips, parse_frames
from tactune.core.tuning.measure import Batch, measure_batch

BASE = load_preset("default").with_value("contact_test", "tolerance")


def batch_of(*sources: str, trials: list[dict[str, object]], timed: bool = True, frames=ALL_FRAMES) -> Batch:
    clips = tuple(inspect_clips(sources, frames, BASE))
    return Batch(BASE, clips, code_version(), tuple(trials), timed)


def test_figures_are_means_over_frames_and_then_over_sources(make_recording, tmp_path):
    names = make_recording("one"), make_recording("other", seed=5, frames=2)
    (found,) = measure_batch(batch_of(*names, trials=[{"tolerance.t": 0.007}]))
    means: dict[str, list[float]] = {"iou": [], "rmse_mm": [], "points": []}
    for name in ("one", "other"):
        source = FolderSource(tmp_path / name)
        pipeline = ContactPipeline(BASE.with_value("tolerance.t", 0.007), source.rig)
        patches = [(pipeline.process(frame), frame) for frame in source]
        scores = [compare_with_truth(patch, frame.truth, source.rig) for patch, frame in patches]
        for figure in ("iou", "rmse_mm"):
            means[figure].append(sum(score[figure] for score in scores) / len(scores))
        means["points"].append(sum(len(patch.points) for patch, _ in patches) / len(patches))
    for figure, name in (("iou", "iou"), ("rmse_mm", "rmse"), ("points", "points")):
        assert found.figures[name] == pytest.approx(sum(means[figure]) / 2)
    assert found.figures["ms"] > 0 and found.figures["missed"] == 0 and 0 < found.figures["stability"] < 1


def test_trials_do_not_affect_each_other_whatever_their_order(recording):
    trials = [
        {"contact_test": test, "tolerance.t": t, "outliers.k": k, "membrane.frames": frames}
        for frames, test in ((1, "tolerance"), (1, "membrane"), (2, "membrane"))
        for k in (20, 5)
        for t in (0.01, 0.005)
    ]
    alone = [measure_batch(batch_of(recording, trials=[trial], timed=False))[0].figures for trial in trials]
    for figures in alone:
        figures.pop("ms", None)  # a trial that averages frames is timed anyway
    together = [found.figures for found in measure_batch(batch_of(recording, trials=trials))]
    for one, other in zip(alone, together, strict=True):
        assert one == {name: figure for name, figure in other.items() if name != "ms"}
    assert len({figures["points"] for figures in alone}) > 4


def test_steps_are_shared_but_a_time_is_that_of_all_steps(recording, monkeypatch):
    asked, original = [], ContactPipeline.process

    def process(self, frame):
        patch = original(self, frame)
        asked.append(patch.stage_ms)
        return patch

    monkeypatch.setattr(ContactPipeline, "process", process)
    trials = [{"outliers.min_cluster_area_mm2": float(area)} for area in range(31)]
    measure_batch(batch_of(recording, trials=trials, timed=False))
    computed = sum(ms["fusion"] > 0 for ms in asked)
    assert (len(asked), computed) == (3 * 31, 3), "one of 31 trials computes the first step"
    asked.clear()
    found = measure_batch(batch_of(recording, trials=trials))
    assert sum(ms["fusion"] > 0 for ms in asked) == 3 + 3 * 5 * 31, "each is timed on five frames, three times"
    assert all(trial.figures["ms"] > 0 for trial in found)


@pytest.mark.parametrize("step_ms", [50.0, 0.0])
def test_time_in_which_others_have_the_processor_counts_neither_within_nor_between_steps(
    recording, monkeypatch, step_ms
):
    original = ContactPipeline.process

    def process(self, frame):
        patch = original(self, frame)
        time.sleep(0.05)  # as if another process had the processor
        return patch.again(patch.sequence, dict.fromkeys(patch.stage_ms, step_ms), ())

    monkeypatch.setattr(ContactPipeline, "process", process)
    (found,) = measure_batch(batch_of(recording, trials=[{}]))
    assert 0 < found.figures["ms"] < 0.5 * 150


def test_finding_nothing_never_pays(recording):
    hidden = {"range.enabled": True, "range.limits_m": [1, 2]}
    bad = {"tolerance.t": 0.2}
    nothing, much = measure_batch(batch_of(recording, trials=[hidden, bad]))
    assert (nothing.figures["points"], nothing.figures["missed"], nothing.figures["iou"]) == (0, 3, 0)
    assert nothing.figures["rmse"] > much.figures["rmse"] > 0


def test_without_truth_no_error_is_claimed(make_recording):
    (found,) = measure_batch(batch_of(make_recording(with_truth=False), trials=[{}]))
    assert set(found.figures) == {"ms", "points", "area", "stability"}


def test_values_that_cannot_be_used_are_a_failure_of_their_trial_alone(recording):
    wrong, right = measure_batch(batch_of(recording, trials=[{"range.limits_m": [2, 1]}, {}]))
    assert "near limit" in wrong.failure and right.failure == ""


def test_a_worker_refuses_other_frames_and_other_code_and_leaves_the_callers_threads(recording):
    batch, before = batch_of(recording, trials=[{}]), get_threads()
    with pytest.raises(TactuneError, match="another version of Tactune"):
        measure_batch(replace(batch, code="older"))
    with pytest.raises(TactuneError, match="other frames"):
        measure_batch(replace(batch, clips=(replace(batch.clips[0], identity="0"),)))
    assert get_threads() == before


def test_a_clip_is_known_by_its_content(make_recording):
    rec, other = make_recording(), make_recording("other", seed=1)

    def identity(source: str, frames: FrameRange = ALL_FRAMES) -> str:
        return inspect_clips([source], frames, BASE)[0].identity

    first = identity(rec)
    assert identity(rec) == first
    assert len({first, identity(other), identity(rec, FrameRange(0, 2))}) == 3
    image = Path(rec.removeprefix("folder:")) / "000002" / "tactile_depth.png"
    image.write_bytes((Path(other.removeprefix("folder:")) / "000002" / "proximity_depth.png").read_bytes())
    assert identity(rec) != first


def test_frames_as_people_write_them():
    assert [list(parse_frames(text).indices(6)) for text in ("2", "1:4", "::2", "4:", ":9")] == [
        [0, 1], [1, 2, 3], [0, 2, 4], [4, 5], [0, 1, 2, 3, 4, 5],
    ]  # fmt: skip
    for text in ("0", "4:2", "a", "1:2:0", "-1", ""):
        with pytest.raises(TactuneError, match="frames"):
            parse_frames(text)
