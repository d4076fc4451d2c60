"""Strain of rendered sheets whose stretch is known, and of the simulator's membrane."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from rigs import one_place_rig
from tactune.core.lab.strain import StrainError, average_still, measure_strain
from tactune.core.model.frames import SensorFrame
from tactune.core.sources.registry import open_source

RIG = one_place_rig(640, 480, 386.0, 0.0001, 1e-5)
LENS = RIG.tactile.intrinsics
DEPTH_M = 0.3


def grid_frame(
    stretch=(1.0, 1.0),
    *,
    bulge=0.0,
    turn=0.0,
    spacing=0.01,
    dot=0.0015,
    missing=(),
    spots=0,
    grain=0.0,
    depth_noise=0.0,
):
    """Render a sheet of 25 x 15 dots at 300 mm, stretched, turned in degrees, raised as a paraboloid z = -bulge r^2."""
    v, u = np.mgrid[:480, :640].astype(float)
    rays = np.stack([(u - LENS.cx) / LENS.fx, (v - LENS.cy) / LENS.fy], axis=2)
    # z = D - bulge (x^2 + y^2) with x = z ray: a quadratic in z
    a = bulge * (rays**2).sum(axis=2)
    depth = np.full_like(a, DEPTH_M) if bulge == 0 else (np.sqrt(1 + 4 * a * DEPTH_M) - 1) / np.maximum(2 * a, 1e-12)
    x, y = np.moveaxis(rays * depth[..., None], 2, 0)
    angle = np.radians(turn)
    s, t = np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x
    s, t = s / stretch[0], t / stretch[1]
    column, row = np.rint(s / spacing), np.rint(t / spacing)
    gap = np.hypot((s - column * spacing) * stretch[0], (t - row * spacing) * stretch[1])
    cover = np.clip((dot - gap) / 0.0008 + 0.5, 0, 1)
    cover[(np.abs(column) > 12) | (np.abs(row) > 7)] = 0
    for place in missing:
        cover[(row == place[0]) & (column == place[1])] = 0
    rng = np.random.default_rng(0)
    for cu, cv in rng.uniform((20, 20), (620, 125), (spots, 2)):
        cover = np.maximum(cover, np.clip(2.5 - np.hypot(u - cu, v - cv), 0, 1))
    gray = 170 - 130 * cover + rng.normal(0, 1, cover.shape) * grain
    color = np.repeat(np.clip(gray, 0, 255).astype(np.uint8)[..., None], 3, axis=2)
    counts = np.rint((depth + rng.normal(0, 1, depth.shape) * depth_noise) / 1e-5).astype(np.uint16)
    return SensorFrame(0, counts, counts, color, color)


@pytest.mark.parametrize(
    "stretch, turn", [((1.0, 1.0), 0), ((1.3, 1.1), 0), ((0.9, 1.2), 20), ((1.2, 1.0), -20), ((2.0, 1.5), 5)]
)
def test_a_known_stretch_is_measured(stretch, turn):
    measured = measure_strain(grid_frame(stretch, turn=turn, grain=2.0), RIG)
    assert np.allclose(measured.length.strain, stretch[0] - 1, atol=0.02)
    assert np.allclose(measured.width.strain, stretch[1] - 1, atol=0.02)


def test_a_bulge_stretches_what_the_camera_sees_flat():
    """On z = -b r^2 the dots' places in x and y are as on the sheet, so neighbours are apart by the slope, too."""
    measured = measure_strain(grid_frame(bulge=2.0), RIG)
    steepest = 2.0 * (0.12**2 - 0.11**2) / 0.01
    assert measured.length.largest == pytest.approx(np.hypot(1, steepest) - 1, abs=0.02)


def test_missing_dots_are_walked_around_and_strange_spots_beside_the_grid_left_out():
    missing = [(0, 0), (0, 1), (1, 0), (-3, 5), (-3, 6), (-3, 7), (4, -8)]
    measured = measure_strain(grid_frame((1.2, 1.1), missing=missing, spots=25, grain=2.0), RIG)
    assert len(measured.pixels) == 375 - 7
    assert measured.length.largest == pytest.approx(0.2, abs=0.02)
    assert measured.width.largest == pytest.approx(0.1, abs=0.02)


def test_frames_at_rest_are_averaged_and_moved_ones_are_not():
    frames = [replace(grid_frame(depth_noise=0.0008), sequence=n) for n in range(4)]
    moved = replace(frames[0], tactile_depth=frames[0].tactile_depth - np.uint16(150))
    still, count = average_still([moved, *frames[1:]])
    assert (count, still.sequence) == (3, 3)
    assert average_still([frames[0]]) == (frames[0], 1)


@pytest.mark.parametrize(("frames", "within"), [(1, 0.08), (10, 0.05)])
def test_the_simulators_membrane(frames, within):
    with open_source("sim:cup?press=low&grid=dots") as source:
        still, count = average_still(list(islice(source, frames)))
        measured = measure_strain(still, source.rig)
    known = still.truth.strain
    assert count == frames
    assert measured.length.largest == pytest.approx(known.length_seen, abs=within)
    assert measured.width.largest == pytest.approx(known.width_seen, abs=within)


def test_what_cannot_be_measured_is_told():
    frame = grid_frame()
    nothing = np.zeros_like(frame.tactile_depth)
    blank = np.full_like(frame.tactile_color, 170)
    for bad in (
        SensorFrame(0, frame.tactile_depth, frame.tactile_depth, frame.proximity_color),
        replace(frame, tactile_depth=nothing),
        replace(frame, tactile_color=blank),
    ):
        with pytest.raises(StrainError, match="frame 0"):
            measure_strain(bad, RIG)
