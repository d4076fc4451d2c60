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

# What ROS 2's Cyclone DDS gets with ROS_LOCALHOST_ONLY=1.
CONFIG = """<CycloneDDS><Domain><General><Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces></General>
</Domain></CycloneDDS>"""


class Node:
    """A node; ``qos`` of subscriptions is a depth, which means reliable and volatile, as in ROS 2."""

    def __init__(self, name: str) -> None:
        number = int(os.environ.get("ROS_DOMAIN_ID", "0"))
        self._domain = Domain(number, CONFIG)
        self._participant = DomainParticipant(number)
        self._readers: list[tuple[DataReader[Any], Callable[[Any], None]]] = []
        self._timers: list[list[Any]] = []

    def create_subscription(self, kind: type, topic: str, callback: Callable[[Any], None], qos: int) -> None:
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
