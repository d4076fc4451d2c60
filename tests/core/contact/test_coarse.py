"""The coarse test never rules out a tile that holds a candidate, and does rule out most of the others."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactune.core.contact.alignment import make_alignment
from tactune.core.contact.finder import depth_images, depth_limits
from tactune.core.contact.kernels.chain import TILE_ROWS
from tactune.core.contact.kernels.coarse import CoarseTest, tile_grid
from tactune.core.contact.kernels.simd import LANES
from tactune.core.contact.tolerance import ToleranceFinder
from tactune.core.model.provenance import Provenance
from tactune.core.preset import Preset


def tiles_with_candidates(preset, rig, frame) -> np.ndarray:
    finder = ToleranceFinder(preset, rig, make_alignment(preset.alignment, rig))
    v, u = np.nonzero(finder.classify(frame) == Provenance.CONTACT)
    tiles = np.zeros(tile_grid(frame.proximity_depth.shape[1], frame.proximity_depth.shape[0]), bool)
    tiles[v // TILE_ROWS, u // LANES] = True
    return tiles


def marked(preset, rig, frame) -> np.ndarray:
    test = CoarseTest(make_alignment(preset.alignment, rig).tables)
    tiles, count = test.tiles(depth_images(frame), depth_limits(preset.range, preset.tolerance))
    assert count == tiles.sum()
    return tiles


def lifted(frame, rig, gap_m, where):
    """Move the proximity surface away from the membrane except in some places."""
    counts = frame.proximity_depth.astype(np.int64)
    away = round(gap_m / rig.proximity.depth_unit_m)
    moved = np.where((counts > 0) & (counts < 65535) & ~where, counts + away, counts)
    return type(frame)(
        frame.sequence, np.clip(moved, 0, 65535).astype(np.uint16), frame.tactile_depth, frame.proximity_color
    )


@settings(max_examples=150, deadline=None)
@given(
    seed=st.integers(0, 10_000), model=st.sampled_from(["rigid", "homography"]),
    width=st.sampled_from([160, 97, 40, 11]), gap_m=st.floats(-0.2, 0.3),
    t=st.sampled_from([0.0, 0.003, 0.02, 0.3, 1.0]), noise_m=st.sampled_from([0.0, 0.002, 0.05]),
    offset_m=st.floats(-0.02, 0.02), limits=st.booleans(),
)  # fmt: skip
def test_no_candidate_is_ever_ruled_out(make_rig, make_frame, seed, model, width, gap_m, t, noise_m, offset_m, limits):
    rig = make_rig(width=width)
    frame = make_frame(rig, seed, noise_m)
    rng = np.random.default_rng(seed)
    where = np.zeros(frame.proximity_depth.shape, bool)
    v, u = rng.integers(0, where.shape[0]), rng.integers(0, where.shape[1])
    where[v : v + 7, u : u + 5] = True
    frame = lifted(frame, rig, gap_m, where)
    preset = Preset().with_values(
        {
            "alignment.model": model, "alignment.depth_offset_m": offset_m, "tolerance.t": t,
            "range.enabled": limits, "range.limits_m": (0.2, 0.3),
        }
    )  # fmt: skip
    assert not (tiles_with_candidates(preset, rig, frame) & ~marked(preset, rig, frame)).any()


@pytest.mark.parametrize("model", ["rigid", "homography"])
def test_an_empty_scene_has_no_tile_left(make_rig, make_frame, model):
    rig = make_rig(width=160)
    frame = make_frame(rig, 3, noise_m=0.0005)
    far = lifted(frame, rig, 0.08, np.zeros(frame.proximity_depth.shape, bool))
    preset = Preset().with_values({"alignment.model": model, "tolerance.t": 0.01})
    assert not marked(preset, rig, far).any()
    where = np.zeros(frame.proximity_depth.shape, bool)
    where[24:40, 64:96] = True
    touched = marked(preset, rig, lifted(frame, rig, 0.08, where))
    assert touched.any()
    assert touched.mean() < 0.5


def test_a_distorted_tactile_lens_rules_nothing_out(make_rig, make_frame):
    rig = make_rig(distortion="brown_conrady", bend=0.05)
    assert marked(Preset(), rig, make_frame(rig)).all()
