"""Atomic writing of files, numbers, tables and units as files hold them, and paths as users write them."""

from __future__ import annotations

import csv
import glob
import hashlib
import math
import os
import secrets
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, Final, Literal, Self

from ..errors import ExportError, writing

#: A temporary file that nobody has written to for this time was left by a killed writer, seconds.
LEFT_S: Final = 3600


class Closing:
    """A context manager that closes itself."""

    def close(self) -> object: ...

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@contextmanager
def atomic_path(target: Path | str, *, follow_link: bool = False, exclusive: bool = False) -> Iterator[Path]:
    """Yield a temporary path beside ``target``; on success it replaces ``target`` in one step.

    The temporary file has the suffix of the target, for writers that choose a format by it. Its folder is created if
    missing. On any error the temporary file is removed and ``target`` is unchanged. An ``exclusive`` one is refused
    where there is a file, also one that another program has made meanwhile.
    """
    final = Path(os.path.realpath(target)) if follow_link else Path(target)
    temporary = final.parent / f".{final.stem}-{secrets.token_hex(4)}{final.suffix}"
    try:
        with writing(target):
            if exclusive and os.path.lexists(final):
                raise taken(target)
            _check_ordinary(final)
            final.parent.mkdir(parents=True, exist_ok=True)
            yield temporary
            with temporary.open("rb+") as file:
                os.fsync(file.fileno())
            if exclusive:
                _take_name(temporary, final)
            temporary.replace(final)
    finally:
        with suppress(OSError):  # gone already, or its folder could not be made
            temporary.unlink()


def _check_ordinary(target: Path) -> None:
    if target.exists() and not target.is_file():
        raise ExportError(f"cannot write {target}: it is no ordinary file; choose another place")


def _take_name(temporary: Path, final: Path) -> None:
    """Give a complete file its name, unless another program has taken it meanwhile."""
    try:
        with suppress(OSError):  # where this fails: the name is taken, or a memory card's file system has no links
            os.link(temporary, final)
            return
        final.open("xb").close()
    except FileExistsError:
        raise taken(final) from None


def taken(path: Path | str) -> ExportError:
    """Return the refusal of a name under which there is something already, also since a moment ago."""
    return ExportError(f"{path} is already there; choose another name or remove it")


def remove_leftovers(folder: Path, name: str = "*") -> None:
    """Remove temporary files of killed writers of a file or folder; of all, also in subfolders, for the name ``*``."""
    stem, suffix = (("*", "*")) if name == "*" else (glob.escape(Path(name).stem), glob.escape(Path(name).suffix))
    pattern = f".{stem}-{'[0-9a-f]' * 8}{suffix}"
    with suppress(OSError):
        for left in folder.rglob(pattern) if name == "*" else folder.glob(pattern):
            if left.stat().st_mtime < time.time() - LEFT_S:
                shutil.rmtree(left) if left.is_dir() else left.unlink()


def check_writable(target: Path | str | None) -> None:
    """Raise if a file cannot be written there, so that nobody waits for a result in vain. Nothing is left behind."""
    if target is None:
        return
    _check_ordinary(Path(target))
    final = Path(target).absolute()
    folder = next(parent for parent in final.parents if parent.exists())
    temporary = folder / f".{secrets.token_hex(8)}"
    with writing(target):
        temporary.touch(exist_ok=False)
        temporary.unlink()


def finite_or_none(number: float | None) -> float | None:
    """Return a number as JSON can hold it: nan and infinity become None."""
    return None if number is None or not math.isfinite(number) else float(number)


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows with equal keys as CSV, atomically; None becomes an empty cell."""
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]) if rows else [], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def user_path(path: Path | str) -> Path:
    """Return a path with a leading ``~`` expanded; unchanged if there is no such user."""
    try:
        return Path(path).expanduser()
    except RuntimeError:
        return Path(path)


def recording_files(text: str) -> tuple[Path, ...]:
    """Return the one or two files that a name means; empty where there are none.

    A name is a path, or two paths with a comma between them. Paths may contain commas: a name that is a file as
    it stands is that file, else it is split at the first comma with a file on either side.
    """
    if _is_file(user_path(text)):
        return (user_path(text),)
    for at, letter in enumerate(text):
        if letter == ",":
            first, second = user_path(text[:at]), user_path(text[at + 1 :])
            if _is_file(first) and _is_file(second):
                return first, second
    return ()


def recording_paths(text: str) -> tuple[Path, ...]:
    """Return the file, the folder, or the two files that a name means, also where there are none."""
    return recording_files(text) or (user_path(text),)


def path_exists(path: Path | str) -> bool:
    """Return whether there is something at a path; no for a path that the operating system refuses to look at."""
    try:
        return user_path(path).exists()
    except OSError:  # such as a name that is too long
        return False


def _is_file(path: Path) -> bool:
    return path_exists(path) and path.is_file()


@cache
def code_version() -> str:
    """Return a hash of the core's source code, on which every result depends."""
    digest = hashlib.sha256()
    core = Path(__file__).parents[1]
    for file in sorted(core.rglob("*.py")):
        digest.update(str(file.relative_to(core)).encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()


MeshUnit = Literal["m", "cm", "mm", "in"]
#: Metres of each unit.
UNITS_M: Final[Mapping[str, float]] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
