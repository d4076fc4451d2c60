"""The factor by which timeouts grow on a busy machine."""

from __future__ import annotations

import os


def load_factor() -> float:
    """Return the running processes per processor over the last minute, at least 1."""
    return max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))
