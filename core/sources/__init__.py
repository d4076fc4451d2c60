"""Sources of frames: simulator, folders, recordings, live cameras, and those of other packages."""

from .base import FrameSource, Health, SeekableSource

__all__ = ["FrameSource", "Health", "SeekableSource"]
