import threading
import time
from collections import Counter
from multiprocessing import resource_tracker
from pathlib import Path

import pytest


@pytest.fixture
def nothing_left():
    """Check that no process, thread, descriptor or shared-memory segment is left by a test."""
    resource_tracker.ensure_running()  # it lives as long as this process
    before = _open_things()
    yield
    deadline_s = time.monotonic() + 60
    while (left := _open_things() - before) and time.monotonic() < deadline_s:
        time.sleep(0.02)
    assert not left


def _open_things():
    """Count this process's threads, descriptors, child processes and mappings of shared memory."""
    tasks = list(Path("/proc/self/task").iterdir())
    children = [number for task in tasks if task.exists() for number in (task / "children").read_text().split()]
    counted = Counter(thread=threading.active_count(), descriptor=len(list(Path("/proc/self/fd").iterdir())))
    counted.update(f"process {number}" for number in children)
    mappings = Path("/proc/self/maps").read_text().splitlines()
    counted.update(line.split(maxsplit=5)[-1] for line in mappings if "/dev/shm/" in line)
    counted.update(path.name for path in Path("/dev/shm").glob("psm_*"))
    return counted


@pytest.fixture
def until():
    """Wait until something holds; generous, since machines are busy."""

    def wait(holds, seconds=60.0):
        deadline_s = time.monotonic() + seconds
        while not holds():
            assert time.monotonic() < deadline_s, "it did not happen in time"
            time.sleep(0.005)

    return wait
