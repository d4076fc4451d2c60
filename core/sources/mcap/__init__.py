"""Recordings as ROS 2 bags in MCAP: the format, its reader, and the source that plays them."""
