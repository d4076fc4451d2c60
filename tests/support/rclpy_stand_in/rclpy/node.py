"""Nodes with subscriptions and timers."""

import os
import time
from array import array
from collections.abc import Callable
from typing import Any

from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from .qos import QoSProfile

# What ROS 2's Cyclone DDS gets with ROS_LOCALHOST_ONLY=1.
CONFIG = """<CycloneDDS><Domain><General><Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces></General>
</Domain></CycloneDDS>"""


class Publisher:
    """Keeps serialised messages."""

    def __init__(self, kind: type, topic: str, qos: QoSProfile) -> None:
        self.kind, self.topic, self.qos = kind, topic, qos
        self.subscribers = 0
        self.published: list[bytes] = []

    def publish(self, message: bytes) -> None:
        assert type(message) is bytes  # anything else would have to be a message object
        self.published.append(message)

    def get_subscription_count(self) -> int:
        return self.subscribers


class Node:
    """A node; ``qos`` of subscriptions is a depth, which means reliable and volatile, as in ROS 2."""

    latest: "Node | None" = None

    def __init__(self, name: str, *, namespace: str = "") -> None:
        self.name, self.namespace = name, namespace
        self.publishers: dict[str, Publisher] = {}
        self._participant: DomainParticipant | None = None
        self._readers: list[tuple[DataReader[Any], Callable[[Any], None]]] = []
        self._timers: list[list[Any]] = []
        Node.latest = self

    def create_publisher(self, kind: type, topic: str, qos: QoSProfile) -> Publisher:
        full = topic if topic.startswith("/") else f"/{self.namespace}/{topic}"
        self.publishers[full] = Publisher(kind, full, qos)
        return self.publishers[full]

    def destroy_node(self) -> None:
        Node.latest = None

    def create_subscription(self, kind: type, topic: str, callback: Callable[[Any], None], qos: int) -> None:
        if self._participant is None:
            number = int(os.environ.get("ROS_DOMAIN_ID", "0"))
            self._domain = Domain(number, CONFIG)
            self._participant = DomainParticipant(number)
        settings = Qos(Policy.Reliability.Reliable(max_blocking_time=0), Policy.History.KeepLast(qos))
        reader = DataReader(self._participant, Topic(self._participant, f"rt{topic}", kind), qos=settings)
        self._readers.append((reader, callback))

    def create_timer(self, period_s: float, callback: Callable[[], None]) -> None:
        self._timers.append([time.monotonic() + period_s, period_s, callback])

    def spin_once(self) -> None:
        for reader, callback in self._readers:
            for message in reader.take(1):
                if isinstance(getattr(message, "data", None), list):
                    message.data = array("B", message.data)  # as rclpy has it
                callback(message)
        for timer in self._timers:
            if time.monotonic() >= timer[0]:
                timer[0] += timer[1]
                timer[2]()
