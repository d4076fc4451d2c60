"""A stand-in for ROS 2's rclpy, for machines without ROS: the little that docs/guide/robot.md uses, by Cyclone DDS."""

import time

from .node import Node


def init() -> None:
    """Do nothing; a node opens the domain."""


def spin(node: Node) -> None:
    """Call the node's functions as messages come and time passes."""
    while True:
        node.spin_once()
        time.sleep(0.002)
