"""Files appear whole or not at all."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .errors import ExportError


@contextmanager
def atomic_path(target: Path | str) -> Iterator[Path]:
    """Yield a temporary path beside ``target``; on success it replaces ``target`` in one step.

    The temporary file keeps the target's suffix, so writers that choose a format by it work.
    Its folder is made if missing. On any error the temporary file is removed and ``target`` stays
    as it was.

    Raises
    ------
    ExportError
        The operating system refuses: no such folder, no permission, disk full.
    """
    target = Path(target)
    temporary = target.with_name(f".{target.stem}-{secrets.token_hex(4)}{target.suffix}")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        temporary.replace(target)
    except OSError as error:
        raise ExportError(f"cannot write {target}: {error.strerror or error}; choose another place") from error
    finally:
        with suppress(OSError):  # gone already, or its folder could not be made
            temporary.unlink()
