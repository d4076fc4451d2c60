"""Messages and behaviour of the live source when a camera fails."""

import pytest

pytest.importorskip("pyrealsense2", reason="the camera driver is not installed", exc_type=ImportError)

from software_rig import Command, image_number
from tactune.core.sources.cameras.realsense import RealSenseCamera


def state(health, role):
    return next(camera.state for camera in health.cameras if camera.role == role)


def is_well(health):
    return not health.stale and all(camera.state == "streaming" for camera in health.cameras)


def numbers(frames):
    return [
        (image_number("proximity", frame.proximity_depth), image_number("tactile", frame.tactile_depth))
        for frame in frames
    ]


def assert_right_pairs(session, count=10):
    """Whatever happened, frames hold images of one moment, with numbers and times that rise."""
    session.read(count)
    assert all(proximity == tactile for proximity, tactile in numbers(session.frames))
    assert [frame.sequence for frame in session.frames] == list(range(len(session.frames)))
    times = [frame.proximity_time_s for frame in session.frames]
    assert times == sorted(times)


def test_a_camera_that_stops_is_told_and_goes_on(session):
    role = "proximity"
    session.order(Command("stop", role))
    health = session.until(lambda health: state(health, role) == "stalled")
    assert "sends no images" in health.message
    assert health.stale or session.until(lambda health: health.stale)
    session.order(Command("go", role))
    health = session.until(is_well)
    assert health.message == ""
    assert health.dropped > 0
    assert_right_pairs(session)


def test_a_camera_that_stays_silent_is_started_again(session, monkeypatch):
    opened = []
    monkeypatch.setattr(
        RealSenseCamera, "start", lambda camera, start=RealSenseCamera.start: opened.append(start(camera))
    )
    session.order(Command("stop", "tactile"))
    session.until(lambda health: state(health, "tactile") == "stalled")
    session.until(lambda health: opened)
    session.order(Command("go", "tactile"))
    session.until(is_well)
    assert_right_pairs(session)


@pytest.mark.parametrize(
    ("role", "streams", "words"),
    [
        ("proximity", "depth", "sends no images with colour"),
        ("tactile", "color", "sends no images"),
    ],
)
def test_a_camera_with_one_stream_only_is_told_and_goes_on(session, role, streams, words):
    session.order(Command("streams", role, text=streams))
    session.until(lambda health: state(health, role) == "stalled" and words in health.message)
    session.order(Command("streams", role, text="depth color"))
    session.until(is_well)
    assert_right_pairs(session)


def test_the_tactile_camera_may_do_without_colour(session):
    session.order(Command("streams", "tactile", text="depth"))
    session.until(lambda _: session.frames[-1].tactile_color is None)
    assert_right_pairs(session)
    assert state(session.source.health(), "tactile") == "streaming"


def test_a_camera_that_is_unplugged_is_missing_until_it_is_back(session):
    role = "tactile"
    session.source.set_option(role, "visual_preset", 2.0)
    session.order(Command("remove", role))
    health = session.until(lambda health: state(health, role) == "missing")
    assert "is not connected; plug it in" in health.message
    assert {option.camera for option in session.source.options()} == {"proximity", "tactile"} - {role}
    session.order(Command("add", role))
    session.until(is_well)
    kept = {(option.camera, option.name): option.value for option in session.source.options()}
    assert kept[role, "visual_preset"] == 2.0, "what was set stays set"
    assert_right_pairs(session)
