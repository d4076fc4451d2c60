"""Stand-in for ROS 2's package; see rclpy beside it."""

from ros_types import Float64

__all__ = ["Float64", "String"]


class String:
    """A name only."""
