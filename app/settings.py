"""Values that the window remembers between starts, and its default folders."""

from __future__ import annotations

import json
from base64 import b64decode, b64encode
from contextlib import suppress
from pathlib import Path
from typing import Final

from PyQt6.QtCore import QByteArray, QLockFile

from ..core.errors import ExportError
from ..core.model.files import atomic_path
from ..core.model.loading import read_json
from ..widgets.basics.controls import timer

RECENT_LIMIT = 10
#: Time from a change to its writing, ms.
_WRITE_AFTER_MS: Final = 1000
#: Longest wait for another window that is writing, ms.
_LOCK_MS: Final = 1000


class Settings:
    """Typed access to the remembered values; a missing or damaged file gives the defaults.

    The file is JSON with plain strings. It is not a `QSettings` file: PyQt unpickles values of those, so that a file of
    somebody else could run code. Two windows may share it: each writes only the values that it changed.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._values = _read(path)
        self._changed: dict[str, str] = {}
        self._timer = timer(None, _WRITE_AFTER_MS, self.sync, once=True)

    def text(self, key: str, default: str = "") -> str:
        return self._values.get(key, default)

    def blob(self, key: str) -> QByteArray:
        """Return remembered bytes, such as a window geometry; empty if there are none."""
        try:
            return QByteArray(b64decode(self.text(key), validate=True))
        except ValueError:
            return QByteArray()

    def set(self, key: str, value: str | float | QByteArray) -> None:
        text = b64encode(value.data()).decode() if isinstance(value, QByteArray) else str(value)
        self._values[key] = self._changed[key] = text
        self._timer.start()

    def recent(self, kind: str) -> list[str]:
        """Return the recent items of a kind, newest first."""
        return [item for item in self.text(f"recent/{kind}").split("\n") if item]

    def add_recent(self, kind: str, item: str) -> None:
        items = [item, *(other for other in self.recent(kind) if other != item)]
        self.set(f"recent/{kind}", "\n".join(items[:RECENT_LIMIT]))

    def remove_recent(self, kind: str, item: str) -> None:
        self.set(f"recent/{kind}", "\n".join(other for other in self.recent(kind) if other != item))

    def last_opened(self) -> tuple[str, str]:
        """Return the source and the preset file of the last window; empty if there was none, or if that is off."""
        return (self.text("last/source"), self.text("last/preset")) if self.text("reopen", "on") == "on" else ("", "")

    def sync(self) -> None:
        """Write to disk now; a disk that refuses loses only what is remembered."""
        self._timer.stop()
        if self._changed:
            lock = QLockFile(f"{self._path}.lock")  # another window may have read the file and not written it yet
            lock.tryLock(_LOCK_MS)
            with suppress(ExportError), atomic_path(self._path) as temporary:
                temporary.write_text(json.dumps(_read(self._path) | self._changed, indent=1), encoding="utf-8")
                self._changed = {}
            lock.unlock()


def _read(path: Path) -> dict[str, str]:
    try:
        found = read_json(path)
    except (OSError, ValueError):
        return {}
    return {key: it for key, it in found.items() if isinstance(it, str)} if isinstance(found, dict) else {}
