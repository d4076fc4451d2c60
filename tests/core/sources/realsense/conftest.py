"""Software cameras that tests control."""

import queue
import time

import pytest


class Session:
    """Two software cameras, opened by the class that opens hardware, and the frames that came from them."""

    def __init__(self, commands, source):
        self.source = source
        self.frames = []
        self._commands = commands

    def order(self, command):
        self._commands.put(command)

    def until(self, holds, timeout_s=60.0):
        """Read frames until the health is so."""
        deadline_s = time.monotonic() + timeout_s
        while not holds(health := self.source.health()):
            assert time.monotonic() < deadline_s, f"still {health}"
            self._read_one()
        return health

    def read(self, count):
        """Read this number of further frames."""
        wanted = len(self.frames) + count
        deadline_s = time.monotonic() + 300
        while len(self.frames) < wanted:
            assert time.monotonic() < deadline_s, f"no frames: {self.source.health()}"
            self._read_one()
        return self.frames[-count:]

    def _read_one(self):
        if self.source.wait(0.02):
            self.frames.append(self.source.next_frame())


@pytest.fixture
def session():
    pytest.importorskip("pyrealsense2", reason="the camera driver is not installed", exc_type=ImportError)
    from software_rig import open_software_rig

    commands = queue.Queue()
    with open_software_rig(commands) as source:
        opened = Session(commands, source)
        opened.read(1)
        yield opened
