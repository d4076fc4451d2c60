"""Series over time equal the pipeline's patches frame by frame; every frame is visited once."""

from dataclasses import replace

import numpy as np
import pytest

from fakes import FakeSource, tiny_frame
from tactune.app.timeline.series import Series, time_series, visiting_order
from tactune.core import ContactPipeline
from tactune.core.model.frames import GroundTruth
from tactune.core.preset import Preset

PRESET = Preset(contact_test="tolerance").with_values({"tolerance.t": 0.03, "outliers.enabled": False})


def known_frame(index, rig):
    """A frame with its truth: the right half of the image is in contact."""
    contact = np.zeros(rig.proximity.intrinsics.shape, np.bool_)
    contact[:, contact.shape[1] // 2 :] = True
    return replace(tiny_frame(index, rig), truth=GroundTruth(contact))


def test_the_series_is_the_pipelines_and_a_damaged_frame_a_gap():
    source = FakeSource(8, broken={3}, make=known_frame)
    series = Series(source.length, source.frame_rate_hz)
    for values in time_series(source, PRESET, visiting_order(8, PRESET)):
        series.put(values)
    assert series.complete
    assert np.flatnonzero(np.isnan(series.values["area_mm2"])).tolist() == [3]
    pipeline = ContactPipeline(PRESET, source.rig)
    for index in (0, 1, 7):
        frame = source.read(index)
        patch = pipeline.process(frame)
        true = frame.truth.contact
        assert series.values["area_mm2"][index] == patch.area_mm2 > 0
        assert series.values["points"][index] == len(patch.points)
        assert series.values["iou"][index] == (patch.mask & true).sum() / (patch.mask | true).sum() > 0


@pytest.mark.parametrize("length", [1, 2, 99, 101, 900, 5000])
def test_visits_every_frame_once_and_the_whole_recording_first(length):
    order = visiting_order(length, Preset())
    assert sorted(order) == list(range(length))
    first_pass = order[: order.index(max(order[:100])) + 1]
    assert len(first_pass) <= 100
    assert max(first_pass) >= 0.95 * length - 1
    assert visiting_order(length, Preset().with_values({"membrane.frames": 5})) == list(range(length))
