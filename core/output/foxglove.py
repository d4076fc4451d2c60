"""The Foxglove server: live messages over WebSocket, for the Foxglove app and its clients.

Channels have the message encoding ``cdr`` and schemas in ``ros2msg``, as ROS 2 bags in MCAP have them, so the bytes are
those of recordings and of ROS 2.
"""

from __future__ import annotations

import importlib.resources
import logging
import threading
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import MissingExtraError, PublishError
from ..model.files import atomic_path
from .messages import definition
from .publisher import LiveMessage, SinkStatus

if TYPE_CHECKING:
    from foxglove.websocket import ChannelView, Client, WebSocketServer


def save_layout(path: Path) -> None:
    """Write the shipped layout of the Foxglove app, which shows all topics; raises `ExportError`."""
    layout = importlib.resources.files(__package__).joinpath("foxglove_layout.json")
    with atomic_path(path) as temporary:
        temporary.write_bytes(layout.read_bytes())


class FoxgloveSink:
    """A `Sink` that Foxglove clients connect to; port 0 is any free one."""

    def __init__(self, host: str, port: int) -> None:
        self._host, self._port = host, port
        self._server: WebSocketServer | None = None
        self._context: Any = None  # channels live only as long as it
        self._channels: dict[str, Any] = {}
        self._lock = threading.Lock()
        self._subscriptions: Counter[tuple[int, str]] = Counter()

    def start(self, topics: Mapping[str, str]) -> None:
        try:
            import foxglove
        except ImportError as error:
            raise MissingExtraError(
                "Foxglove needs foxglove-sdk: install it with pip install 'tactune[live]'"
            ) from error
        logging.getLogger("foxglove").addHandler(logging.NullHandler())  # a client that vanishes is no news on stderr
        listener: Any = self  # the protocol also asks for what servers without these abilities call
        context = self._context = foxglove.Context()
        for topic, kind in topics.items():
            schema = foxglove.Schema(name=kind, encoding="ros2msg", data=definition(kind).encode())
            self._channels[topic] = foxglove.Channel(topic, message_encoding="cdr", schema=schema, context=context)
        try:
            self._server = foxglove.start_server(
                name="Tactune",
                host=self._host,
                port=self._port,
                server_listener=listener,
                context=context,
                message_backlog_size=len(topics),  # a slow client is at most one frame behind
            )
        except (RuntimeError, OverflowError) as error:
            raise PublishError(
                f"Foxglove cannot listen on {self._host}, port {self._port} ({str(error).rpartition(': ')[2]}); "
                "end the program that listens there, or choose another port and an address of this computer"
            ) from error
        self._port = self._server.port

    def wanted(self) -> Collection[str]:
        with self._lock:
            return frozenset(topic for _, topic in self._subscriptions)

    def send(self, messages: Sequence[LiveMessage]) -> None:
        for message in messages:
            self._channels[message.topic].log(message.data, log_time=message.stamp_ns)

    def close(self) -> None:
        if self._server is not None:
            self._server.stop()
            self._server = None
            for channel in self._channels.values():
                channel.close()

    def status(self) -> SinkStatus:
        """Return the state; a client counts once it listens to a topic."""
        host = f"[{self._host}]" if ":" in self._host else self._host
        with self._lock:
            clients = len({client for client, _ in self._subscriptions})
        return SinkStatus("Foxglove", f"ws://{host}:{self._port}", clients)

    # What the server calls, on its own threads

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        with self._lock:
            self._subscriptions[client.id, channel.topic] += 1

    def on_unsubscribe(self, client: Client, channel: ChannelView) -> None:
        with self._lock:
            self._subscriptions[client.id, channel.topic] -= 1
            self._subscriptions = +self._subscriptions  # without those at 0
