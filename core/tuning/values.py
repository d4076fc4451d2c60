"""Values of the swept fields: lists, ranges, grids, samples, and the sweep file."""

from __future__ import annotations

import itertools
import json
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ..errors import TactuneError
from ..methods.registry import fields_of
from ..model.files import refuse_devices
from ..preset import CONTACT_TESTS, Preset
from ..preset.preset import preset_paths, set_path

#: Fields with metadata, which do not affect results.
_ABOUT: Final = ("name", "notes", "created", "modified", "rig", "alignment.calibration")
#: Fields that affect results but cannot be swept.
_FIXED: Final = ("untouched",)

#: The contact test that uses each section.
_TEST_OF: Final = {section: test.name for test in CONTACT_TESTS.values() for section in test.section_names}

#: Upper limit of the runs of a sweep; larger grids must be sampled.
MAX_RUNS: Final = 100_000

_RANGE: Final = re.compile(r"([^:]+):([^:]+?)(?::([0-9]*)(log)?)?")


class SweepError(TactuneError):
    """A sweep cannot be planned, run or stored."""


@dataclass(frozen=True)
class Choice:
    """Values from a list."""

    path: str
    values: tuple[Any, ...]


@dataclass(frozen=True)
class Span:
    """Values from a range; ``count`` is None if the range can only be sampled."""

    path: str
    low: float
    high: float
    count: int | None
    log: bool


Axis = Choice | Span


def result_paths() -> list[str]:
    """Return the paths of the preset fields that affect results."""
    return [path for path in preset_paths() if path not in _ABOUT and not path.startswith("cameras.")]


def parse_axis(text: str) -> Axis:
    """Return the axis of a ``FIELD=VALUES`` text such as ``tolerance.t=0.005:0.03:6log``.

    Raises
    ------
    SweepError
        The text has no ``=``, or its values cannot be read.
    """
    path, equals, values = text.partition("=")
    if not equals:
        raise SweepError(f"--set {text}: there is no =; write FIELD=VALUES, such as outliers.k=10,20,30")
    return make_axis(path.strip(), values.strip())


def make_axis(path: str, given: Any) -> Axis:
    """Return the axis of a list of values, or of a text such as ``"10,20,30"`` or ``"0.005:0.03:6log"``.

    Raises
    ------
    SweepError
        There is no value, or the range is empty, reversed, or has too few or too many steps.
    """
    if not isinstance(given, str):
        values = tuple(given) if isinstance(given, list | tuple) else (given,)
        return Choice(path, _some(path, values))
    found = _RANGE.fullmatch(given)
    if found is not None and not given.startswith(("[", "{", '"')):
        return _span(path, given, *found.groups())
    return Choice(path, _some(path, tuple(_value(part) for part in _parted(given))))


def checked_axis(axis: Axis, base: Preset) -> Axis:
    """Check an axis against the preset's schema and return it with values in the preset's types.

    Raises
    ------
    TactuneError
        The field does not exist or cannot be swept, a value is not allowed, or the field's section is turned off.
    """
    set_path(base.model_dump(mode="python"), axis.path, None)  # raises for an unknown field, suggests the nearest
    if axis.path in _FIXED or axis.path not in result_paths():
        raise SweepError(f"{axis.path} cannot be swept; sweep a parameter that affects results")
    if isinstance(axis, Choice):
        values = [plain_value(base.with_value(axis.path, value), axis.path) for value in axis.values]
        return Choice(axis.path, tuple(_unique(values)))
    whole = isinstance(base.value(axis.path), int) and not isinstance(base.value(axis.path), bool)
    if not (whole or isinstance(base.value(axis.path), float)):
        raise SweepError(f"{axis.path} is not a number, so it has no range; list its values with commas")
    for end in (axis.low, axis.high):
        base.with_value(axis.path, _fitting(end, whole))
    return axis


def check_switched_on(axes: Sequence[Axis], base: Preset) -> None:
    """Raise if a field belongs to a section that stays turned off, because it would have no effect.

    Raises
    ------
    SweepError
        The message names the field and the switch.
    """
    swept = {axis.path for axis in axes}
    for path in swept:
        section, _, field = path.rpartition(".")
        switch = f"{section}.enabled"
        if field == "enabled" or switch not in preset_paths() or switch in swept or base.value(switch):
            continue
        if path != "outliers.min_cluster_area_mm2":  # clusters are turned off by an area of 0
            raise SweepError(f"{path} changes nothing while {switch} is false; add --set {switch}=true")


def check_contact_test(axes: Sequence[Axis], base: Preset) -> None:
    """Raise if a field belongs to a contact test that no run uses.

    Raises
    ------
    SweepError
        The message names the field and the test.
    """
    chosen = next((axis.values for axis in axes if isinstance(axis, Choice) and axis.path == "contact_test"), ())
    tests = chosen or (base.contact_test,)
    for axis in axes:
        test = _TEST_OF.get(axis.path.partition(".")[0])
        if test is not None and test not in tests:
            raise SweepError(
                f"{axis.path} changes nothing while contact_test is {tests[0]}; add --set contact_test={test}"
            )


def check_free(axes: Sequence[Axis], methods: Sequence[str]) -> None:
    """Raise if a method sets one of the fields itself and ignores the preset's value.

    Raises
    ------
    SweepError
        The message names the field and the method.
    """
    for axis in axes:
        for method in methods:
            own = fields_of(method)
            if axis.path in own:
                raise SweepError(
                    f"{method} always has {axis.path} {own[axis.path]}, so other values would change nothing; "
                    f"use --method fusion, or remove --set {axis.path}"
                )


def grid_size(axes: Sequence[Axis]) -> int:
    """Return the number of combinations of a grid.

    Raises
    ------
    SweepError
        A range has no number of steps.
    """
    for axis in axes:
        if isinstance(axis, Span) and axis.count is None:
            raise SweepError(
                f"{axis.path}: {axis.low:g}:{axis.high:g} has no number of steps; write "
                f"{axis.low:g}:{axis.high:g}:5, or take a sample with --sample N"
            )
    return math.prod(len(axis.values) if isinstance(axis, Choice) else axis.count or 0 for axis in axes)


def grid(axes: Sequence[Axis], base: Preset) -> Iterator[dict[str, Any]]:
    """Yield every combination of the axes' values."""
    columns = [axis.values if isinstance(axis, Choice) else _steps(axis, base) for axis in axes]
    for values in itertools.product(*columns):
        yield dict(zip((axis.path for axis in axes), values, strict=True))


def sample(axes: Sequence[Axis], base: Preset, count: int, seed: int) -> Iterator[dict[str, Any]]:
    """Yield ``count`` combinations from a Latin hypercube, which covers every axis evenly."""
    from scipy.stats import qmc

    if not axes:
        return
    for shares in qmc.LatinHypercube(len(axes), rng=np.random.default_rng(seed)).random(count):
        yield {axis.path: _at(axis, float(share), base) for axis, share in zip(axes, shares, strict=True)}


def plain_value(preset: Preset, path: str) -> Any:
    """Return the value of a field as plain JSON data."""
    value = preset.value(path)
    return json.loads(json.dumps(value.model_dump(mode="json") if hasattr(value, "model_dump") else value))


def _span(path: str, text: str, low: str, high: str, count: str | None, log: str | None) -> Span:
    try:
        ends = float(low), float(high)
    except ValueError as error:
        raise SweepError(
            f"{path}: {text} is no range; write LOW:HIGH:STEPS, such as 0.005:0.03:6, or :6log for equal ratios"
        ) from error
    if not (math.isfinite(ends[0]) and ends[0] < ends[1] < math.inf):
        raise SweepError(f"{path}: the range {text} is empty; its low end must lie below its high end")
    if log and ends[0] <= 0:
        raise SweepError(f"{path}: equal ratios cannot begin at {ends[0]:g}; give a low end above 0 or leave log out")
    steps = int(count) if count and len(count) < 12 else None
    if count and (steps is None or not 2 <= steps <= MAX_RUNS):
        raise SweepError(f"{path}: {text} has {count} steps; give 2 to {MAX_RUNS}")
    return Span(path, *ends, steps, bool(log))


def _steps(axis: Span, base: Preset) -> list[Any]:
    return _unique([_at(axis, share, base) for share in np.linspace(0.0, 1.0, axis.count or 0).tolist()])


def _at(axis: Axis, share: float, base: Preset) -> Any:
    """Return the value at a fraction, 0 to 1, of an axis."""
    if isinstance(axis, Choice):
        return axis.values[min(int(share * len(axis.values)), len(axis.values) - 1)]
    ratio, width = axis.high / axis.low if axis.log else 1.0, axis.high - axis.low
    number = axis.low * ratio**share if axis.log else axis.low + share * width
    number = float(f"{number:.6g}")  # 0.0175 rather than 0.017499999999999998
    return _fitting(min(max(number, axis.low), axis.high), isinstance(base.value(axis.path), int))


def _fitting(number: float, whole: bool) -> int | float:
    return round(number) if whole else number


def _some(path: str, values: tuple[Any, ...]) -> tuple[Any, ...]:
    if not values:
        raise SweepError(f"{path} has no value; list some with commas, or give a range LOW:HIGH:STEPS")
    return values


def _parted(text: str) -> list[str]:
    """Split at commas outside brackets."""
    parts, depth, start = [], 0, 0
    for at, letter in enumerate(text):
        depth += (letter in "[{") - (letter in "]}")
        if letter == "," and depth == 0:
            parts.append(text[start:at])
            start = at + 1
    return [part.strip() for part in (*parts, text[start:]) if part.strip()]


def _value(text: str) -> Any:
    """Return the JSON value of a text; the text itself if it is not valid JSON."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text


def _unique(values: Sequence[Any]) -> list[Any]:
    return list({json.dumps(value): value for value in values}.values())


class SweepFile(BaseModel):
    """The fields of a sweep file; a missing field has the default of the option of the same name.

    Attributes
    ----------
    preset : str or None
        A file, relative to the folder of the sweep file, or the name of a shipped preset.
    source, method : list of str
    set : dict
        Field path to values: a list, or a text such as ``"0.005:0.03:6log"``.
    frames : str or int or None
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    preset: str | None = None
    source: list[str] = []
    set: dict[str, Any] = {}
    method: list[str] = []
    frames: str | int | None = None
    seeds: Annotated[int, Field(ge=1, le=1000)] | None = None
    sample: Annotated[int, Field(ge=1)] | None = None
    seed: Annotated[int, Field(ge=0)] | None = None
    objective: str | None = None


def load_sweep_file(path: Path) -> SweepFile:
    """Read a sweep file.

    Raises
    ------
    SweepError
        The file cannot be read, is not a JSON object, or has a field that is unknown or of the wrong type.
    """
    refuse_devices(path, SweepError)
    try:
        return SweepFile.model_validate_json(path.read_text("utf-8"))
    except OSError as error:
        raise SweepError(f"cannot read {path}: {error.strerror or error}; check the path") from error
    except UnicodeDecodeError as error:
        raise SweepError(f"{path} is no sweep: it is not a text file; write it as JSON") from error
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(map(str, first["loc"])) or "it"
        known = ", ".join(SweepFile.model_fields)
        raise SweepError(f"{path}: {place}: {first['msg']}; a sweep has the fields {known}") from error
