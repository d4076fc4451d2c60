"""Series over time equal the pipeline's patches frame by frame; every frame is visited once; times are increasing."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.errors import SourceError
from tactune.core.evaluation.metrics import pixel_scores
from tactune.core.evaluation.series_process import PROGRAM
from tactune.core.evaluation.time_series import FrameValues, Series, time_series, visiting_order
from tactune.core.model.frames import GroundTruth
from tactune.core.preset import Preset
from tactune.core.preset.file import preset_json
from tactune.core.sources.folder import export_folder
from tiny_sensor import LiveSource, TinySource

PRESET = Preset(contact_test="tolerance").with_values({"tolerance.t": 0.03, "outliers.enabled": False})


def series_of(source, preset):
    series = Series(source.length, source.frame_rate_hz)
    for values in time_series(source, preset):
        series.put(values)
    return series


def test_equals_the_pipeline_frame_by_frame():
    source = TinySource(12)
    series = series_of(source, PRESET)
    pipeline = ContactPipeline(PRESET, source.rig)
    assert series.complete
    for index in range(12):
        patch = pipeline.process(source.read(index))
        assert series.values["area_mm2"][index] == patch.area_mm2 > 0
        assert series.values["points"][index] == len(patch.points)
    assert np.all(series.values["ms"] > 0)
    assert np.isnan(series.values["iou"]).all()


class KnownSource(TinySource):
    """Knows the truth: the right half of the image is in contact."""

    def read(self, index):
        contact = np.zeros(self.rig.proximity.intrinsics.shape, np.bool_)
        contact[:, contact.shape[1] // 2 :] = True
        return replace(super().read(index), truth=GroundTruth(contact))


def test_scores_frames_whose_truth_is_known():
    source = KnownSource(6)
    series = series_of(source, PRESET)
    pipeline = ContactPipeline(PRESET, source.rig)
    for index in range(6):
        frame = source.read(index)
        assert series.values["iou"][index] == pixel_scores(pipeline.process(frame).mask, frame.truth.contact).iou
    assert 0 < series.values["iou"][0] < series.values["iou"][5] < 1


@pytest.mark.parametrize("length", [1, 2, 99, 101, 900, 5000])
def test_visits_every_frame_once_and_the_whole_recording_first(length):
    order = visiting_order(length, Preset())
    assert sorted(order) == list(range(length))
    first_pass = order[: order.index(max(order[:100])) + 1]
    assert len(first_pass) <= 100
    assert max(first_pass) >= 0.95 * length - 1


def test_a_preset_that_averages_sees_the_frames_in_their_order():
    averaging = Preset().with_values({"membrane.frames": 5})
    assert visiting_order(900, averaging) == list(range(900))


def test_a_damaged_frame_leaves_a_gap():
    series = series_of(TinySource(8, broken=frozenset({3})), PRESET)
    assert series.complete
    assert np.flatnonzero(np.isnan(series.values["area_mm2"])).tolist() == [3]


def test_refuses_a_live_source():
    with pytest.raises(SourceError, match="record it first"):
        next(time_series(LiveSource(), PRESET))


def test_times_follow_the_stamps_and_increase():
    series = Series(5, 10.0)
    assert series.seconds().tolist() == pytest.approx([0, 0.1, 0.2, 0.3, 0.4])
    for index, time_s in ((0, 7.0), (2, 7.4), (4, 8.4)):
        series.put(FrameValues(index, time_s))
    assert series.seconds().tolist() == pytest.approx([0, 0.2, 0.4, 0.9, 1.4])
    series.put(FrameValues(3, 2.0))
    assert series.seconds().tolist() == pytest.approx([0, 0.1, 0.2, 0.3, 0.4])


def test_the_process_gives_the_same_series_and_ends_with_its_input(tmp_path):
    export_folder(TinySource(8), tmp_path / "tiny")
    common = {"length": 8, "preset": preset_json(PRESET)}
    orders = [
        {"id": 1, "source": f"folder:{tmp_path / 'no such folder'}", "skip": [], **common},
        {"id": 2, "source": f"folder:{tmp_path / 'tiny'}", "skip": [2, 5], **common},
        {"id": 3, "source": f"folder:{tmp_path / 'tiny'}", "skip": [], **common, "length": 5},
    ]
    process = subprocess.Popen(
        [sys.executable, "-P", "-c", PROGRAM, json.dumps(sys.path)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    with process:
        answers = []
        for order in orders:
            process.stdin.write(json.dumps(order) + "\n")
            process.stdin.flush()
            for line in process.stdout:
                answers.append(json.loads(line))
                if "done" in answers[-1] or "problem" in answers[-1]:
                    break
        process.stdin.close()
        process.wait(60)
    assert "no such folder" in answers[0]["problem"]
    assert "has 8 frames, not 5 as when it was opened; open it again" in answers[-1]["problem"]
    rows = [row for answer in answers if answer["id"] == 2 for row in answer.get("rows", [])]
    expected = series_of(TinySource(8), PRESET)
    assert [row[0] for row in rows] == [0, 1, 3, 4, 6, 7]
    assert [row[2] for row in rows] == [expected.values["area_mm2"][row[0]] for row in rows]
