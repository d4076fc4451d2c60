"""Recordings that librealsense writes: ROS 1 ``.bag`` files and, from 2.58 on, ``.db3`` files."""
