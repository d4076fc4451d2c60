"""Processing frames needs no memory beyond that of the results."""

from dataclasses import replace

import numpy as np
import pytest

from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.model.patch import Provenance
from tactune.core.preset import Preset
from traced import allocation

PRESET = Preset(contact_test="tolerance")

FRAMES = 4
#: Python's objects of one frame: the patch, its closures, views; far less than any array with an element per point.
SLACK_BYTES = 64 * 1024


@pytest.fixture
def pipeline_and_frame(make_rig, make_frame):
    rig = make_rig(width=320, height=240, color=True)
    preset = PRESET.with_values({"tolerance.t": 0.05, "outliers.min_cluster_area_mm2": 10.0})
    pipeline, frame = ContactPipeline(preset, rig), make_frame(rig)
    for _ in range(5):
        patch = pipeline.process(replace(frame))
    assert len(patch.points) > 20_000
    return pipeline, frame, len(patch.points)


def test_frames_leave_nothing_behind_and_take_no_more_than_the_results(pipeline_and_frame):
    """Results: pixel and point of every candidate, inlier and contact pixel, and flags for each."""
    pipeline, frame, contact = pipeline_and_frame
    provenance = pipeline.process(replace(frame)).provenance
    candidates, inliers = (int((provenance >= least).sum()) for least in (Provenance.OUTLIER, Provenance.SMALL_CLUSTER))
    results = (candidates + inliers + contact) * (8 + 12) + candidates + inliers
    taken = allocation(lambda: pipeline.process(replace(frame)), FRAMES)
    assert taken.left_bytes < SLACK_BYTES
    assert taken.peak_bytes < results + SLACK_BYTES


@pytest.mark.parametrize("test", ["membrane", "tolerance"])
def test_points_are_one_array_that_later_frames_do_not_overwrite(make_rig, make_frame, test):
    rig = make_rig(width=320, height=240, color=True)
    pipeline, frame = ContactPipeline(Preset(contact_test=test), rig), make_frame(rig)
    patch = pipeline.process(frame)
    points = patch.points
    assert points is patch.points
    assert points.flags.c_contiguous
    assert points.flags.owndata
    assert (points.dtype, points.shape) == (np.float32, (int(patch.mask.sum()), 3))
    assert len(points) > 1000
    before = points.copy()
    nearer = replace(frame, proximity_depth=frame.proximity_depth - 8, tactile_depth=frame.tactile_depth - 8)
    assert not np.array_equal(pipeline.process(nearer).points[:1000], before[:1000])
    assert np.array_equal(points, before)
