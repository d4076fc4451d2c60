"""Capture in a separate process, so that a driver that hangs or crashes does not stop the program."""
