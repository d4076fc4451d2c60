"""Comparing methods on a frame: outcomes, times, colours and tooltips."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from colour_vision import EYES, nearest
from contrast import contrast_ratio
from fakes import tiny_frame, tiny_rig
from tactune.app.analysis import comparer
from tactune.app.analysis.comparer import Comparer, Task
from tactune.app.analysis.method_looks import FALSE_RGB, MISSED_RGB, RIGHT_RGB, TRUTH, method_rgb, method_tip
from tactune.app.worker.playback import PlaybackState
from tactune.app.worker.processing import FrameProcessor
from tactune.app.worker.results import SourceInfo, Wanted
from tactune.core.contact.membrane.average import AveragedDepth
from tactune.core.methods.fusion import Fusion
from tactune.core.methods.registry import make_method, method_names
from tactune.core.preset import Preset
from tactune.widgets.basics.colormaps import patch_lut
from tactune.widgets.basics.theme import theme_colors

METHODS = ("fusion-rigid", "fusion-homography", "fusion-membrane", "proximity-only", "tactile-only")
RIG = tiny_rig()
INFO = SourceInfo("tiny", RIG, 8, 30.0)
FRAMES = [tiny_frame(index, RIG) for index in range(4)]


@pytest.fixture
def made(monkeypatch) -> Counter:
    """How often each method was made."""
    counts: Counter = Counter()

    def make(name, *rest):
        counts[name] += 1
        return make_method(name, *rest)

    monkeypatch.setattr(comparer, "make_method", make)
    return counts


@pytest.fixture
def runs(monkeypatch) -> Counter:
    """How often each way of fusion was run."""
    counts: Counter = Counter()
    find = Fusion.find

    def counted(method, frame):
        counts[method.name] += 1
        return find(method, frame)

    monkeypatch.setattr(Fusion, "find", counted)
    return counts


def task(preset: Preset, index: int = 3) -> Task:
    frame = FRAMES[index]
    result = FrameProcessor().process(INFO, frame, preset, Wanted(), PlaybackState())
    return Task(result, METHODS, FRAMES[0])


def points(comparison) -> dict[str, int | None]:
    return {outcome.name: outcome.scores.points for outcome in comparison.outcomes}


def test_a_step_of_a_slider_runs_the_methods_that_it_concerns_once_and_no_others(preset, made, runs):
    compare = Comparer().compare
    before = compare(task(preset))
    assert made == Counter(METHODS)
    runs.clear()
    wider = preset.with_value("tolerance.t", 0.2)
    after = compare(task(wider))
    assert runs == Counter({"fusion-rigid": 1, "fusion-homography": 1})
    assert made == Counter(METHODS)
    assert points(after)["fusion-rigid"] == 64 * 48 > points(before)["fusion-rigid"]
    assert points(after)["fusion-membrane"] == points(before)["fusion-membrane"]
    runs.clear()
    compare(task(wider.with_value("membrane.gap_m", 0.003)))
    assert runs == Counter({"fusion-membrane": 1})
    compare(task(wider.with_value("membrane.gap_m", 0.003).with_value("notes", "the same membrane")))
    assert runs == Counter({"fusion-membrane": 1})


def test_the_time_after_a_step_is_that_of_a_whole_frame(preset, monkeypatch):
    asked = []
    find = Fusion.find
    monkeypatch.setattr(Fusion, "find", lambda method, frame: asked.append(frame) or find(method, frame))
    compare = Comparer().compare
    compare(task(preset))
    asked.clear()
    compare(task(preset.with_value("outliers.enabled", True)))
    seen = asked[0]
    assert seen is not FRAMES[3]  # else stages that are remembered would not be timed
    assert np.array_equal(seen.proximity_depth, FRAMES[3].proximity_depth)


def test_a_method_that_averages_counts_each_frame_once(preset, monkeypatch):
    added, timed = [], []
    add = AveragedDepth.add
    monkeypatch.setattr(AveragedDepth, "add", lambda steady, frame: added.append(frame.sequence) or add(steady, frame))
    compare = Comparer().compare
    for index in (1, 2, 3):
        for gap_m in (0.002, 0.003):
            asked = replace(task(preset.with_value("membrane.gap_m", gap_m), index), methods=("fusion-averaged",))
            (outcome,) = compare(asked).outcomes
            timed.append(outcome.ms is not None)
    assert added == [1, 2, 3]
    # not timed: the first run, which loads code, and runs with cached stages
    assert timed == [False, False, True, False, True, False]


def test_a_preset_that_does_not_fit_is_said_and_the_next_one_works(preset):
    compare = Comparer().compare
    compare(task(preset))
    other = preset.model_copy(update={"rig": tiny_rig(32, 24)})
    unfit = Task(task(preset).result, METHODS, FRAMES[0])
    object.__setattr__(unfit.result, "preset", other)
    notes = {outcome.name: outcome.note for outcome in compare(unfit).outcomes}
    assert "32 x 24" in notes["fusion-rigid"]
    assert points(compare(task(preset)))["fusion-rigid"]


@pytest.mark.parametrize("eye", EYES)
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_methods_and_truth_are_told_apart(eye, theme):
    assert nearest({name: method_rgb(name, theme) for name in (TRUTH, *method_names())}, eye)[0] > 15


@pytest.mark.parametrize("eye", EYES)
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_patches_stand_out_from_the_scene_around_them(eye, theme):
    for name in (TRUTH, *method_names()):
        for row in (0, 127, 250):
            assert nearest({"patch": method_rgb(name, theme), "scene": patch_lut(theme)[row, :3]}, eye)[0] > 10


@pytest.mark.parametrize("theme, least", [("light", 2), ("dark", 3)])
def test_patches_are_seen_on_the_background(theme, least):
    for name in (TRUTH, *method_names()):
        assert contrast_ratio("#" + bytes(method_rgb(name, theme)).hex(), theme_colors(theme).base) > least, name


@pytest.mark.parametrize("eye", EYES)
def test_right_false_and_missed_are_told_apart(eye):
    assert nearest({"right": RIGHT_RGB, "false": FALSE_RGB, "missed": MISSED_RGB}, eye)[0] > 15


def test_every_method_says_what_it_is():
    tips = [method_tip(name) for name in (TRUTH, *method_names())]
    assert all(tips) and len(set(tips)) == len(tips)
