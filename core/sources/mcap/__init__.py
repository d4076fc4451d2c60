"""ROS 2 bags in MCAP: Tactune's own recordings, and copies that ROS tools made of them."""
