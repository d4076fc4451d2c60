"""Runs a sweep: the journal of finished runs, the loop over all runs, and the table of results."""

from __future__ import annotations

import importlib
import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from types import ModuleType, TracebackType
from typing import IO, Any, Final, Self

from ..errors import ExportError, MissingExtraError
from ..model.files import atomic_path, refuse_devices
from ..preset.file import preset_json
from .plan import Batch, Plan
from .results import MEASURES, Result, result_from_json
from .values import SweepError

_HEADER: Final = b'{"journal":"tactune.sweep","version":1}\n'


class Journal:
    """Journal of the finished runs of a sweep; a context manager that locks the file against other processes.

    When `add` returns, the run is on the disk. A line that was cut off by a crash is ignored.

    Parameters
    ----------
    path : Path
        Created if it does not exist.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._results: dict[str, Result] = {}

    def __enter__(self) -> Self:
        """Open and read the file.

        Raises
        ------
        SweepError
            Another process has it open, or it is not a journal.
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
        except OSError as error:
            self._close()
            raise self._cannot_write(error) from error
        except BaseException:
            self._close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close()

    def _close(self) -> None:
        with suppress(OSError):  # the write error was already raised
            self._file.close()

    def __contains__(self, key: str) -> bool:
        return key in self._results

    def __getitem__(self, key: str) -> Result:
        return self._results[key]

    def add(self, results: Iterable[Result]) -> None:
        """Add results; results of runs that are already in the journal are ignored.

        Raises
        ------
        ExportError
            The disk is full, or the file cannot be written.
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
        """Read the file again, for example after an interrupted `add`.

        Raises
        ------
        SweepError
            The file is not a journal.
        """
        self._file.seek(0)
        data = self._file.read()
        if not data:
            self._write(_HEADER)
        elif not data.startswith(_HEADER):
            raise SweepError(f"{self.path} exists and is not a sweep journal; choose another --out")
        whole = data[: data.rfind(b"\n") + 1]
        if len(whole) < len(data):
            self._file.truncate(len(whole))
        for line in whole.splitlines()[1:]:
            try:
                result = result_from_json(json.loads(line))
            except ValueError:  # a damaged line: its run is repeated
                continue
            self._results[result.key] = result

    def _write(self, data: bytes) -> None:
        self._file.write(data)
        self._file.flush()
        os.fsync(self._file.fileno())

    def _cannot_write(self, error: OSError) -> ExportError:
        return ExportError(f"cannot write {self.path}: {error.strerror or error}; choose another place with --out")


def _lock(file: IO[bytes], path: Path) -> None:
    """Lock a file until it is closed; a crash releases the lock."""
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


#: Runs batches in any order, and yields the results of each batch when it is done.
Engine = Callable[[Iterable[Batch]], Iterator[list[Result]]]


def measure_sweep(plan: Plan, journal: Journal, engine: Engine, workers: int) -> Iterator[int]:
    """Process the runs that are missing in the journal, and yield the number of finished runs, earlier ones included.

    To cancel, close the iterator or raise an error. Every counted run is in the journal.

    Parameters
    ----------
    plan : Plan
    journal : Journal
        Open journal; each run is stored in it at once.
    engine : callable
        Such as `local.run_locally` with a number of processes, or `cluster.Cluster.run`.
    workers : int
        Number of batches that the engine processes at once.

    Raises
    ------
    TactuneError
        The engine fails, or a run cannot be stored.
    """
    done = sum(run.key in journal for run in plan.runs)
    yield done
    finished = engine(plan.batches(journal.__contains__, workers))
    try:
        for results in finished:
            journal.add(results)
            done += len(results)
            yield done
    finally:
        close = getattr(finished, "close", None)
        if close is not None:
            close()


#: Metadata key of the sweep's identity.
_METADATA: Final = b"tactune.sweep"

Row = dict[str, Any]


def sweep_rows(plan: Plan, journal: Journal) -> list[Row]:
    """Return a row for each finished run of a plan: method, clip, all parameters and all measures."""
    rows = []
    for run in plan.runs:
        if run.key in journal:
            result = journal[run.key]
            frames = run.clip.frames
            row = {
                "key": run.key,
                "source": run.clip.source,
                "seed": run.clip.seed,
                "first_frame": frames.start,
                "end_frame": frames.stop,
                "frame_step": frames.step,
                "method": run.setting.method,
                **run.setting.parameters,
                **{name: getattr(result, name) for name in MEASURES},
                "failure": result.failure,
                "source_hash": run.clip.identity,
                "code_hash": plan.code,
            }
            rows.append(row)
    return rows


def check_table(path: Path, journal: Path) -> None:
    """Raise before the sweep if its table could not be written at the end.

    Raises
    ------
    MissingExtraError
        pyarrow is not installed.
    ExportError
        The name has another suffix, or the existing file was not written by a sweep.
    """
    _pyarrow()
    if path.suffix != ".parquet":
        raise ExportError(f"--out is {path}; give a file that ends in .parquet")
    if path.exists() and not journal.exists():
        raise ExportError(f"{path} is already there, without its {journal.name}; choose another --out or remove it")


def check_replaced(path: Path, plan: Plan) -> None:
    """Raise if the existing table has runs that are not in the plan, because they would be lost.

    Raises
    ------
    ExportError
        The table has such runs, or the file is not a table of a sweep.
    """
    if not path.exists():
        return
    pyarrow, parquet = _pyarrow(), importlib.import_module("pyarrow.parquet")
    try:
        there = set(parquet.read_table(path, columns=["key"]).column("key").to_pylist())
    except (OSError, KeyError, pyarrow.ArrowException) as error:
        raise ExportError(f"{path} is there and is no table of a sweep; choose another --out or remove it") from error
    lost = len(there - {run.key for run in plan.runs})
    if lost:
        raise ExportError(
            f"{path} has {lost} of its {len(there)} runs from another sweep or version of Tactune, which would be "
            "gone; choose another --out, or add --replace"
        )


def write_table(path: Path, plan: Plan, rows: list[Row]) -> None:
    """Write the rows as Parquet, atomically.

    The file's metadata contains the preset with the parameters that were not swept.

    Raises
    ------
    ExportError
        The file cannot be written.
    """
    pyarrow = _pyarrow()
    parquet = importlib.import_module("pyarrow.parquet")
    columns = {name: _column(pyarrow, name, [row[name] for row in rows]) for name in rows[0]}
    about = {"swept": plan.paths, "preset": json.loads(preset_json(plan.base)), "version": version("tactune")}
    table = pyarrow.table(columns).replace_schema_metadata({_METADATA: json.dumps(about)})
    with atomic_path(path) as temporary:
        parquet.write_table(table, temporary)


def _column(pyarrow: ModuleType, name: str, values: list[Any]) -> Any:
    """Return a column; values of mixed types, such as a pose or None, are stored as JSON text."""
    if any(isinstance(value, dict) or (isinstance(value, list) and value and isinstance(value[0], list))
           for value in values):  # fmt: skip
        return pyarrow.array([None if value is None else json.dumps(value) for value in values], pyarrow.string())
    if all(value is None for value in values):
        return pyarrow.array(values, pyarrow.float64() if name in MEASURES else pyarrow.string())
    return pyarrow.array(values)


def _pyarrow() -> ModuleType:
    try:
        import pyarrow
    except ImportError as error:
        raise MissingExtraError("sweeps need pyarrow: install it with pip install 'tactune[sweep]'") from error
    return pyarrow  # type: ignore[no-any-return]
