"""Values that the window remembers between starts, and its default folders."""

from __future__ import annotations

from pathlib import Path

import platformdirs
from PyQt6.QtCore import QByteArray, QSettings

RECENT_LIMIT = 10


def default_data_folder() -> Path:
    """Return the operating system's folder for application data, used for unsaved work."""
    return Path(platformdirs.user_data_dir("tactune"))


def default_settings_file() -> Path:
    """Return the file for window layout, theme and recent files."""
    return Path(platformdirs.user_config_dir("tactune")) / "window.ini"


def default_recordings_folder() -> Path:
    """Return the folder for recordings in the user's documents."""
    return Path(platformdirs.user_documents_dir()) / "Tactune"


class Settings:
    """Typed access to the remembered values; a missing or damaged file gives the defaults."""

    def __init__(self, path: Path) -> None:
        self._store = QSettings(str(path), QSettings.Format.IniFormat)

    def text(self, key: str, default: str = "") -> str:
        """Return a remembered string."""
        value = self._store.value(key)
        return value if isinstance(value, str) else default

    def number(self, key: str, default: float) -> float:
        """Return a remembered number."""
        try:
            return float(self.text(key))
        except ValueError:
            return default

    def blob(self, key: str) -> QByteArray:
        """Return remembered bytes, such as a window geometry; empty if there are none."""
        value = self._store.value(key)
        return value if isinstance(value, QByteArray) else QByteArray()

    def set(self, key: str, value: str | float | QByteArray) -> None:
        """Remember a value."""
        self._store.setValue(key, value if isinstance(value, QByteArray) else str(value))

    def recent(self, kind: str) -> list[str]:
        """Return the recent items of a kind, newest first."""
        return [item for item in self.text(f"recent/{kind}").split("\n") if item]

    def add_recent(self, kind: str, item: str) -> None:
        """Put an item on top of the recent list of its kind."""
        items = [item, *(other for other in self.recent(kind) if other != item)]
        self.set(f"recent/{kind}", "\n".join(items[:RECENT_LIMIT]))

    def remove_recent(self, kind: str, item: str) -> None:
        """Remove an item from the recent list of its kind."""
        self.set(f"recent/{kind}", "\n".join(other for other in self.recent(kind) if other != item))

    def sync(self) -> None:
        """Write to disk now."""
        self._store.sync()
