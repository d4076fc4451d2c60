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
    kinds = {path: _kind_of(path) for path in paths}
    kind = kinds[paths[0]]
    if kind is None or set(kinds.values()) != {kind}:
        names = ", ".join(path.name for path in paths)
        what = "is neither a preset (.json) nor a recording" if len(paths) == 1 else "are recordings of different kinds"
        endings = " ".join(pattern.removeprefix("*") for pattern in _patterns())
        raise SourceError(f"{names} {what} (a folder with rig.json, or a file {endings}); nothing was changed.")
    if len(paths) > kind.files:
        raise SourceError("Open one recording at a time, or the two .bag files of two cameras; nothing was changed.")
    return f"{kind.scheme}:{','.join(map(str, sorted(paths)))}"


def recording_filters() -> list[str]:
    """Return the filters of a file dialog, all recordings first."""
    return [
        f"Recordings ({' '.join(_patterns())})",
        *(f"{kind.title} ({kind.pattern})" for kind in _file_kinds()),
    ]


def _kind_of(path: Path) -> SourceKind | None:
    name = Path(path.name.lower())
    return next((kind for kind in _file_kinds() if any(map(name.match, kind.pattern.split()))), None)


def _patterns() -> list[str]:
    return [pattern for kind in _file_kinds() for pattern in kind.pattern.split()]


def _file_kinds() -> list[SourceKind]:
    return [kind for kind in source_kinds() if kind.needs == "file"]
