"""Recordings as ROS 2 bags in MCAP, which Foxglove, RViz and rosbag2 open, too."""
