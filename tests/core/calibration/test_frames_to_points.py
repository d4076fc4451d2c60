"""Snapshots, texture matching and the check of an alignment, on the simulator's frames."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from simulated_clicks import judged_places, make_clicks
from tactune.core.calibration.calibrate import calibrate
from tactune.core.calibration.check import check_alignment
from tactune.core.calibration.snapshots import content_hash, depth_under, take_snapshot
from tactune.core.calibration.texture import match_texture
from tactune.core.errors import CalibrationError
from tactune.core.model.frames import SensorFrame
from tactune.core.preset import Preset
from tactune.core.sources.simulator.source import SimulatorSource


@pytest.fixture(scope="module")
def frames():
    source = SimulatorSource("cup", sensor="datasheet")
    return [source.read(index) for index in (2, 30)]


@pytest.fixture(scope="module")
def preset(rig):
    """A preset with a calibration from thirty clicks."""
    return calibrate(make_clicks(rig, 30, 0).pairs(), rig).apply_to(Preset())


@pytest.fixture(scope="module")
def matches(frames, rig):
    return match_texture(frames, rig.model_copy(update={"T_proximity_tactile": None}))[0]


def test_texture_gives_the_pose_without_a_click_or_a_stated_pose(matches, rig):
    places, true = judged_places(rig)
    fit = calibrate(matches, rig, "rigid").rigid
    pose, stated = fit.alignment.pose, np.array(rig.T_proximity_tactile)
    assert np.hypot(*(fit.predict(places) - true).T).mean() < 0.25
    assert 1e3 * np.linalg.norm(pose[:3, 3] - stated[:3, 3]) < 0.7
    assert np.degrees(Rotation.from_matrix(pose[:3, :3] @ stated[:3, :3].T).magnitude()) < 0.15


def test_texture_pairs_of_two_levels_are_right_and_usable(matches, rig):
    assert len(matches) >= 100
    assert {pair.snapshot for pair in matches} == {0, 1}
    assert {pair.proximity_image for pair in matches} == {"color"}
    report = calibrate(matches, rig)
    assert report.model == "rigid"
    assert report.chosen.excluded == ()
    assert report.chosen.rms_px < 0.3


def test_images_of_different_scenes_are_refused(frames, rig):
    seen, nowhere = frames[0].proximity_color, rig.model_copy(update={"T_proximity_tactile": None})
    turned = np.roll(seen, 200, axis=1)[:, :, ::-1].swapaxes(0, 1)
    for cameras, other in ((rig, seen[::-1]), (nowhere, turned)):
        image = np.ascontiguousarray(cv2.resize(np.ascontiguousarray(other), seen.shape[1::-1]))
        with pytest.raises(CalibrationError):
            match_texture([replace(frames[0], proximity_color=image)], cameras)


def test_frames_without_texture_are_refused(frames, rig):
    frame = frames[0]
    plain = np.full_like(frame.tactile_color, 90)
    for color, words in ((plain, "look alike"), (None, "no tactile colour")):
        dull = SensorFrame(0, frame.proximity_depth, frame.tactile_depth, frame.proximity_color, color)
        with pytest.raises(CalibrationError, match=words):
            match_texture([dull], rig)
        with pytest.raises(CalibrationError):
            check_alignment(Preset(), rig, dull)


def test_a_check_tells_a_good_calibration_from_a_moved_camera(frames, rig, preset):
    good = check_alignment(preset, rig, frames[1])
    assert not good.recalibrate
    assert good.drift_px < 0.8
    pose = np.array(preset.alignment.rigid.T_proximity_tactile)
    pose[:3, :3] = Rotation.from_rotvec([0, np.radians(0.6), 0]).as_matrix() @ pose[:3, :3]
    moved = check_alignment(preset.with_value("alignment.rigid.T_proximity_tactile", pose), rig, frames[1])
    assert moved.recalibrate
    assert moved.drift_px == pytest.approx(460 * np.radians(0.6), rel=0.3)
    assert "calibrate again" in moved.sentence


def test_the_median_leaves_out_what_is_no_depth():
    rng = np.random.default_rng(0)
    many = rng.choice(np.array([0, 65535, 100, 101, 102, 900], np.uint16), (7, 45, 33))
    color = np.zeros((45, 33, 3), np.uint8)
    frames = [SensorFrame(number, depth, depth, color) for number, depth in enumerate(many)]
    found = take_snapshot(frames).frame.tactile_depth
    for row, column in rng.integers(0, (45, 33), (50, 2)):
        valid = np.sort([value for value in many[:, row, column] if value not in (0, 65535)])
        middle = valid[[(len(valid) - 1) // 2, len(valid) // 2]] if len(valid) else np.zeros(1)
        wanted = middle[0] if np.ptp(middle) > 10 else np.rint(middle.mean())  # two surfaces are not averaged
        assert found[row, column] == wanted


def test_a_snapshot_is_quieter_than_a_frame_and_named_by_its_content(rig):
    source = SimulatorSource("cup", sensor="datasheet")
    clean = SimulatorSource("cup", noise=0.0, sensor="datasheet").read(40)
    held = [source.read(index) for index in range(40, 45)]
    snapshot = take_snapshot(held)
    valid = (clean.tactile_depth > 0) & (snapshot.frame.tactile_depth > 0)
    noise = [np.abs(f.tactile_depth[valid].astype(float) - clean.tactile_depth[valid]).mean() for f in held]
    kept = np.abs(snapshot.frame.tactile_depth[valid].astype(float) - clean.tactile_depth[valid]).mean()
    assert kept < 0.9 * min(noise[1:])
    assert snapshot.frames == 5
    assert snapshot.sha256 == content_hash(snapshot.frame) != content_hash(held[0])
    with pytest.raises(CalibrationError, match="at least one frame"):
        take_snapshot([])


def test_depth_under_a_click_follows_the_slope_and_keeps_to_its_surface():
    v, u = np.mgrid[:40, :40]
    counts = np.round(3000 + 4.0 * u - 2.0 * v).astype(np.uint16)
    assert depth_under(counts, 1e-4, 20.4, 10.3) == pytest.approx((3000 + 4 * 20.4 - 2 * 10.3) * 1e-4, abs=1e-5)
    counts[:, 22:] = 4000
    counts[9:12, 19] = 0
    counts[5, 5] = 65535
    assert depth_under(counts, 1e-4, 20.4, 10.3) == pytest.approx(0.3061, abs=2e-4)
    counts[:] = 0
    assert depth_under(counts, 1e-4, 20.4, 10.3) is None
    assert depth_under(counts, 1e-4, -4, 10) is None
