"""ROS 2 bags in MCAP: Tactune's own recordings, and bags of other programs with the same topics."""
