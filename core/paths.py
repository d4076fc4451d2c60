"""Paths as people write them."""

from __future__ import annotations

from pathlib import Path


def user_path(path: Path | str) -> Path:
    """Return a path with a leading ``~`` replaced; where there is no such user, it stays as it is."""
    try:
        return Path(path).expanduser()
    except RuntimeError:
        return Path(path)
