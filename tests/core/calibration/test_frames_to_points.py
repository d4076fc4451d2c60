"""Snapshots, texture matching and the check of an alignment, on the simulator's frames; files of point pairs."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from simulated_clicks import judged_places, make_clicks
from tactune.core.calibration.calibrate import calibrate
from tactune.core.calibration.check import check_alignment
from tactune.core.calibration.points import read_points, write_points
from tactune.core.calibration.snapshots import depth_under, take_snapshot
from tactune.core.calibration.texture import match_texture
from tactune.core.errors import CalibrationError
from tactune.core.model.alignment import PointPair
from tactune.core.model.frames import SensorFrame
from tactune.core.preset import Preset
from tactune.core.sources.simulator.simulator_source import SimulatorSource


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
    colors = rng.integers(0, 256, (7, 45, 33, 3), np.uint8)
    snapshot = take_snapshot(SensorFrame(number, many[number], many[number], colors[number]) for number in range(7))
    assert np.array_equal(snapshot.frame.proximity_color, np.median(colors, axis=0))
    found = snapshot.frame.tactile_depth
    for row, column in rng.integers(0, (45, 33), (50, 2)):
        valid = np.sort([value for value in many[:, row, column] if value not in (0, 65535)])
        middle = valid[[(len(valid) - 1) // 2, len(valid) // 2]] if len(valid) else np.zeros(1)
        wanted = middle[0] if np.ptp(middle) > 10 else np.rint(middle.mean())  # two surfaces are not averaged
        assert found[row, column] == wanted


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


HEADER = "id,enabled,proximity_u,proximity_v,tactile_u,tactile_v,tactile_depth_m"
pixel = st.floats(-1e6, 1e6)
pairs = st.lists(
    st.builds(
        PointPair,
        id=st.text("abc 1,\"'é", min_size=1, max_size=8).filter(lambda text: text == text.strip()),
        proximity_u=pixel,
        proximity_v=pixel,
        tactile_u=pixel,
        tactile_v=pixel,
        tactile_depth_m=st.none() | st.floats(1e-3, 10),
        enabled=st.booleans(),
        proximity_image=st.sampled_from(["depth", "color"]),
        snapshot=st.none() | st.integers(0, 99),
    ),
    unique_by=lambda pair: pair.id,
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(pairs)
def test_pairs_survive_csv_bit_for_bit(tmp_path, points):
    write_points(tmp_path / "a.csv", points)
    assert read_points(tmp_path / "a.csv") == points


def test_plain_pairs_are_written_with_the_plain_header(tmp_path):
    text = f"{HEADER}\n1,1,1.5,2.0,3.0,4.0,0.3\n2,0,1.0,2.0,3.0,5.0,\n"
    (tmp_path / "given.csv").write_text(text)
    write_points(tmp_path / "points.csv", read_points(tmp_path / "given.csv"))
    assert (tmp_path / "points.csv").read_text() == text


def test_four_columns_are_enough(tmp_path):
    (tmp_path / "four.csv").write_text("tactile_u,tactile_v,proximity_u,proximity_v\n1,2,3,4\n\n5,6,7,8\n")
    pixels = {"tactile_u": 5, "tactile_v": 6, "proximity_u": 7, "proximity_v": 8}
    assert read_points(tmp_path / "four.csv")[1] == PointPair(id="2", **pixels)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "lacks the column proximity_u"),
        (f"{HEADER},colour\n", "column 'colour'"),
        (f"{HEADER}\n1,1,2,3,4,5\n", "line 2: there are not 7 values"),
        (f"{HEADER}\n1,1,2,3,4,5,0.3\n1,1,2,3,4,6,0.3\n", "line 3: id '1' is taken"),
        (f"{HEADER}\n1,1,2,x,4,5,0.3\n", "line 2: proximity_v is 'x'"),
        (f"{HEADER}\n1,1,2,inf,4,5,0.3\n", "line 2: proximity_v is 'inf'"),
        (f"{HEADER}\n1,maybe,2,3,4,5,0.3\n", "line 2: enabled is 'maybe'"),
        (f"{HEADER}\n1,1,2,3,4,5,-0.3\n", "line 2: tactile_depth_m is '-0.3'"),
        (f"{HEADER}\n1,1,2,3,4,5,295\n", "line 2: tactile_depth_m is '295'"),
        (f"{HEADER}\n,1,2,3,4,5,0.3\n", "line 2: id has no value"),
        (f"{HEADER},proximity_image\n1,1,2,3,4,5,0.3,infrared\n", "line 2: proximity_image is 'infrared'"),
        (f'{HEADER}\n1,1,"2,3,4,5,0.3\n', "not CSV"),
        (HEADER.replace(",", ";") + "\n1;1;1,234;2.5;3;4;0.3\n", "line 2: proximity_u is '1,234'"),
    ],
)
def test_a_bad_row_is_named_with_line_field_and_value(tmp_path, text, words):
    (tmp_path / "bad.csv").write_text(text)
    with pytest.raises(CalibrationError, match=words) as caught:
        read_points(tmp_path / "bad.csv")
    assert "bad.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


TABLE = [HEADER.split(","), ["1", "1", "1.5", "2", "3", "4", "0.25"], ["a b", "0", "-1.5", "2", "3", "5", ""]]


def joined(separator, rows=TABLE, end="\n"):
    return end.join(separator.join(row) for row in rows) + end


SPREADSHEETS = {
    "semicolon": joined(";").encode(),
    "decimal comma": joined(";").replace(".", ",").encode(),
    "tab": joined("\t").replace(".", ",").encode(),
    "quoted": joined(",", [[f'"{cell}"' for cell in row] for row in TABLE]).encode(),
    "quoted decimal comma": joined(",", [[f'"{cell}"' for cell in row] for row in TABLE]).replace(".", ",").encode(),
    "byte order mark, CRLF": b"\xef\xbb\xbf" + joined(";", end="\r\n").encode(),
    "Unicode text of Excel": joined("\t").encode("utf-16"),
    "upper case in another order": joined(",", [row[::-1] for row in TABLE]).replace("_u", "_U").encode(),
    "blank lines and cells": ("\n\n" + joined(";").replace("\n", ";;\n") + ";;;\n\n").encode(),
    "sep=": b"sep=;\r\n" + joined(";", end="\r\n").encode(),
    "TRUE and FALSE": joined(";").replace(";1;1.5", ";TRUE;1.5").replace("b;0", "b;FALSE").encode(),
    "spaces": joined(", ").encode(),
    "exponents": joined(";").replace("1.5", "1,5E+00").replace("0.25", "2,5E-01").encode(),
}


@pytest.mark.parametrize("kind", SPREADSHEETS)
def test_a_table_of_any_spreadsheet_has_the_same_pairs(tmp_path, kind):
    (tmp_path / "a.csv").write_bytes(SPREADSHEETS[kind])
    first, second = read_points(tmp_path / "a.csv")
    assert (first.id, first.enabled, first.proximity_u, first.tactile_depth_m) == ("1", True, 1.5, 0.25)
    assert (second.id, second.enabled, second.proximity_u, second.tactile_depth_m) == ("a b", False, -1.5, None)
