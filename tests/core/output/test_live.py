"""Live topics: ROS 2 without ROS, received by Fast DDS and Cyclone DDS, and who may connect to the Foxglove server."""

import os
import signal
import socket
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from fast_dds import FastDds
from foxglove_client import FoxgloveClient
from ros_messages import points_of
from tactune.core.errors import PublishError
from tactune.core.output.foxglove import FoxgloveSink
from tactune.core.output.messages import NUMBER
from tactune.core.output.publisher import LiveMessage, Publisher
from tactune.core.output.ros2 import Ros2Sink

PERIOD_S = 1 / 30

#: Pose of the object and its covariance.
POSE = np.eye(4), np.diag(np.arange(1.0, 7.0))
POSE[0][:3, 3] = 0.1, -0.02, 0.3


@contextmanager
def published(processed, *sinks):
    """Publish the same frame 30 times a second."""
    frame, patch, preset = processed
    ended = threading.Event()

    def run():
        while not ended.wait(PERIOD_S):
            publisher.put(frame, patch, preset)
            publisher.put_pose(*POSE, frame.proximity_time_s)

    with Publisher(sinks) as publisher:
        thread = threading.Thread(target=run)
        thread.start()
        try:
            yield publisher
        finally:
            ended.set()
            thread.join()


@pytest.mark.long
def test_fast_dds_receives_every_bit(processed, fast_dds_program, domain):
    frame, patch, _ = processed
    topics = {"/contact/patch": "reliable", "/contact/area_mm2": "best_effort", "/tactile/depth/image": "reliable"}
    with (
        published(processed, Ros2Sink(domain, "left_finger")),
        FastDds(fast_dds_program, domain, topics, "/left_finger") as subscriber,
        FastDds(fast_dds_program, domain, {"/tf": "reliable", "/tf_static": "transient_local"}) as transforms,
    ):
        subscriber.wait_for(lambda: all(subscriber.counts.values()))
        transforms.wait_for(lambda: all(transforms.counts.values()))
    assert len(patch.points) > 1000
    assert np.array_equal(points_of(subscriber.decoded("/contact/patch"))[0], patch.points)
    assert subscriber.decoded("/contact/area_mm2").data == patch.area_mm2
    image = subscriber.decoded("/tactile/depth/image")
    assert bytes(image.data) == frame.tactile_depth.astype("<u2").tobytes()
    assert transforms.decoded("/tf").transforms[0].child_frame_id == "object"
    assert "tactile_depth_optical_frame" in {t.child_frame_id for t in transforms.decoded("/tf_static").transforms}


@pytest.mark.long
def test_a_subscriber_that_hangs_delays_neither_another_nor_the_end(processed, fast_dds_program, domain):
    cloud = "/proximity/points"
    with (
        FastDds(fast_dds_program, domain, {cloud: "reliable"}) as quick,
        FastDds(fast_dds_program, domain, {cloud: "reliable"}) as slow,
        published(processed, Ros2Sink(domain)) as publisher,
    ):
        for each in (quick, slow):
            each.wait_for(lambda each=each: each.counts[cloud])
        slow.process.send_signal(signal.SIGSTOP)
        sent, put, before = [], publisher.put, quick.counts[cloud]
        publisher.put = lambda *words: (sent.append(words), put(*words))
        quick.wait_for(lambda: quick.counts[cloud] > before + 60)
        assert len(sent) < 4 * 60, "most arrive, also while the machine is busy"
        assert publisher.status()[0].error == ""


def udp_sockets():
    """Return address, port and device of this process's UDP sockets by file descriptor."""
    found = {}
    for descriptor in Path("/proc/self/fd").iterdir():
        if not descriptor.is_socket():
            continue
        with socket.socket(fileno=os.dup(int(descriptor.name))) as copy:
            if (copy.family, copy.type) == (socket.AF_INET, socket.SOCK_DGRAM):
                device = copy.getsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, 16)
                found[int(descriptor.name)] = (*copy.getsockname(), device.rstrip(b"\0"))
    return found


def test_nothing_listens_or_leaves_unless_asked(processed, domain):
    before = udp_sockets()
    sink = Ros2Sink(domain)
    assert udp_sockets() == before
    with published(processed, sink):
        opened = {number: place for number, place in udp_sockets().items() if number not in before}
        assert opened
        assert all(address.startswith("127.") or device == b"lo" for address, _, device in opened.values())
    assert udp_sockets() == before


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"domain": 233}, "domain id 233"),
        ({"namespace": "2nd"}, "'2nd' is no namespace"),
        ({"namespace": "a b"}, "'a b' is no namespace"),
        ({"host": "eth0"}, "'eth0' is no IPv4 address"),
    ],
)
def test_what_ros_does_not_allow_is_refused(options, sentence):
    with pytest.raises(PublishError, match=sentence):
        Ros2Sink(**options).start()


def test_an_address_that_this_computer_does_not_have_is_named(domain):
    sink = Ros2Sink(domain, host="192.0.2.77")
    with pytest.raises(PublishError, match=r"no network interface 192\.0\.2\.77"):
        sink.start()


TOPIC = "/a"


@pytest.fixture
def sink():
    sink = FoxgloveSink("127.0.0.1", 0, max_clients=2, origins=("https://App.Foxglove.dev",))
    sink.start()
    sink.announce({TOPIC: NUMBER})
    yield sink
    sink.close()


def port_of(sink):
    return int(sink.status().place.rpartition(":")[2])


@pytest.mark.parametrize("origin", ["https://example.com", "http://127.0.0.1:8000", "null"])
def test_a_web_page_is_refused(sink, origin):
    with pytest.raises(InvalidStatus, match="403"):
        connect(f"ws://127.0.0.1:{port_of(sink)}", origin=origin)


@pytest.mark.parametrize("origin", [None, "file://", "https://app.foxglove.dev"])
def test_programs_and_the_web_page_that_is_allowed_connect(sink, origin):
    with FoxgloveClient(port_of(sink), origin=origin) as client:
        client.wait_for_channels([TOPIC])


def test_no_more_clients_than_allowed_and_one_that_leaves_makes_room(sink):
    with FoxgloveClient(port_of(sink)), FoxgloveClient(port_of(sink)), pytest.raises(InvalidStatus, match="503"):
        connect(f"ws://127.0.0.1:{port_of(sink)}")
    end = time.monotonic() + 60
    while time.monotonic() < end:
        try:
            FoxgloveClient(port_of(sink)).close()
            return
        except InvalidStatus:
            continue
    raise AssertionError("clients that left are still counted")


def test_a_client_that_reads_nothing_delays_no_other_and_keeps_little(sink):
    with FoxgloveClient(port_of(sink), max_queue=1) as slow, FoxgloveClient(port_of(sink)) as quick:
        for client in (slow, quick):
            client.subscribe([TOPIC])
        while sink.status().clients < 2:
            time.sleep(0.01)
        messages = quick.raw_messages()
        for stamp_ns in range(1, 101):
            sink.send([LiveMessage(TOPIC, bytes(2_000_000), stamp_ns)])
            assert next(messages)[1] == stamp_ns
        client = next(it for it in sink._clients if it.waiting)
        assert list(client.waiting) == [TOPIC] and client.waiting[TOPIC].stamp_ns == 100
