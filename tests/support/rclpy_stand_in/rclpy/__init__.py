"""A stand-in for ROS 2's rclpy, for machines without ROS.

It has what docs/guide/robot.md and `tactune.core.output.ros` use. Subscriptions work by Cyclone DDS. Publishers only
keep what they are given, so they show nothing about ROS 2 itself.
"""

import time
from typing import Any

from .node import Node


def init(args: Any = None, *, context: Any = None, domain_id: int | None = None) -> None:
    """Note the domain; a node opens it."""
    if context is not None:
        context.domain_id = domain_id


def create_node(name: str, *, context: Any, namespace: str) -> Node:
    """Return a node."""
    assert context.domain_id is not None
    return Node(name, namespace=namespace)


def spin(node: Node) -> None:
    """Call the node's functions as messages come and time passes."""
    while True:
        node.spin_once()
        time.sleep(0.002)
