"""How a trial is measured: frames, truth, shared steps, times, failures."""

import time

import numpy as np
import pytest

from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.model.metrics import compare_with_truth
from tactune.core.sources.folder import FolderSource
from tactune.core.sources.presets import load_preset
from tactune.core.tuning.measure import measure
from tactune.core.tuning.plan import make_plan

BASE = load_preset("default").with_value("contact_test", "tolerance")


def plan_of(*sources):
    return make_plan(BASE, [], sources, objectives=["stability", "ms"])


def figures_of(plan, *trials):
    """Measure trials whose parameters can be used."""
    measured = measure(plan, trials)
    assert not any(failure for _, failure in measured)
    return [figures for figures, _ in measured]


def test_figures_are_means_over_frames_and_then_over_sources(make_recording, tmp_path):
    names = make_recording("one"), make_recording("other", seed=5, frames=2)
    (found,) = figures_of(plan_of(*names), {"tolerance.t": 0.007})
    means = {"iou": [], "rmse_mm": [], "points": []}
    for name in ("one", "other"):
        source = FolderSource(tmp_path / name)
        pipeline = ContactPipeline(BASE.with_value("tolerance.t", 0.007), source.rig)
        patches = [(pipeline.process(frame), frame) for frame in source]
        scores = [compare_with_truth(patch, frame.truth, source.rig) for patch, frame in patches]
        for figure in ("iou", "rmse_mm"):
            means[figure].append(np.nanmean([score[figure] for score in scores]))
        means["points"].append(sum(len(patch.points) for patch, _ in patches) / len(patches))
    for figure, name in (("iou", "iou"), ("rmse_mm", "rmse"), ("points", "points")):
        assert found[name] == pytest.approx(sum(means[figure]) / 2)
    assert found["ms"] > 0 and 0 < found["stability"] < 1


def test_trials_do_not_affect_each_other_whatever_their_order(recording):
    trials = [
        {"contact_test": test, "tolerance.t": t, "outliers.k": k, "membrane.frames": frames}
        for frames, test in ((1, "tolerance"), (1, "membrane"), (2, "membrane"))
        for k in (20, 5)
        for t in (0.01, 0.005)
    ]
    alone = [figures_of(plan_of(recording), trial)[0] for trial in trials]
    together = figures_of(plan_of(recording), *trials)
    for figures in (*alone, *together):
        assert figures.pop("ms") > 0
    assert alone == together
    assert len({figures["points"] for figures in alone}) > 4


def test_time_in_which_others_have_the_processor_does_not_count(recording, monkeypatch):
    original = ContactPipeline.process

    def process(self, frame):
        patch = original(self, frame)
        time.sleep(0.2)  # as if another process had the processor
        return patch

    monkeypatch.setattr(ContactPipeline, "process", process)
    (found,) = figures_of(plan_of(recording), {})
    assert 0 < found["ms"] < 0.5 * 200


def test_finding_nothing_never_pays(recording):
    hidden = {"range.enabled": True, "range.limits_m": [1, 2]}
    bad = {"tolerance.t": 0.2}
    nothing, much = figures_of(plan_of(recording), hidden, bad)
    assert (nothing["points"], nothing["iou"]) == (0, 0)
    assert nothing["rmse"] > much["rmse"] > 0


def test_values_that_cannot_be_used_are_a_failure_of_their_trial_alone(recording):
    (_, wrong), (_, right) = measure(plan_of(recording), [{"range.limits_m": [2, 1]}, {}])
    assert "near limit" in wrong and right == ""
