"""Files and folders as names of sources."""

from __future__ import annotations

from pathlib import Path

from ...core.errors import SourceError
from ...core.sources.base import SourceKind
from ...core.sources.registry import source_kinds


def recording_name(paths: list[Path]) -> str:
    """Return the name of the source that opens a folder, a file, or two files of two cameras."""
    if len(paths) == 1 and paths[0].is_dir():
        return f"folder:{paths[0]}"
    kinds = {recording_scheme(path): _kind_of(path) for path in paths}
    kind = next(iter(kinds.values())) if len(kinds) == 1 else None
    if kind is None:
        names = ", ".join(path.name for path in paths)
        what = "is neither a preset (.json) nor a recording" if len(paths) == 1 else "are recordings of different kinds"
        raise SourceError(
            f"{names} {what} (a folder with rig.json, or a file {' '.join(recording_endings())}); nothing was changed."
        )
    if len(paths) > kind.files:
        raise SourceError("Open one recording at a time, or the two .bag files of two cameras; nothing was changed.")
    return f"{kind.scheme}:{','.join(map(str, sorted(paths)))}"


def recording_endings() -> list[str]:
    """Return the endings of recordings, such as ``.bag``."""
    return [pattern.removeprefix("*") for kind in _file_kinds() for pattern in kind.pattern.split()]


def recording_filters() -> list[str]:
    """Return the filters of a file dialog, all recordings first."""
    patterns = " ".join(f"*{ending}" for ending in recording_endings())
    return [f"Recordings ({patterns})", *(f"{kind.title} ({kind.pattern})" for kind in _file_kinds())]


def recording_scheme(path: Path) -> str:
    """Return the scheme of the source that opens a file, by its name; empty if none does."""
    kind = _kind_of(path)
    return "" if kind is None else kind.scheme


def _kind_of(path: Path) -> SourceKind | None:
    name = Path(path.name.lower())
    return next((kind for kind in _file_kinds() if any(map(name.match, kind.pattern.split()))), None)


def _file_kinds() -> list[SourceKind]:
    return [kind for kind in source_kinds() if kind.needs == "file"]
