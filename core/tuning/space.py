"""The search space: which preset fields vary, and over which values."""

from __future__ import annotations

import itertools
import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, cast

import numpy as np

from ..errors import TactuneError
from ..preset import CONTACT_TESTS, Preset
from ..preset.preset import preset_paths, set_path

#: Fields with metadata, which do not affect results, and fields that affect them but cannot vary.
_ABOUT: Final = ("name", "notes", "created", "modified", "rig", "alignment.calibration")
_FIXED: Final = ("untouched",)

#: The contact test that uses each section.
_TEST_OF: Final = {section: test.name for test in CONTACT_TESTS.values() for section in test.section_names}

#: Index of the step of the contact test in which each field is first used.
STAGE_OF: Final = {
    path: number
    for test in CONTACT_TESTS.values()
    for number, step in enumerate(test.steps)
    for path in step.fields
    if path in preset_paths()
}

#: Upper limit of the points of a grid.
MAX_GRID: Final = 10_000

_RANGE: Final = re.compile(r"([^:]+):([^:]+?)(?::([0-9]{0,9})(log)?)?")


class TuneError(TactuneError):
    """A search cannot be planned, run or stored."""


@dataclass(frozen=True)
class Axis:
    """One preset field that varies: listed values, or a range.

    Attributes
    ----------
    path : str
        Dotted path of the field.
    values : tuple
        Listed values as plain data; empty for a range.
    low, high : float
        Ends of the range, in the field's unit.
    count : int or None
        Number of values of the range in a grid.
    log : bool
        Whether steps have equal ratios instead of equal differences.
    whole : bool
        Whether only whole numbers are allowed.
    """

    path: str
    values: tuple[Any, ...] = ()
    low: float = 0.0
    high: float = 0.0
    count: int | None = None
    log: bool = False
    whole: bool = False

    def fitting(self, number: float) -> Any:
        """Return a number of the range with four significant digits, as the field holds it."""
        rounded = min(max(float(f"{number:.4g}"), self.low), self.high)
        return round(rounded) if self.whole else rounded

    def holds(self, value: Any) -> bool:
        """Return whether a plain value belongs to this axis."""
        return value in self.values if self.values else self.low <= value <= self.high

    def steps(self) -> list[Any]:
        """Return the values of a grid.

        Raises
        ------
        TuneError
            The range has no number of steps.
        """
        if self.values:
            return list(self.values)
        if self.count is None:
            ends = f"{self.low:g}:{self.high:g}"
            raise TuneError(f"{self.path}: {ends} has no number of steps; write {ends}:5, or leave out --sampler grid")
        space = np.geomspace if self.log else np.linspace
        return list(dict.fromkeys(map(self.fitting, space(self.low, self.high, self.count).tolist())))


def result_paths() -> list[str]:
    """Return the paths of the preset fields that affect results."""
    return [path for path in preset_paths() if path not in _ABOUT and not path.startswith("cameras.")]


def plain_value(preset: Preset, path: str) -> Any:
    """Return the value of a field as plain JSON data."""
    value = preset.value(path)
    return json.loads(json.dumps(value.model_dump(mode="json") if hasattr(value, "model_dump") else value))


def json_or_word(text: str) -> Any:
    """Return the value of a JSON text, or else the text itself."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text


def parse_axis(text: str) -> Axis:
    """Read ``FIELD=VALUES`` such as ``outliers.k=10,20`` or ``tolerance.t=0.005:0.03:6log``.

    Raises
    ------
    TuneError
        There is no ``=`` or no value, or the range is empty, reversed, or has too few or too many steps.
    """
    path, equals, given = (part.strip() for part in text.partition("="))
    if not equals:
        raise TuneError(f"--set {text}: there is no =; write FIELD=VALUES, such as outliers.k=10,20,30")
    found = _RANGE.fullmatch(given)
    if found is not None and not given.startswith(("[", "{", '"')):
        return _range(path, given, *found.groups())
    try:
        values = json.loads(f"[{given.strip(',')}]")
    except (ValueError, RecursionError):  # words
        values = [json_or_word(part.strip()) for part in given.split(",") if part.strip()]
    if not values:
        raise TuneError(f"{path} has no value; list some with commas, or give a range LOW:HIGH")
    return Axis(path, tuple(values))


def check_axes(axes: Sequence[Axis], base: Preset) -> tuple[Axis, ...]:
    """Check axes against the preset's schema and return them with values in the preset's types.

    Raises
    ------
    TactuneError
        A field does not exist, is given twice, cannot vary or has no effect, or a value is not allowed.
    """
    checked = tuple(_checked(axis, base) for axis in axes)
    by_path = {axis.path: axis for axis in checked}
    if len(by_path) < len(checked):
        raise TuneError("a field is given twice with --set; give all its values at once, separated by commas")
    tests = by_path["contact_test"].values if "contact_test" in by_path else (base.contact_test,)
    for path in by_path:
        section, _, field = path.rpartition(".")
        switch = f"{section}.enabled"
        clusters = path == "outliers.min_cluster_area_mm2"  # turned off by an area of 0 instead
        off = switch in preset_paths() and switch not in by_path and not base.value(switch)
        if off and field != "enabled" and not clusters:
            raise TuneError(f"{path} changes nothing while {switch} is false; add --set {switch}=true")
        test = _TEST_OF.get(path.partition(".")[0])
        if test is not None and test not in tests:
            raise TuneError(f"{path} changes nothing while contact_test is {tests[0]}; add --set contact_test={test}")
    return checked


def default_axes(preset: Preset) -> tuple[Axis, ...]:
    """Return the numbers of the preset's contact test over their sliders' ranges, the present values included.

    The number of averaged frames is left out: it trades time resolution, which no objective sees. So are fields of a
    section that is turned off.
    """
    axes = []
    for section in preset.test.sections:
        off = not getattr(getattr(preset, section.name), "enabled", True)
        for name, field in section.model.model_fields.items():
            path, extra = f"{section.name}.{name}", field.json_schema_extra
            if not isinstance(extra, dict) or "slider" not in extra or path == preset.test.frames_field:
                continue
            if off and name in ("k", "ratio"):
                continue
            low, high = cast(tuple[float, float], extra["slider"])
            present = preset.value(path)
            ends = min(low, present), max(high, present)
            axes.append(Axis(path, (), *ends, log=extra.get("scale") == "log" and ends[0] > 0))
    return check_axes(axes, preset)


def grid_of(axes: Sequence[Axis]) -> list[dict[str, Any]]:
    """Return all combinations of the axes' values; fields of early steps vary slowest, so that steps are shared.

    Raises
    ------
    TuneError
        A range has no number of steps, or there are more than `MAX_GRID` combinations.
    """
    ordered = sorted(axes, key=lambda axis: STAGE_OF.get(axis.path, 0))
    columns = [axis.steps() for axis in ordered]
    count = math.prod(map(len, columns))
    if count > MAX_GRID:
        raise TuneError(
            f"the grid has {count} points, but the limit is {MAX_GRID}; give fewer values, or search with --trials N"
        )
    return [dict(zip((axis.path for axis in ordered), row, strict=True)) for row in itertools.product(*columns)]


def at_edge(axes: Sequence[Axis], best: dict[str, Any]) -> list[str]:
    """Return a sentence for each number whose best value is the smallest or largest one of its axis."""
    said = []
    for axis in axes:
        numbers = [value for value in axis.values or (axis.low, axis.high) if type(value) in (int, float)]
        for end, which in ((min, "smallest"), (max, "largest")):
            if len(set(numbers)) > 1 and best[axis.path] == end(numbers):
                said.append(f"the best {axis.path}, {best[axis.path]:g}, is the {which} one that was allowed")
    return said


def _checked(axis: Axis, base: Preset) -> Axis:
    set_path(base.model_dump(mode="python"), axis.path, None)  # raises for an unknown field, suggests the nearest
    if axis.path in _FIXED or axis.path not in result_paths():
        raise TuneError(f"{axis.path} cannot vary; choose a parameter that affects results")
    if axis.values:
        values = [plain_value(base.with_value(axis.path, value), axis.path) for value in axis.values]
        return replace(axis, values=tuple({json.dumps(value): value for value in values}.values()))
    present = base.value(axis.path)
    if isinstance(present, bool) or not isinstance(present, int | float):
        raise TuneError(f"{axis.path} is not a number, so it has no range; list its values with commas")
    axis = replace(axis, whole=isinstance(present, int))
    for end in (axis.low, axis.high):
        base.with_value(axis.path, round(end) if axis.whole else end)
    return axis


def _range(path: str, text: str, low: str, high: str, count: str | None, log: str | None) -> Axis:
    try:
        ends = float(low), float(high)
    except ValueError as error:
        raise TuneError(f"{path}: {text} is no range; write LOW:HIGH, LOW:HIGH:STEPS, or :6log for ratios") from error
    if not (math.isfinite(ends[0]) and ends[0] < ends[1] < math.inf):
        raise TuneError(f"{path}: the range {text} is empty; its low end must lie below its high end")
    if log and ends[0] <= 0:
        raise TuneError(f"{path}: equal ratios cannot begin at {ends[0]:g}; give a low end above 0 or leave log out")
    if count and not 2 <= int(count) <= MAX_GRID:
        raise TuneError(f"{path}: {text} has {count} steps; give 2 to {MAX_GRID}")
    return Axis(path, (), *ends, int(count) if count else None, bool(log))
