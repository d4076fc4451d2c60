"""Live ROS 2 topics: found, read, paired; a publisher that goes and comes back; what is missing is named."""

import threading
import time

import numpy as np
import pytest

import ros2_cameras
from fast_dds import FastDdsPublisher
from ros2_cameras import BASELINE_M, cameras, messages, topics_of, transforms
from tactune.core import open_source
from tactune.core.errors import SourceError
from tactune.core.model.frames import Rig
from tactune.core.preset import CamerasSection
from tactune.core.sources.ros import live
from tactune.core.sources.ros.live import open_topics

WAIT_S = 60


def untold(share, words):
    """Nobody is shown the progress."""


def until(source, is_reached):
    """Wait; frames that come meanwhile are taken."""
    end_s = time.monotonic() + WAIT_S
    while not is_reached():
        assert time.monotonic() < end_s, source.health()
        if source.wait(0.1):
            source.next_frame()


def check_frames(source):
    """Frames hold the same moment of both cameras, and the colour of the same moment."""
    rig = source.rig
    assert (rig.proximity.model, rig.tactile.model, rig.proximity.depth_unit_m) == ("l515", "d405", 0.001)
    assert np.allclose(np.array(rig.T_proximity_tactile)[:3, 3], (BASELINE_M, 0, 0))
    assert rig.proximity_color is None  # the same frame and lens: aligned
    whole, end_s = 0, time.monotonic() + WAIT_S
    while whole < 10 and (whole == 0 or time.monotonic() < end_s):
        frame = source.next_frame()
        if frame.tactile_color is None:  # on a busy computer an image may lose its colour
            assert time.monotonic() < 2 * WAIT_S + end_s, source.health()
            continue
        whole += 1
        number = frame.proximity_depth[0, 0]
        assert frame.tactile_depth[0, 0] == number
        assert (frame.proximity_color[0, 0] == number % 256).all()
        assert (frame.tactile_color[0, 0] == number % 256).all()
        assert frame.skew_s == 0
        assert np.array_equal(frame.proximity_depth[1:], ros2_cameras.DEPTH[1:])


def test_two_cameras_are_found_and_survive_that_their_publisher_goes(domain):
    with cameras(domain) as publisher, open_source(f"ros2:?domain={domain}") as source:
        assert source.frame_rate_hz == 30.0
        check_frames(source)
        until(source, lambda: source.health().message == "")
        publisher.kill()
        until(source, lambda: "Nobody publishes /l515/depth/image_rect_raw" in source.health().message)
        assert [camera.state for camera in source.health().cameras] == ["missing", "missing"]
        with cameras(domain):
            until(source, lambda: source.health().ok and source.wait(1))
            check_frames(source)
            until(source, lambda: source.health().message == "")
        with cameras(domain, model="none"):  # maybe before anybody has missed the others
            until(source, lambda: "/d405/depth/image_rect_raw has another lens" in source.health().message)


def test_one_camera_is_a_tactile_one(domain):
    with cameras(domain, names=("d405",)), open_topics(f"?domain={domain}", CamerasSection(), untold) as source:
        assert source.rig == Rig.of_one_camera(source.rig.tactile)
        numbers = []
        for _ in range(8):
            frame = source.next_frame()
            assert np.array_equal(frame.proximity_depth, frame.tactile_depth)
            numbers.append(int(frame.tactile_depth[0, 0]))
        assert numbers == sorted(set(numbers))
        assert source.health().ok


def test_a_second_camera_is_awaited_and_named_when_it_stays_silent(domain):
    with (
        cameras(domain, rate_hz=1e-3, names=("d405",)),  # one image, before anybody listens
        cameras(domain, names=("l515",)),
        open_topics(f"?domain={domain}", CamerasSection(), untold) as source,
    ):
        assert not source.rig.has_proximity
        assert "no depth comes on /d405/depth/image_rect_raw" in source.health().message


@pytest.fixture
def from_fast_dds(fast_dds_program, domain):
    """Publish by Fast DDS, images without repeats as sensor data are, and return the domain."""
    names = ros2_cameras.CAMERAS
    topics = {
        topic: (kind, "transient_local" if topic == "/tf_static" else "best_effort")
        for topic, kind in topics_of(names).items()
    }
    publisher, ended = FastDdsPublisher(fast_dds_program, domain, topics), threading.Event()

    def run():
        number, began_s = 0, time.time()
        publisher.send("/tf_static", transforms())
        while not ended.wait(max(0.0, began_s + number / 15 - time.time())):
            for topic, data in messages(number, round((began_s + number / 15) * 1e9), names):
                publisher.send(topic, data)
            number += 1

    thread = threading.Thread(target=run)
    thread.start()
    yield domain
    ended.set()
    thread.join()
    publisher.close()


@pytest.mark.long
def test_cameras_that_fast_dds_publishes(from_fast_dds):
    with open_source(f"ros2:?domain={from_fast_dds}&host=127.0.0.1") as source:
        check_frames(source)
        assert source.frame_rate_hz == 15.0


@pytest.mark.parametrize(
    ("rest", "sentence"),
    [
        ("domain=3", "the only options are domain and host"),
        ("here", "the only options are domain and host"),
        ("?port=3", "the only options are domain and host"),
        ("?domain=3&domain=4", "each once"),
        ("?domain=", "the domain is ''"),
        ("?domain=300", "is not from 0 to 232"),
        ("?host=here", "'here' is no IPv4 address"),
        ("?proximity.depht=/a", "the only options are domain and host"),
        ("?domain={domain}", "nobody has published in ROS 2 domain"),
    ],
)
def test_what_cannot_be_opened_is_one_sentence(rest, sentence, domain, monkeypatch):
    monkeypatch.setattr(live, "_SEARCH_S", 0.2)
    with pytest.raises(SourceError, match=sentence):
        open_topics(rest.format(domain=domain), CamerasSection(), untold)


def test_a_lens_that_is_unknown_is_named_and_a_file_replaces_it(domain, tmp_path):
    (tmp_path / "K.txt").write_text("610 0 424 0 610 240 0 0 1")
    chosen = f"tactile.depth=/d405/depth/image_rect_raw,tactile.info={tmp_path / 'K.txt'}"
    with cameras(domain, model="spherical"):
        with pytest.raises(SourceError, match=r"/image_r\w+: .*lens model 'spherical'.*known are"):
            open_topics(f"?domain={domain}", CamerasSection(), untold)
        with open_topics(f"?domain={domain}?{chosen}", CamerasSection(), untold) as source:
            assert source.rig.tactile.intrinsics.fx == 610
