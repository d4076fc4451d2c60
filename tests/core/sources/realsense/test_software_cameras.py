"""A pair of software devices through the class that opens hardware: pixels, lenses, options."""

import threading
import time

import numpy as np
import pytest

pytest.importorskip("pyrealsense2", reason="the camera driver is not installed", exc_type=ImportError)

import software_rig
from software_rig import SoftwareCamera, SoftwareRig, open_software_rig
from tactune.core.errors import SourceError
from tactune.core.model.intrinsics import Distortion
from tactune.core.preset import CameraSection, CamerasSection
from tactune.core.sources.cameras.camera import Calibration
from tactune.core.sources.cameras.camera_source import CameraSource
from tactune.core.sources.cameras.realsense import RealSenseDriver

IMAGES = 90


def test_framesets_arrive_pixel_for_pixel_and_none_is_lost():
    """From the second one on: the driver pairs no first images."""
    with open_software_rig(count=IMAGES) as source:
        for number in range(1, IMAGES):
            assert source.wait(60.0), f"no frame {number}: {source.health()}"
            frame = source.next_frame()
            assert frame.sequence == number - 1
            for role, depth, color in (
                ("proximity", frame.proximity_depth, frame.proximity_color),
                ("tactile", frame.tactile_depth, frame.tactile_color),
            ):
                assert software_rig.image_number(role, depth) == number, f"an image is lost: {source.health()}"
                assert np.array_equal(depth, software_rig.depth_image(role, number))
                assert np.array_equal(color, software_rig.color_image(role, number))
            assert abs(frame.skew_s) < 1e-6
        assert not source.wait(0.2)
        assert source.health().dropped == 0
    assert source.next_frame() is None


def test_lenses_pose_and_unit_are_those_that_the_devices_state(session):
    rig = session.source.rig
    session.frames[0].check_against(rig)
    assert (rig.proximity.model, rig.proximity.serial, rig.proximity.depth_unit_m) == ("L515", "f0090001", 0.00025)
    assert (rig.tactile.model, rig.tactile.serial, rig.tactile.depth_unit_m) == ("D405", "130322270002", 0.0001)
    assert rig.T_proximity_tactile is None
    depth, tactile = rig.proximity.intrinsics, rig.tactile.intrinsics
    assert (depth.fx, depth.fy, depth.cx, depth.cy) == (461.0, 462.5, 321.25, 237.5)
    assert (tactile.fx, tactile.fy) == (433.75, 433.5)
    assert not depth.has_distortion
    color = rig.proximity_color
    assert color.intrinsics.fx == 603.5
    assert color.intrinsics.distortion is Distortion.INVERSE_BROWN_CONRADY
    assert color.intrinsics.coefficients == pytest.approx((0.125, -0.25, 0.001, -0.0005, 0.0625), rel=1e-6)
    point = np.array([0.1, 0.2, 0.3, 1.0])
    rotation = np.reshape(software_rig.COLOR_ROTATION, (3, 3)).T  # the driver states columns
    expected = rotation @ point[:3] + software_rig.COLOR_TRANSLATION_M
    np.testing.assert_allclose((np.asarray(color.T_color_depth) @ point)[:3], expected, atol=1e-7)


def open_rig(rig):
    return CameraSource([RealSenseDriver(rig.devices)])


def options_of(source):
    return {(option.camera, option.name): option.value for option in source.options()}


def test_an_l515_starts_at_short_range_and_options_can_be_changed(session):
    source = session.source
    values = options_of(source)
    assert values["proximity", "visual_preset"] == 5.0
    assert values["proximity", "laser_power"] == 100.0
    assert values["tactile", "visual_preset"] == 0.0
    visual_preset = source.options()[0]
    assert (visual_preset.minimum, visual_preset.maximum, visual_preset.default) == (0.0, 5.0, 5.0)
    source.set_option("proximity", "visual_preset", 3.0)
    assert source.options()[0].default == 5.0, "what a preset without a word of it means"
    source.set_option("tactile", "exposure", 12_000.0)
    assert options_of(source)["tactile", "exposure"] == 12_000.0
    with pytest.raises(SourceError, match=r"L515 .*refuses laser_power = 101.*allowed are 0 to 100"):
        source.set_option("proximity", "laser_power", 101.0)
    with pytest.raises(SourceError, match=r"D405 .*no option 'laser_power'; it has visual_preset"):
        source.set_option("tactile", "laser_power", 1.0)
    session.read(3)


def test_options_of_the_preset_are_set_before_the_first_image_and_refusals_are_told():
    cameras = CamerasSection(
        proximity=CameraSection(options={"laser_power": 30.0, "visual_preset": 4.0, "min_distance": 9_999.0}),
        tactile=CameraSection(options={"enable_auto_exposure": 1.0, "exposure": 5_000.0, "sparkle": 1.0}),
    )
    with open_software_rig(cameras=cameras) as source:
        values = options_of(source)
        message = source.health().message
        assert source.wait(60.0)
    assert values["proximity", "laser_power"] == 30.0
    assert values["proximity", "visual_preset"] == 4.0
    assert values["tactile", "exposure"] == 5_000.0
    assert "refuses min_distance = 9999" in message
    assert "no option 'sparkle'" in message


def test_a_device_without_depth_unit_is_refused():
    rig = SoftwareRig()
    rig.cameras["tactile"] = SoftwareCamera("tactile", unit_m=0.0)
    with pytest.raises(SourceError, match=r"D405 .*reports an impossible lens, pose or depth unit .*depth_unit_m"):
        open_rig(rig)


def test_a_device_in_use_is_said_to_be():
    rig = SoftwareRig()
    with (
        open_rig(rig),
        pytest.raises(SourceError, match=r"L515 \(serial f0090001\) is in use by another program"),
    ):
        open_rig(rig)


def test_a_delay_of_the_tactile_camera_is_taken_off_its_stamps_before_pairing():
    """Seven periods: image n of the tactile camera shows what image n - 7 of the other one shows."""
    with open_software_rig(cameras=CamerasSection(tactile_delay_s=7 / 30)) as source:
        for _ in range(20):
            assert source.wait(60.0)
            frame = source.next_frame()
            numbers = [
                software_rig.image_number(role, depth)
                for role, depth in (("proximity", frame.proximity_depth), ("tactile", frame.tactile_depth))
            ]
            assert numbers[1] - numbers[0] == 7
            assert abs(frame.skew_s) < 1e-6
            assert abs(frame.proximity_time_s - time.time()) < 60.0


@pytest.mark.parametrize("apart_s", [60.0, 0.0])
def test_cameras_whose_clocks_differ_are_told_and_frames_that_nobody_reads_are_no_such(apart_s):
    with open_software_rig(cameras=CamerasSection().model_copy(update={"tactile_delay_s": apart_s})) as source:
        deadline_s = time.monotonic() + 60
        while not (health := source.health()).stale or any(each.state != "streaming" for each in health.cameras):
            assert time.monotonic() < deadline_s
            source.wait(0.05)
        assert health.ok == (not apart_s)
        assert ("60 s apart" in health.message) == bool(apart_s)


def test_color_of_another_lens_is_brought_to_the_depth_pixels(session):
    """A real D405's colour image is not exactly its depth image's: shift it and see it shifted back."""
    depth = session.source.rig.tactile
    lens = depth.intrinsics.model_copy(update={"cx": depth.intrinsics.cx + 8.0})
    counts = np.full(depth.intrinsics.shape, 3000, np.uint16)
    counts[:, 100] = 0
    color = software_rig.color_image("tactile", 0)
    aligned = Calibration(depth, lens, np.eye(4).tolist()).color_on_depth(color, counts)
    np.testing.assert_array_equal(aligned[:, 101:632], color[:, 109:640])
    assert not aligned[:, 100].any()
    assert not aligned[:, 632:].any()


def test_a_driver_that_does_not_come_back_is_told_where_frames_are_asked_for(session, monkeypatch):
    released = threading.Event()
    monkeypatch.setattr("tactune.core.sources.cameras.camera_source.HUNG_S", 0.5)
    monkeypatch.setattr(
        "tactune.core.sources.cameras.realsense.RealSenseCamera.read", lambda *_: released.wait() and None
    )
    try:
        with pytest.raises(SourceError, match=r"driver does not come back from the (L515|D405)"):
            session.read(1_000)
    finally:
        released.set()
