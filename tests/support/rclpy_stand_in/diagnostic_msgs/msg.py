"""Stand-in for ROS 2's package; see rclpy beside it."""


class DiagnosticArray:
    """A name only."""
