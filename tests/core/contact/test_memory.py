"""Processing frames needs no memory beyond that of the results."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from numba.core.errors import NumbaError
from numba.core.runtime import _nrt_python, rtsys

from tactune.core.bench.measure import allocation
from tactune.core.contact.kernels.compiling import kernel
from tactune.core.contact.outliers.statistical import NeighbourMemory, statistical_inliers
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.model.provenance import Provenance
from tactune.core.preset import Preset

PRESET = Preset(contact_test="tolerance")

FRAMES = 20
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


def test_the_membrane_test_takes_a_bounded_number_of_bytes_and_the_command_measures_it(tactune):
    finished = tactune("bench", "memory", "--source", "sim:cup?press=medium", "--json")
    facts = json.loads(finished.out)
    assert facts["contact_test"] == "membrane"
    assert facts["contiguous"]
    assert not facts["copied_when_read"]
    assert facts["points_bytes"] == 12 * facts["most_points"] > 12 * 5000
    assert facts["frame_bytes"] < 20 * 640 * 480  # bytes per pixel of the proximity camera
    assert facts["left_bytes"] < SLACK_BYTES


def test_outliers_are_searched_in_arrays_from_before(pipeline_and_frame):
    """Besides flags for inliers and for open means, nothing is allocated: no array of eight bytes per point."""
    pipeline, frame, _ = pipeline_and_frame
    patch, camera = pipeline.process(replace(frame)), pipeline.rig.proximity.intrinsics
    pixels, memory = np.flatnonzero(patch.mask), NeighbourMemory()

    def search():
        memory.buffer(0)  # forgets what was found before
        return statistical_inliers(patch.points, pixels, camera, 20, 2.0, memory)

    search()
    assert allocation(search, FRAMES).peak_bytes < 3 * len(pixels) + SLACK_BYTES


def test_kernels_take_no_memory_of_their_own(pipeline_and_frame):
    """numba's arrays are not traced by Python; its own counter must stand still."""
    pipeline, frame, _ = pipeline_and_frame
    _nrt_python.memsys_enable_stats()
    try:
        before = rtsys.get_allocation_stats()
        for _ in range(FRAMES):
            pipeline.process(replace(frame))
        assert rtsys.get_allocation_stats() == before
    finally:
        _nrt_python.memsys_disable_stats()


def test_a_kernel_that_makes_an_array_is_refused():
    def refused(count):
        return np.zeros(count).sum()

    def allowed(count):
        return np.zeros(count).sum()

    with pytest.raises((NumbaError, RuntimeError)):
        kernel(refused)(3)
    assert kernel(allowed, allocates=True)(3) == 0.0
