"""Files and folders as names of sources."""

from __future__ import annotations

import re
from fnmatch import fnmatch
from functools import partial
from pathlib import Path

from ...core.errors import SourceError
from ...core.sources.registry import source_kinds

#: Kinds of recordings that may consist of two files, one for each camera.
_IN_TWO_FILES = ("bag",)


def recording_name(paths: list[Path]) -> str:
    """Return the name of the source that opens a folder, a file, or two files of two cameras.

    Raises
    ------
    SourceError
        No source opens them, or not together.
    """
    if len(paths) == 1 and paths[0].is_dir():
        return f"folder:{paths[0]}"
    schemes = {recording_scheme(path) for path in paths}
    scheme = schemes.pop() if len(schemes) == 1 else ""
    if not scheme:
        names = ", ".join(path.name for path in paths)
        what = "is neither a preset (.json) nor a recording" if len(paths) == 1 else "are recordings of different kinds"
        endings = " ".join(recording_endings())
        raise SourceError(f"{names} {what} (a folder with rig.json, or a file {endings}); nothing was changed.")
    if len(paths) > (2 if scheme in _IN_TWO_FILES else 1):
        raise SourceError("Open one recording at a time, or the two .bag files of two cameras; nothing was changed.")
    return f"{scheme}:{','.join(map(str, sorted(paths)))}"


def _patterns() -> dict[str, list[str]]:
    """Return the file patterns of each kind of recording that is a file."""
    return {kind.scheme: re.split(r"[ ,;]+", kind.pattern) for kind in source_kinds() if kind.needs == "file"}


def recording_endings() -> list[str]:
    """Return the endings of recordings, such as ``.bag``."""
    return [pattern.removeprefix("*") for patterns in _patterns().values() for pattern in patterns]


def recording_filters() -> list[str]:
    """Return the filters of a file dialog, all recordings first."""
    kinds = {kind.scheme: kind.title for kind in source_kinds()}
    single = [f"{kinds[scheme]} ({' '.join(patterns)})" for scheme, patterns in _patterns().items()]
    return [f"Recordings ({' '.join(f'*{ending}' for ending in recording_endings())})", *single]


def recording_scheme(path: Path) -> str:
    """Return the scheme of the source that opens a file, by its name; empty if none does."""
    name = path.name.lower()
    return next((scheme for scheme, patterns in _patterns().items() if any(map(partial(fnmatch, name), patterns))), "")
