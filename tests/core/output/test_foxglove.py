"""Who may connect to the Foxglove server, and that a slow client delays nobody."""

import time

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from foxglove_client import FoxgloveClient
from tactune.core.output.foxglove import FoxgloveSink
from tactune.core.output.messages import NUMBER
from tactune.core.output.publisher import LiveMessage

TOPIC = "/a"


@pytest.fixture
def sink():
    sink = FoxgloveSink("127.0.0.1", 0, max_clients=2, origins=("https://app.foxglove.dev",))
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
            sink.send([LiveMessage(TOPIC, NUMBER, bytes(5_000_000), stamp_ns)])
            assert next(messages)[1] == stamp_ns
        client = next(it for it in sink._clients if it.waiting)
        assert list(client.waiting) == [TOPIC] and client.waiting[TOPIC].stamp_ns == 100
