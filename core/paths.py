"""Paths as people write them."""

from __future__ import annotations

from pathlib import Path

from .errors import TactuneError


def user_path(path: Path | str) -> Path:
    """Return a path with a leading ``~`` replaced; where there is no such user, it stays as it is."""
    try:
        return Path(path).expanduser()
    except RuntimeError:
        return Path(path)


def refuse_devices(path: Path, error: type[TactuneError]) -> None:
    """Raise ``error`` where there is something that is no ordinary file: a device might never end."""
    if path.exists() and not path.is_file():
        raise error(f"{path} is no ordinary file; name another")
