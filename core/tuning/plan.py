"""The plan of a search: a preset, the fields that vary, the frames, and what is optimised."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

from ..contact.checks import check_rig, check_test
from ..errors import TactuneError
from ..preset import Preset
from ..preset.preset import json_or_word, set_path
from ..sources.base import FrameSource, SeekableSource
from ..sources.registry import open_source

#: Trials of a search that is no grid, by default, and upper limit of the points of a grid.
TRIALS: Final = 60
MAX_GRID: Final = 10_000
#: Begins of the paths of fields that cannot vary.
_FIXED: Final = (
    "name",
    "notes",
    "created",
    "modified",
    "rig",
    "alignment.calibration",
    "cameras.",
    "untouched",
    "suggested",
    "verdict",
)
_RANGE: Final = re.compile(r"([^:]+):([^:]+?)(:log)?")


class TuneError(TactuneError):
    """A search cannot be planned, run or stored."""


@dataclass(frozen=True)
class Objective:
    """One figure to optimise: its unit, whether larger is better, and whether it needs ground truth."""

    unit: str
    larger: bool
    needs_truth: bool


#: What a search can optimise. Means over frames, then over sources: symmetric distance between patch and truth, overlap
#: of both; median processor time of a frame on one thread; overlap of consecutive frames.
OBJECTIVES: Final = {
    "rmse": Objective("mm", False, True),
    "iou": Objective("", True, True),
    "ms": Objective("ms", False, False),
    "stability": Objective("", True, False),
}


@dataclass(frozen=True)
class Axis:
    """A preset field that varies over values, or from ``low`` to ``high``; ``log``: equal ratios are equally far."""

    path: str
    values: tuple[Any, ...] = ()
    low: float = 0.0
    high: float = 0.0
    log: bool = False
    whole: bool = False

    def fitting(self, number: float) -> Any:
        """Return a number of the range with four significant digits, as the field holds it."""
        rounded = min(max(float(f"{number:.4g}"), self.low), self.high)
        return round(rounded) if self.whole else rounded

    def holds(self, value: Any) -> bool:
        return value in self.values if self.values else self.low <= value <= self.high


def parse_axis(text: str) -> Axis:
    """Read ``FIELD=VALUES`` such as ``outliers.k=10,20`` or ``tolerance.t=0.005:0.03`` or ``0.005:0.03:log``."""
    path, _, given = (part.strip() for part in text.partition("="))
    if (found := _RANGE.fullmatch(given)) is not None and not given.startswith(("[", "{", '"')):
        low, high, log = found.groups()
        with suppress(ValueError):
            axis = Axis(path, (), float(low), float(high), bool(log))
            if 0 < axis.high - axis.low < math.inf and (axis.low > 0 or not log):
                return axis
        raise TuneError(
            f"{path}: {given} is no range; write LOW:HIGH, or for equal ratios LOW:HIGH:log with LOW above 0"
        )
    try:
        values = json.loads(f"[{given.strip(',')}]")
    except (ValueError, RecursionError):  # words
        values = [json_or_word(part.strip()) for part in given.split(",") if part.strip()]
    if not values:
        raise TuneError(f"--set {text}: there is no = or no value; write outliers.k=10,20,30 or tolerance.t=0.005:0.03")
    return Axis(path, tuple(values))


def check_axes(axes: Sequence[Axis], base: Preset) -> tuple[Axis, ...]:
    """Check axes against the preset's schema and return them with values in the preset's types."""
    checked = {axis.path: _checked(axis, base) for axis in axes}
    if len(checked) < len(axes):
        raise TuneError("a field is given twice with --set; give all its values at once, separated by commas")
    return tuple(checked.values())


def _checked(axis: Axis, base: Preset) -> Axis:
    set_path(base.model_dump(mode="python"), axis.path, None)  # raises for an unknown field, suggests the nearest
    if axis.path.startswith(_FIXED):
        raise TuneError(f"{axis.path} cannot vary; choose a parameter that affects results")
    if axis.values:
        values = [plain_value(base.with_value(axis.path, value), axis.path) for value in axis.values]
        return replace(axis, values=tuple({json.dumps(value): value for value in values}.values()))
    axis = replace(axis, whole=isinstance(base.value(axis.path), int))
    for end in (axis.low, axis.high):
        base.with_value(axis.path, round(end) if axis.whole else end)
    return axis


def plain_value(preset: Preset, path: str) -> Any:
    value = preset.value(path)
    return json.loads(json.dumps(value.model_dump(mode="json") if hasattr(value, "model_dump") else value))


#: What is measured is not searched.
_MEASURED: Final = ("pressure.gauge_pa", "pressure.gauge_sigma_pa")


def default_axes(preset: Preset) -> tuple[Axis, ...]:
    """Return the numbers of the preset's contact test over their sliders, without averaging and what is off."""
    axes: list[Axis] = []
    for section, model in preset.test.sections.items():
        if not getattr(getattr(preset, section), "enabled", True):
            continue
        for name, field in model.model_fields.items():
            path, extra = f"{section}.{name}", field.json_schema_extra
            if isinstance(extra, dict) and "slider" in extra and path not in {preset.test.frames_field, *_MEASURED}:
                slider: Any = extra["slider"]
                low, high = min(slider[0], preset.value(path)), max(slider[1], preset.value(path))
                axes.append(Axis(path, (), low, high, log=extra.get("scale") == "log" and low > 0))
    return check_axes(axes, preset)


def grid_of(axes: Sequence[Axis]) -> list[dict[str, Any]]:
    """Return all combinations of listed values."""
    if (count := math.prod(len(axis.values) for axis in axes)) > MAX_GRID:
        raise TuneError(f"the grid has {count} points, more than {MAX_GRID}; give fewer values, or --trials N")
    rows = itertools.product(*(axis.values for axis in axes))
    return [dict(zip((axis.path for axis in axes), row, strict=True)) for row in rows]


@dataclass(frozen=True)
class Clip:
    """Frames of one source, and whether they have truth."""

    source: str
    frames: range
    has_truth: bool


def open_recording(name: str, opener: Callable[[str], FrameSource] = open_source) -> SeekableSource:
    """Open a source by its name. Raises a `TactuneError` if it is live, or cannot be read."""
    source = opener(name)
    if not isinstance(source, SeekableSource):
        source.close()
        raise TuneError(f"{name} is live, so its frames are never the same; record it first with tactune record")
    return source


@dataclass(frozen=True)
class Plan:
    """All that decides a search; ``base`` has the fields that do not vary, and the values of the first trial."""

    base: Preset
    axes: tuple[Axis, ...]
    clips: tuple[Clip, ...]
    objectives: tuple[str, ...]
    grid: bool
    trials: int

    @property
    def identity(self) -> str:
        """Hash of the request: the same command continues its search."""
        base = self.base.model_dump_json(exclude={"name", "notes", "created", "modified"})
        clips = [(clip.source, list(clip.frames)) for clip in self.clips]
        decisive = [base, list(map(asdict, self.axes)), clips, self.objectives, self.grid]
        return hashlib.sha256(json.dumps(decisive).encode()).hexdigest()[:12]


def make_plan(
    base: Preset,
    axes: Sequence[Axis],
    sources: Sequence[str],
    *,
    frames: slice = slice(None),
    objectives: Sequence[str] = (),
    trials: int | None = None,
    opener: Callable[[str], FrameSource] = open_source,
) -> Plan:
    """Check a request and return the plan. Sources are opened; no trial is run.

    Defaults: `default_axes`; all frames; the RMSE and the time, or without truth the stability and the time; the grid
    with all its points if each axis has listed values and no number of trials is given, else TPE with `TRIALS`.
    """
    if not sources:
        raise TuneError("there is nothing to search on; give --source, such as --source 'sim:cup?press=medium'")
    for name in objectives:
        if name not in OBJECTIVES:
            raise TuneError(f"there is no objective {name!r}; choose from {', '.join(OBJECTIVES)}")
    axes = check_axes(axes, base) if axes else default_axes(base)
    grid = trials is None and all(axis.values for axis in axes)
    count = len(grid_of(axes)) if grid else trials or TRIALS
    clips = tuple(_inspect(source, frames, base, opener) for source in dict.fromkeys(sources))
    blind = next((clip.source for clip in clips if not clip.has_truth), None)
    wanted = tuple(dict.fromkeys(objectives)) or (("rmse", "ms") if blind is None else ("stability", "ms"))
    for name in wanted:
        if blind is not None and OBJECTIVES[name].needs_truth:
            without = ", ".join(name for name, figure in OBJECTIVES.items() if not figure.needs_truth)
            raise TuneError(f"{blind} has no ground truth, so {name} is undefined; choose from {without}")
        if name == "stability" and all(len(clip.frames) == 1 for clip in clips):
            raise TuneError("stability compares consecutive frames, but there is only one; choose another --objective")
    return Plan(base, axes, clips, wanted, grid, count)


def _inspect(source: str, frames: slice, preset: Preset, opener: Callable[[str], FrameSource]) -> Clip:
    with open_recording(source, opener) as opened:
        check_test(preset, opened.rig)
        check_rig(preset, opened.rig)
        if not (chosen := range(opened.length)[frames]):
            raise TuneError(f"{source} has {opened.length} frames, none of them chosen; choose others with --frames")
        return Clip(source, chosen, opened.read(chosen[0]).truth is not None)
