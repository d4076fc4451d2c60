"""Scenes in which an object turns and moves while it presses: option ``move``."""

from __future__ import annotations

import numpy as np
import pytest

from tactune.core.sources.simulator.membrane import Membrane
from tactune.core.sources.simulator.objects import distance
from tactune.core.sources.simulator.scene import Press, cameras, simulator_rig
from tactune.core.sources.simulator.scenes import Variant, resolve_scene
from tactune.core.sources.simulator.source import SimulatorSource

COARSE = (68, 40)
#: Outside of this distance from the cup's axis there is only its handle, metres.
BODY_M = 0.042


@pytest.fixture(scope="module")
def slide():
    """The poses of the object in the proximity camera's frame, without the membrane under it."""
    scene, rig = resolve_scene("cup", Variant(move="slide"), COARSE), simulator_rig()
    press = Press(scene, Membrane(scene.design), rig)
    places = np.array([press.pose(scene.way[n]) for n in scene.drawn])
    poses = np.tile(np.eye(4), (len(scene.frames), 1, 1))
    poses[:, :3] = places[np.array(scene.frames, int)]
    near = np.vstack([cameras(rig, scene.design)[0].pose, (0.0, 0.0, 0.0, 1.0)])
    return near @ np.linalg.inv(poses)


@pytest.fixture(scope="module")
def lift():
    return SimulatorSource("cup", noise=0.0, cells=COARSE, variant=Variant(move="lift"), sensor="clean")


def poses_of(source):
    return np.array([source.read(n).truth.T_proximity_object for n in range(source.length)])


def steps_of(poses):
    """Distance that the origin moves, metres, and angle that the object turns, degrees, between neighbours."""
    turned = np.einsum("nji,njk->nik", poses[:-1, :3, :3], poses[1:, :3, :3])
    cosine = (np.trace(turned, axis1=1, axis2=2) - 1) / 2
    return np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1), np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def on_object(source, frame, depth, pixels):
    """Points of some pixels of a depth image, metres, in the object's own frame."""
    points = np.dstack([source.rig.proximity.intrinsics.rays() * depth[..., None], depth])[pixels].astype(np.float64)
    pose = np.array(frame.truth.T_proximity_object)
    return (points - pose[:3, 3]) @ pose[:3, :3]


def gaps(source, points):
    identity = np.eye(4)[:3]
    return np.abs([distance(source.scene.pressed.kind, identity, *point) for point in points])


def test_the_cup_turns_and_moves_smoothly_for_five_seconds(slide, lift):
    assert len(slide) == lift.length == 5 * lift.frame_rate_hz
    moved, turned = steps_of(slide)
    assert 0.001 < moved.max() < 0.003
    assert 1.0 < turned.max() < 2.0
    assert np.abs(np.diff(moved)).max() < 0.0005 and np.abs(np.diff(turned)).max() < 0.2
    assert moved[[0, -1]].max() < 0.0003
    ends = steps_of(slide[[0, 74]])
    assert ends[0] > 0.04 and 43 < ends[1] < 45
    np.testing.assert_array_equal(slide[::-1], slide)


def test_it_turns_about_its_handle(slide):
    poses, share = slide[:75], np.linspace(0, 1, 75)
    handle = poses[:, :3, :3] @ (0.043, 0.0, 0.0) + poses[:, :3, 3]
    across = (1 - np.cos(np.pi * share)) / 2
    assert np.abs((handle - handle[0])[:, 0] - 0.040 * across).max() < 0.001
    assert np.ptp(handle[:, 1]) == pytest.approx(0.024, abs=0.002)


@pytest.mark.parametrize("n", [0, 30, 74])
def test_the_images_show_the_object_at_its_true_pose(lift, n):
    frame = lift.read(n)
    touched = on_object(lift, frame, frame.truth.depth_m, frame.truth.contact)
    assert len(touched) > 1500
    assert np.median(gaps(lift, touched)) < 2e-4
    depth = frame.proximity_depth * lift.rig.proximity.depth_unit_m
    behind = on_object(lift, frame, depth, (frame.proximity_depth > 0) & (depth < 0.36))
    assert len(behind) > 8000
    assert np.percentile(gaps(lift, behind), 90) < 5e-4


def test_the_handle_leaves_the_membrane_for_half_of_the_time(lift):
    touches = []
    for n in range(lift.length):
        frame = lift.read(n)
        points = on_object(lift, frame, frame.truth.depth_m, frame.truth.contact)
        touches.append(np.count_nonzero(np.hypot(points[:, 0], points[:, 2]) > BODY_M) > 20)
    gone = ~np.array(touches)
    assert 0.4 < gone.mean() < 0.6
    assert gone[75] and np.count_nonzero(np.diff(gone.astype(int))) == 2  # once, and back
    assert steps_of(poses_of(lift))[1].max() < 3.5
