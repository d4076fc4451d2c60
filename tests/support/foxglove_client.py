"""A Foxglove client of its own: the WebSocket protocol by hand, messages decoded by MCAP's ROS 2 decoder."""

from __future__ import annotations

import json
import struct
import time
from collections.abc import Callable, Iterable, Iterator
from types import TracebackType
from typing import Any, Self

from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from websockets.sync.client import connect

WAIT_S = 60
#: Messages come on and on, also where none is the one that a test waits for.
LIFETIME_S = 300

_MESSAGE_DATA = 1


class FoxgloveClient:
    """Connected to a server on this computer; a context manager. Channels are known once it is made."""

    def __init__(self, port: int, host: str = "127.0.0.1", **options: Any) -> None:
        place = f"ws://{host}:{port}"
        self._connection = connect(place, subprotocols=["foxglove.sdk.v1"], max_size=None, **options)
        self._socket = self._connection.__enter__()
        self._end_s = time.monotonic() + LIFETIME_S
        self.texts: list[dict[str, Any]] = []
        self.info = self.wait_for_text("serverInfo")
        self.channels: dict[str, dict[str, Any]] = {}
        self._decoders: dict[int, tuple[str, Callable[[bytes], Any]]] = {}
        self._factory = DecoderFactory()

    def wait_for_channels(self, topics: Iterable[str]) -> None:
        """Wait until these topics are advertised."""
        while missing := set(topics) - self.channels.keys():
            advertised = self.wait_for_text("advertise")["channels"]
            self.channels |= {channel["topic"]: channel for channel in advertised}
            assert advertised, missing

    def subscribe(self, topics: Iterable[str]) -> None:
        wanted = []
        self.wait_for_channels(topics)
        for topic in topics:
            channel = self.channels[topic]
            assert channel["encoding"] == "cdr"
            number = len(self._decoders) + 1
            schema = Schema(number, channel["schema"].encode(), channel["schemaEncoding"], channel["schemaName"])
            decode = self._factory.decoder_for("cdr", schema)
            assert decode is not None
            self._decoders[number] = topic, decode
            wanted.append({"id": number, "channelId": channel["id"]})
        self.send("subscribe", subscriptions=wanted)

    def send(self, op: str, **values: Any) -> None:
        self._socket.send(json.dumps({"op": op, **values}))

    def _receive(self) -> str | bytes:
        assert time.monotonic() < self._end_s, f"what is waited for did not come in {LIFETIME_S} s; said: {self.texts}"
        return self._socket.recv(timeout=WAIT_S)

    def raw_messages(self) -> Iterator[tuple[str, int, bytes]]:
        """Yield topic, time stamp in ns and bytes of each message; texts are kept in ``texts``."""
        while True:
            data = self._receive()
            if isinstance(data, str):
                self.texts.append(json.loads(data))
                continue
            opcode, subscription, stamp_ns = struct.unpack_from("<BIQ", data)
            assert opcode == _MESSAGE_DATA
            yield self._decoders[subscription][0], stamp_ns, data[13:]

    def messages(self) -> Iterator[tuple[str, int, Any]]:
        """Yield topic, time stamp in ns and message."""
        decoders = dict(self._decoders.values())
        for topic, stamp_ns, data in self.raw_messages():
            yield topic, stamp_ns, decoders[topic](data)

    def frames(self, topics: Iterable[str]) -> Iterator[dict[str, Any]]:
        """Yield the messages of each frame of which all topics arrived, by topic."""
        wanted, stamp_ns, frame = set(topics), 0, dict[str, Any]()
        for topic, time_ns, message in self.messages():
            if time_ns != stamp_ns:
                stamp_ns, frame = time_ns, {}
            frame[topic] = message
            if frame.keys() == wanted:
                yield frame

    def wait_for_text(self, op: str) -> dict[str, Any]:
        """Return the next text of this kind; messages before it are dropped."""
        for index, text in enumerate(self.texts):
            if text["op"] == op:
                return self.texts.pop(index)
        while True:
            data = self._receive()
            if isinstance(data, str):
                text = json.loads(data)
                if text["op"] == op:
                    return dict(text)
                self.texts.append(text)

    def close(self) -> None:
        self._connection.__exit__(None, None, None)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
