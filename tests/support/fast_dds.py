"""Nodes of Fast DDS, ROS 2's default middleware, in processes of their own; see fast_dds_node.cpp."""

from __future__ import annotations

import shutil
import struct
import subprocess
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ros_messages import decoded
from tactune.core.output.publisher import LIVE_TOPICS

WAIT_S = 60
HOW_TO_BUILD = "apt-get install libfastrtps-dev g++ (Debian 12, Ubuntu 22.04 and 24.04)"

_SOURCE = Path(__file__).with_name("fast_dds_node.cpp")


def can_build() -> bool:
    """Return whether compiler and headers of Fast DDS 2 are installed."""
    return Path("/usr/include/fastrtps").exists() and shutil.which("g++") is not None


def build(folder: Path) -> Path:
    """Compile the node, in about 4 s, and return the program."""
    program = folder / "fast_dds_node"
    subprocess.run(["g++", "-std=c++17", "-o", program, _SOURCE, "-lfastrtps"], check=True)
    return program


class FastDds:
    """A subscriber of Fast DDS in a process of its own; ``topics`` are ROS 2 names with their kinds of subscription."""

    def __init__(self, program: Path, domain: int, topics: Mapping[str, str], namespace: str = "") -> None:
        self.topics = list(topics)
        words = [
            word
            for topic, qos in topics.items()
            for word in (f"rt{namespace}{topic}", _dds_name(LIVE_TOPICS[topic]), qos)
        ]
        self.process = subprocess.Popen(
            [program, "subscribe", str(domain), *words], stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=1 << 20
        )
        self.counts = dict.fromkeys(self.topics, 0)
        self.latest: dict[str, bytes] = {}
        self._arrived = threading.Condition()
        self._thread = threading.Thread(target=self._read)
        self._thread.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        while len(head := self.process.stdout.read(8)) == 8:
            number, length = struct.unpack("<II", head)
            data, topic = self.process.stdout.read(length), self.topics[number]
            if len(data) < length:  # the program was killed while it wrote
                return
            with self._arrived:
                self.latest[topic] = data
                self.counts[topic] += 1
                self._arrived.notify_all()

    def wait_for(self, is_done: Callable[[], bool]) -> None:
        with self._arrived:
            assert self._arrived.wait_for(is_done, WAIT_S), self.counts

    def decoded(self, topic: str) -> Any:
        """Return the latest message, decoded by the ROS 2 decoder of MCAP."""
        return decoded(LIVE_TOPICS[topic], self.latest[topic])

    def __enter__(self) -> FastDds:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self._thread.join()
        self.process.communicate()


class FastDdsPublisher:
    """A publisher of Fast DDS; ``topics`` are ROS 2 names with type and kind of offer."""

    def __init__(self, program: Path, domain: int, topics: Mapping[str, tuple[str, str]]) -> None:
        self._numbers = {topic: number for number, topic in enumerate(topics)}
        words = [word for topic, (kind, qos) in topics.items() for word in (f"rt{topic}", _dds_name(kind), qos)]
        self.process = subprocess.Popen([program, "publish", str(domain), *words], stdin=subprocess.PIPE)

    def send(self, topic: str, data: bytes) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(struct.pack("<II", self._numbers[topic], len(data)) + data)
        self.process.stdin.flush()

    def close(self) -> None:
        self.process.communicate()


def _dds_name(message_type: str) -> str:
    package, kind, name = message_type.split("/")
    return f"{package}::{kind}::dds_::{name}_"
