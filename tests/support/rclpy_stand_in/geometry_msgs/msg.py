"""Stand-in for ROS 2's package; see rclpy beside it."""

from ros_types import PoseWithCovarianceStamped, Vector3Stamped

__all__ = ["PoseWithCovarianceStamped", "Vector3Stamped"]
