"""A finished sweep as a table: a row for each run, in a Parquet file."""

from __future__ import annotations

import importlib
import json
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from ..errors import ExportError, MissingExtraError
from ..model.files import atomic_path
from ..preset.file import preset_json
from .journal import Journal
from .plan import Plan
from .results import MEASURES

#: Under this key a file says of which sweep it is.
_METADATA: Final = b"tactune.sweep"

Row = dict[str, Any]


def sweep_rows(plan: Plan, journal: Journal) -> list[Row]:
    """Return a row for each finished run of a plan: what was run, all parameters, what was measured."""
    rows = []
    for run in plan.runs:
        if run.key in journal:
            result = journal[run.key]
            frames = run.take.frames
            row = {
                "key": run.key,
                "source": run.take.source,
                "seed": run.take.seed,
                "first_frame": frames.start,
                "end_frame": frames.stop,
                "frame_step": frames.step,
                "method": run.setting.method,
                **run.setting.parameters,
                **{name: getattr(result, name) for name in MEASURES},
                "failure": result.failure,
                "source_hash": run.take.identity,
                "code_hash": plan.code,
            }
            rows.append(row)
    return rows


def check_table(path: Path, journal: Path) -> None:
    """Refuse at once what cannot be written at the end.

    Raises
    ------
    MissingExtraError
        pyarrow is not installed.
    ExportError
        A file is there that no sweep has written, or the name has another suffix.
    """
    _pyarrow()
    if path.suffix != ".parquet":
        raise ExportError(f"--out is {path}; give a file that ends in .parquet")
    if path.exists() and not journal.exists():
        raise ExportError(f"{path} is already there, without its {journal.name}; choose another --out or remove it")


def check_replaced(path: Path, plan: Plan) -> None:
    """Refuse a plan whose table would lose runs that the table there has.

    Raises
    ------
    ExportError
        The file has such runs, or is no table of a sweep.
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
    """Write the rows as Parquet; the file appears whole or not at all.

    The preset that gave the parameters that were not swept stands in the file's metadata.

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
    """Return a column; values of several shapes, such as a pose or none, as JSON texts."""
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
