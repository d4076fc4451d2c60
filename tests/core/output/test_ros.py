"""Topics by rclpy, which cannot be installed here: its stand-in in tests/support shows what we call only."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tactune.core.errors import MissingExtraError
from tactune.core.output.messages import NUMBER, number
from tactune.core.output.publisher import LIVE_TOPICS, LiveMessage
from tactune.core.output.ros import RosSink

STAND_IN = Path(__file__).resolve().parents[2] / "support" / "rclpy_stand_in"


@pytest.fixture
def node_class(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Let this process find the stand-in; return its class of nodes."""
    before = set(sys.modules)
    monkeypatch.syspath_prepend(str(STAND_IN))
    from rclpy.node import Node

    yield Node
    for name in set(sys.modules) - before:
        del sys.modules[name]


def test_a_node_publishes_the_bytes_that_somebody_wants(node_class: Any) -> None:
    sink = RosSink(3, "left/finger")
    sink.start(LIVE_TOPICS)
    node = node_class.latest
    outside = {"/tf", "/tf_static", "/tactune/frame", "/tactune/rig"}
    namespaced = {f"/left/finger{topic}" for topic in LIVE_TOPICS if topic not in outside}
    named = {"/tf", "/tf_static", "/left/finger/frame", "/left/finger/rig"}
    assert node.publishers.keys() == namespaced | named
    assert node.publishers["/left/finger/contact/patch"].kind.__name__ == "PointCloud2"
    assert node.publishers["/tf_static"].qos.durability.name == "TRANSIENT_LOCAL"
    assert not sink.wanted()
    area = node.publishers["/left/finger/contact/area_mm2"]
    area.subscribers = 2
    assert sink.wanted() == ["/contact/area_mm2"]
    assert sink.status().clients == 2
    sink.send([LiveMessage("/contact/area_mm2", NUMBER, number(7.5), 0)])
    assert area.published == [number(7.5)]
    sink.close()
    sink.close()
    assert node_class.latest is None


def test_without_ros_it_says_what_to_source() -> None:
    with pytest.raises(MissingExtraError, match="source ROS 2"):
        RosSink(0, "").start(LIVE_TOPICS)
