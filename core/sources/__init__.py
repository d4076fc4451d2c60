"""Where frames come from: the simulator, folders of images, RealSense bags."""

from .base import FrameSource, Health, SeekableSource

__all__ = ["FrameSource", "Health", "SeekableSource"]
