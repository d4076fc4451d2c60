"""Capture in a process of its own: a driver that hangs or crashes takes nothing else down."""

from .source import ProcessSource

__all__ = ["ProcessSource"]
