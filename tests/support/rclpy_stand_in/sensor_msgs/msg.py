"""Stand-in for ROS 2's package; see rclpy beside it."""

from ros_types import PointCloud2

__all__ = ["CameraInfo", "Image", "PointCloud2"]


class Image:
    """A name only."""


class CameraInfo:
    """A name only."""
