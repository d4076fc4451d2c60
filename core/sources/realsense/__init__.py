"""Live cameras through librealsense: an Intel RealSense L515 and a D405."""
