"""The Foxglove server: live messages over WebSocket, for the Foxglove app and its clients.

Channels have the message encoding ``cdr`` and schemas in ``ros2msg``, as ROS 2 bags in MCAP have them, so the bytes are
those of recordings and of ROS 2.
"""

from __future__ import annotations

import asyncio
import importlib.resources
import json
import logging
import re
import struct
import threading
from collections.abc import Collection, Mapping, Sequence
from concurrent.futures import Future
from contextlib import suppress
from http import HTTPStatus
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from ..errors import PublishError, extra, foreign
from ..model.files import atomic_path
from ..model.loading import parse_json
from .messages import definition
from .publisher import LiveMessage, SinkStatus

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

#: Names of the protocol in its newer and its older clients; the messages used here are equal.
PROTOCOLS: Final = ("foxglove.sdk.v1", "foxglove.websocket.v1")
#: A message of a client is a list of channels.
_MAX_RECEIVED: Final = 2**16
#: A client that takes longer to answer is gone, and one that takes longer to say goodbye is not waited for, seconds.
_ANSWER_S, _GOODBYE_S = 60.0, 1.0
_MESSAGE_DATA: Final = 1
#: Subscriptions of a client to one topic, on the average: each gets a copy of every message.
_MAX_PER_TOPIC: Final = 4

#: The first text to a client.
_INFO: Final = {"op": "serverInfo", "name": "Tactune", "capabilities": [], "supportedEncodings": [], "metadata": {}}

_log = logging.getLogger(__name__)


def save_layout(path: Path) -> None:
    """Write the shipped layout of the Foxglove app, which shows all topics; raises `ExportError`."""
    layout = importlib.resources.files(__package__).joinpath("foxglove_layout.json")
    with atomic_path(path) as temporary:
        temporary.write_bytes(layout.read_bytes())


class _Client:
    """A client: its subscriptions, and the newest message of each topic that it was not sent yet."""

    def __init__(self, connection: ServerConnection) -> None:
        self.connection = connection
        self.subscriptions: dict[int, str] = {}
        self.waiting: dict[str, LiveMessage] = {}
        self.has_waiting = asyncio.Event()

    async def send_on(self, channels: Sequence[Mapping[str, Any]]) -> None:
        """Send what waits until the client is gone; a slow one gets fewer frames, and only this task waits for it."""
        from websockets.exceptions import ConnectionClosed

        known = 0
        with suppress(ConnectionClosed):
            await self.connection.send(json.dumps(_INFO))
            while True:
                new, known = channels[known:], len(channels)
                if new:
                    await self.connection.send(json.dumps({"op": "advertise", "channels": new}))
                taken, self.waiting = self.waiting, {}
                for number, topic in list(self.subscriptions.items()):
                    if (message := taken.get(topic)) is not None:
                        head = struct.pack("<BIQ", _MESSAGE_DATA, number, message.stamp_ns)
                        await self.connection.send(head + message.data)
                await self.has_waiting.wait()
                self.has_waiting.clear()


class FoxgloveSink:
    """A `Sink` that Foxglove clients connect to; port 0 is any free one.

    At most ``max_clients`` connect at a time. Web pages are refused, but those of ``origins``, such as
    ``"https://app.foxglove.dev"``: any page that is open on this computer can reach a local server.
    """

    def __init__(self, host: str, port: int, max_clients: int, origins: Collection[str] = frozenset()) -> None:
        for origin in origins:
            if not re.fullmatch(r"null|https?://[^/?#\s]+", origin):
                raise PublishError(f"the origin is {foreign(origin, 80)!r}; write it as https://app.foxglove.dev")
        self._host, self._port = host, port
        self._max_clients, self._origins = max_clients, frozenset(map(str.lower, origins))
        self._channels: list[dict[str, Any]] = []  # By their numbers
        self._clients: set[_Client] = set()
        self._connected = 0
        self._wanted: frozenset[str] = frozenset()
        self._loop: asyncio.AbstractEventLoop
        self._closing = asyncio.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        extra("websockets", "Foxglove", "live")
        logging.getLogger("websockets").addHandler(logging.NullHandler())  # a client that vanishes is no news
        started: Future[int] = Future()
        self._thread = threading.Thread(target=self._run, args=(started,), name="Foxglove", daemon=True)
        self._thread.start()
        try:
            self._port = started.result()
        except (OSError, OverflowError, ValueError) as error:
            self._thread.join()
            self._thread = None
            reason = str(getattr(error, "strerror", None) or error).rpartition(": ")[2]
            raise PublishError(
                f"Foxglove cannot listen on {self._host}, port {self._port} ({reason[:1].upper()}{reason[1:]}); "
                "end the program that listens there, or choose another port and an address of this computer"
            ) from error

    def announce(self, topics: Mapping[str, str]) -> None:
        self._loop.call_soon_threadsafe(self._advertise, topics)

    def wanted(self) -> Collection[str]:
        return self._wanted

    def send(self, messages: Sequence[LiveMessage]) -> None:
        self._loop.call_soon_threadsafe(self._offer, messages)

    def close(self) -> None:
        if self._thread is not None:
            self._loop.call_soon_threadsafe(self._closing.set)
            self._thread.join()
            self._thread = None

    def status(self) -> SinkStatus:
        """Return the state; a client counts once it listens to a topic."""
        host = f"[{self._host}]" if ":" in self._host else self._host
        return SinkStatus("Foxglove", f"ws://{host}:{self._port}", self._connected)

    # On the server's own thread

    def _run(self, started: Future[int]) -> None:
        try:
            with asyncio.Runner() as runner:
                self._loop = runner.get_loop()
                runner.run(self._listen(started))
        except Exception as error:
            if started.done():
                raise
            started.set_exception(error)

    async def _listen(self, started: Future[int]) -> None:
        from websockets.asyncio.server import serve

        async with serve(
            self._attend,
            self._host,
            self._port,
            subprotocols=[*PROTOCOLS],  # type: ignore[list-item]
            process_request=self._admit,
            compression=None,
            max_size=_MAX_RECEIVED,
            ping_timeout=_ANSWER_S,
            close_timeout=_GOODBYE_S,
        ) as server:
            started.set_result(next(iter(server.sockets)).getsockname()[1])
            await self._closing.wait()

    def _admit(self, connection: ServerConnection, request: Request) -> Response | None:
        """Refuse web pages that are not allowed, and clients beyond the largest number."""
        for origin in request.headers.get_all("Origin"):
            if origin.startswith(("http:", "https:", "null")) and origin.lower() not in self._origins:
                refused = f"the web page {foreign(origin, 100)} was refused; add it to the origins (serve --origin)"
                _log.warning("Foxglove: %s", refused)
                return connection.respond(HTTPStatus.FORBIDDEN, f"Tactune: {refused}\n")
        if len(self._clients) >= self._max_clients:
            return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, f"{self._max_clients} clients are connected\n")
        return None

    async def _attend(self, connection: ServerConnection) -> None:
        from websockets.exceptions import ConnectionClosed

        if len(self._clients) >= self._max_clients:  # many may be admitted at the same moment
            return
        client = _Client(connection)
        self._clients.add(client)
        sending = asyncio.ensure_future(client.send_on(self._channels))
        try:
            async for text in connection:
                self._obey(client, text)
        except ConnectionClosed:
            pass
        finally:
            sending.cancel()
            self._clients.discard(client)
            self._count()

    def _advertise(self, topics: Mapping[str, str]) -> None:
        for topic, kind in topics.items():
            schema = {"schemaName": kind, "schema": definition(kind), "schemaEncoding": "ros2msg"}
            self._channels.append({"id": len(self._channels), "topic": topic, "encoding": "cdr", **schema})
        for client in self._clients:
            client.has_waiting.set()

    def _obey(self, client: _Client, text: str | bytes) -> None:
        """Subscribe or unsubscribe as a client asks; what it says else means nothing here."""
        try:
            asked: Any = parse_json(text)
            if asked["op"] == "subscribe":
                for each in asked["subscriptions"]:
                    number, channel = int(each["id"]), int(each["channelId"])
                    full = len(client.subscriptions) >= _MAX_PER_TOPIC * len(self._channels)
                    if 0 <= number < 2**32 and 0 <= channel < len(self._channels) and not full:
                        client.subscriptions[number] = self._channels[channel]["topic"]
            elif asked["op"] == "unsubscribe":
                for number in asked["subscriptionIds"]:
                    client.subscriptions.pop(int(number), None)
        except (ValueError, TypeError, KeyError, OverflowError):
            pass  # what was understood before it counts
        self._count()

    def _count(self) -> None:
        self._wanted = frozenset(topic for client in self._clients for topic in client.subscriptions.values())
        self._connected = sum(bool(client.subscriptions) for client in self._clients)

    def _offer(self, messages: Sequence[LiveMessage]) -> None:
        for client in self._clients:
            wanted = set(client.subscriptions.values())
            client.waiting.update({message.topic: message for message in messages if message.topic in wanted})
            if client.waiting:
                client.has_waiting.set()
