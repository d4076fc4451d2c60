"""ROS 2 topics by an installed and sourced ROS 2: whichever middleware it has, Zenoh included."""

from __future__ import annotations

import importlib
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from ..errors import MissingExtraError, PublishError
from .messages import SAID_ONCE, ros_topic
from .publisher import LiveMessage, SinkStatus

#: Messages of a topic that are kept for repeats, as in `DdsSink`.
_HISTORY = 4


class RosSink:
    """Publishers of a ROS 2 node; a `tactune.core.output.publisher.Sink`. The messages are passed on as they are.

    Which network is used follows from ROS 2's own environment, such as ``ROS_AUTOMATIC_DISCOVERY_RANGE``.

    Parameters
    ----------
    domain : int
        Domain id.
    namespace : str
        Put before every topic but ``/tf`` and ``/tf_static``.
    """

    def __init__(self, domain: int, namespace: str) -> None:
        self._domain, self._namespace = domain, namespace.strip("/")
        self._context: Any = None
        self._node: Any = None
        self._publishers: dict[str, Any] = {}
        self._clients = 0

    def start(self, topics: Mapping[str, str]) -> None:
        """Announce topics; see `Sink`."""
        try:
            import rclpy
            from rclpy.context import Context
            from rclpy.qos import DurabilityPolicy, QoSProfile
        except ImportError as error:
            raise MissingExtraError(
                f"rclpy cannot be imported ({error}): source ROS 2 in this shell, with the Python version of Tactune, "
                "or use --ros2, which needs no ROS"
            ) from error
        try:
            self._context = Context()
            rclpy.init(args=[], context=self._context, domain_id=self._domain)
            self._node = rclpy.create_node("tactune", context=self._context, namespace=self._namespace)
            for topic, type_name in topics.items():
                package, _, kind = type_name.split("/")
                is_kept = topic in SAID_ONCE
                durability = DurabilityPolicy.TRANSIENT_LOCAL if is_kept else DurabilityPolicy.VOLATILE
                self._publishers[topic] = self._node.create_publisher(
                    getattr(importlib.import_module(f"{package}.msg"), kind),
                    ros_topic(topic, self._namespace),
                    QoSProfile(depth=1 if is_kept else _HISTORY, durability=durability),
                )
        except Exception as error:  # rclpy has kinds of its own for names, the middleware and missing packages
            self.close()
            raise PublishError(f"ROS 2 cannot start: {error}") from error

    def wanted(self) -> Collection[str]:
        """Return the topics that have subscribers."""
        counts = {topic: publisher.get_subscription_count() for topic, publisher in self._publishers.items()}
        self._clients = max(counts.values(), default=0)
        return [topic for topic, count in counts.items() if count]

    def send(self, messages: Sequence[LiveMessage]) -> None:
        """Publish messages."""
        for message in messages:
            self._publishers[message.topic].publish(message.data)

    def tell(self, subject: str, sentence: str) -> None:
        """Do nothing: ROS 2 has ``/diagnostics``."""

    def close(self) -> None:
        """Destroy the node; twice is harmless."""
        self._publishers.clear()
        if self._node is not None:
            self._node.destroy_node()
            self._node = None
        if self._context is not None:
            self._context.try_shutdown()
            self._context = None
        self._clients = 0

    def status(self) -> SinkStatus:
        """Return the state; ``clients`` is the number of subscribers of the topic that has most."""
        return SinkStatus("ROS 2 (rclpy)", f"domain {self._domain}, /{self._namespace}", self._clients)
