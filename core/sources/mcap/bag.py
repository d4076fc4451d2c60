"""A ROS recording as a container: messages by topic and number, whatever program wrote them."""

from __future__ import annotations

import struct
from abc import ABC, abstractmethod
from functools import cache
from typing import Any, Final

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ...model.arrays import Int64Array
from .messages import TRANSFORMS, TYPES

#: Message types of poses. The library knows those of ROS 2 only.
POSES: Final = (TRANSFORMS, "tf/msg/tfMessage")


class Bag(ABC):
    """Messages of a recording, and their type by topic; not ``complete`` if its recorder was killed."""

    complete = True

    def __init__(self) -> None:
        self.types: dict[str, str] = {}

    @abstractmethod
    def count(self, topic: str) -> int:
        """Return the number of messages of a topic; 0 without the topic."""

    @abstractmethod
    def raw(self, topic: str, index: int) -> memoryview:
        """Return the bytes of a message, by its number in the order of the recorder's clock."""

    @abstractmethod
    def times_ns(self, topic: str) -> Int64Array:
        """Return when each message of a topic was recorded."""

    @abstractmethod
    def close(self) -> None:
        """Close the file; twice is harmless."""

    def is_ros1(self, topic: str) -> bool:
        """Whether the bytes of a topic's messages are ROS 1's, not CDR."""
        return False

    def message(self, topic: str, index: int) -> Any:
        data, kind = self.raw(topic, index), self.types[topic]
        if self.is_ros1(topic):
            return _ros1().deserialize_ros1(bytes(data), kind)
        return TYPES.deserialize_cdr(data, kind)

    def stamp_ns(self, topic: str, index: int) -> int:
        """Return the stamp in the header with which a message begins; no image is unpacked for it."""
        data = self.raw(topic, index)
        order = "<" if self.is_ros1(topic) or data[1] & 1 else ">"  # the second byte of CDR
        seconds, nanoseconds = struct.unpack_from(order + "II", data, 4)  # both put four bytes in front
        return int(seconds) * 10**9 + int(nanoseconds)


@cache
def _ros1() -> Any:
    types = get_typestore(Stores.ROS1_NOETIC)
    for name in POSES:
        types.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", name))
    return types


def long_name(kind: str) -> str:
    """Return a message type as ROS 2 writes it: ``sensor_msgs/msg/Image``."""
    package, _, name = kind.partition("/")
    return kind if name.startswith("msg/") else f"{package}/msg/{name}"
