"""Where finished runs are kept: a file that only grows, a line for each run."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import IO, Final, Self

from ..errors import ExportError
from ..model.files import refuse_devices
from .results import Result, result_from_json
from .values import SweepError

_HEADER: Final = b'{"journal":"tactune.sweep","version":1}\n'


class Journal:
    """The finished runs of a sweep; a context manager that no second process can enter.

    A run is safe on the disk when `add` returns. A line that a crash cut off is dropped.

    Parameters
    ----------
    path : Path
        Made where it is missing.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._results: dict[str, Result] = {}

    def __enter__(self) -> Self:
        """Open and read the file.

        Raises
        ------
        SweepError
            Another process has it open, or it is no journal.
        ExportError
            It cannot be written.
        """
        refuse_devices(self.path, SweepError)
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self.path.open("a+b")
        except OSError as error:
            raise self._cannot_write(error) from error
        try:
            _lock(self._file, self.path)
            self.read()
        except BaseException:
            self._file.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with suppress(OSError):  # what `add` could not write it has told
            self._file.close()

    def __contains__(self, key: str) -> bool:
        return key in self._results

    def __getitem__(self, key: str) -> Result:
        return self._results[key]

    def add(self, results: Iterable[Result]) -> None:
        """Keep results; one whose run is there already is left out.

        Raises
        ------
        ExportError
            The disk is full or refuses.
        """
        fresh: dict[str, Result] = {}
        for result in results:
            if result.key not in self._results:
                fresh.setdefault(result.key, result)
        lines = "".join(json.dumps(asdict(result), allow_nan=False) + "\n" for result in fresh.values())
        try:
            self._write(lines.encode())
        except OSError as error:
            raise self._cannot_write(error) from error
        self._results |= fresh

    def read(self) -> None:
        """Read the file anew, such as after an interrupted `add`.

        Raises
        ------
        SweepError
            It is no journal.
        """
        self._file.seek(0)
        data = self._file.read()
        if not data:
            self._write(_HEADER)
        elif not data.startswith(_HEADER):
            raise SweepError(f"{self.path} is there already and keeps no sweep; choose another --out")
        whole = data[: data.rfind(b"\n") + 1]
        if len(whole) < len(data):
            self._file.truncate(len(whole))
        for line in whole.splitlines()[1:]:
            try:
                result = result_from_json(json.loads(line))
            except ValueError:  # a damaged line: its run is done again
                continue
            self._results[result.key] = result

    def _write(self, data: bytes) -> None:
        self._file.write(data)
        self._file.flush()
        os.fsync(self._file.fileno())

    def _cannot_write(self, error: OSError) -> ExportError:
        return ExportError(f"cannot write {self.path}: {error.strerror or error}; choose another place with --out")


def _lock(file: IO[bytes], path: Path) -> None:
    """Lock a file until it is closed, also by a crash."""
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        raise SweepError(
            f"another sweep is writing to {path} ({error.strerror}); wait for it or choose another --out"
        ) from error
