"""Threads whose owner is gone: nobody waits for them until the program ends."""

from __future__ import annotations

import time

from PyQt6.QtCore import QThread

#: Qt aborts where a thread's object is deleted while it runs, so these are kept.
_left: list[QThread] = []


def leave_behind(thread: QThread) -> None:
    """Let a thread end by itself, silently, while its owner closes without waiting for it."""
    _left[:] = [old for old in _left if not old.isFinished()]
    thread.blockSignals(True)
    thread.setParent(None)
    _left.append(thread)


def wait_for_left(limit_s: float) -> bool:
    """Wait until those threads have ended, but no longer than a limit in all; return whether they have."""
    until = time.monotonic() + limit_s
    return all(thread.wait(max(0, round(1e3 * (until - time.monotonic())))) for thread in _left)
