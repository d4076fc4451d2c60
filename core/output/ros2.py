"""Publishes ROS 2 topics; nothing is encoded here, since the messages already are in CDR."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from typing import Final

from ..errors import PublishError
from ..sources.ros.dds import Participant, Writer
from .messages import SAID_ONCE, ros_topic, type_hash
from .publisher import LiveMessage, SinkStatus

#: Messages of a topic that are kept for repeats: about 0.1 s, so that a lost part of a large one still arrives in time.
_HISTORY: Final = 4
_NAMESPACE = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")


class Ros2Sink:
    """ROS 2 topics by DDS; a `tactune.core.output.publisher.Sink`.

    ``namespace`` is put before every topic but ``/tf`` and ``/tf_static``. ``host`` is the address of the network
    interface: with ``127.0.0.1`` nothing leaves this computer and nothing from outside is received; with ``0.0.0.0``
    Cyclone DDS chooses the interface, and ``CYCLONEDDS_URI`` applies. Raises `PublishError` if one is not valid.
    """

    def __init__(self, domain: int = 0, namespace: str = "", host: str = "127.0.0.1") -> None:
        namespace = namespace.strip("/")
        if namespace and not _NAMESPACE.fullmatch(namespace):
            raise PublishError(f"{namespace!r} is no namespace of ROS 2; use letters, digits, _ and /, no digit first")
        self._domain, self._host, self._namespace = domain, host, namespace
        self._writers: dict[str, Writer] = {}
        self._participant: Participant | None = None
        self._clients = 0

    def start(self) -> None:
        try:
            self._participant = Participant(self._domain, self._host)
        except ValueError as error:
            raise PublishError(f"ROS 2 cannot start on {self.status().place}: {error}") from error

    def announce(self, topics: Mapping[str, str]) -> None:
        assert self._participant is not None
        for topic, kind in topics.items():
            is_kept, name = topic in SAID_ONCE, ros_topic(topic, self._namespace)
            history = 1 if is_kept else _HISTORY
            self._writers[topic] = self._participant.write(name, kind, type_hash(kind), history, is_kept)

    def wanted(self) -> Collection[str]:
        counts = {topic: writer.subscribers for topic, writer in self._writers.items()}
        self._clients = max(counts.values(), default=0)
        return [topic for topic, count in counts.items() if count]

    def send(self, messages: Sequence[LiveMessage]) -> None:
        for message in messages:
            try:
                self._writers[message.topic].send(message.data)
            except ValueError as error:
                raise PublishError(f"ROS 2 refuses a message on {message.topic}: {error}") from error

    def close(self) -> None:
        self._writers.clear()
        if self._participant is not None:
            self._participant.close()
            self._participant = None
        self._clients = 0

    def status(self) -> SinkStatus:
        """Return the state; ``clients`` is the number of subscribers of the topic that has most."""
        place = f"domain {self._domain}, {self._host}"
        return SinkStatus("ROS 2", f"{place}, /{self._namespace}" if self._namespace else place, self._clients)
