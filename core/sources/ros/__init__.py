"""Recordings of any ROS program: containers, topics, and the source that plays them."""
