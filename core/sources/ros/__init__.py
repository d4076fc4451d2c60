"""ROS: messages and containers of recordings, live topics by DDS, and the sources that play both."""
