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
from typing import Any, Final, Literal

import numpy as np

from ..contact.checks import check_rig
from ..errors import TactuneError
from ..model.files import path_exists, recording_files, user_path
from ..preset import CONTACT_TESTS, Preset
from ..preset.preset import json_or_word, preset_paths, set_path
from ..sources.base import FrameSource, SeekableSource
from ..sources.registry import is_recording, open_source, opens_by_name

Sampler = Literal["grid", "qmc", "tpe", "nsga2"]
#: Trials of a search without a number of trials, and upper limit of the points of a grid.
TRIALS: Final = 60
MAX_GRID: Final = 10_000
#: Begins of the paths of fields that cannot vary.
_FIXED: Final = ("name", "notes", "created", "modified", "rig", "alignment.calibration", "cameras.", "untouched")
#: Index of the step of the contact test in which each field is first used.
STAGE_OF: Final = {
    path: number
    for test in CONTACT_TESTS.values()
    for number, fields in enumerate(test.steps.values())
    for path in fields
}
_RANGE: Final = re.compile(r"([^:]+):([^:]+?)(?::([0-9]{0,9})(log)?)?")


class TuneError(TactuneError):
    """A search cannot be planned, run or stored."""


@dataclass(frozen=True)
class Objective:
    """One figure to optimise: its unit, whether larger is better, and whether it needs ground truth."""

    unit: str
    larger: bool
    needs_truth: bool
    meaning: str


#: What a search can optimise. Means over frames, then over sources; the time is the median of all frames.
OBJECTIVES: Final = {
    "rmse": Objective("mm", False, True, "mean symmetric distance between patch and truth"),
    "iou": Objective("", True, True, "intersection over union with the true pixels"),
    "area_error": Objective("mm2", False, True, "mean absolute difference to the true area"),
    "ms": Objective("ms", False, False, "median processor time of a frame on one thread"),
    "area": Objective("mm2", True, False, "mean area of the patch"),
    "stability": Objective("", True, False, "mean IoU of the masks of consecutive frames"),
}


@dataclass(frozen=True)
class Axis:
    """One preset field that varies over listed values, as plain data, or from ``low`` to ``high`` in the field's unit.

    For a grid a range has a ``count`` of steps, in equal ratios if it is ``log``. ``whole``: whole numbers only.
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
        """Return the values of a grid. Raises a `TuneError` for a range without a number of steps."""
        if self.values:
            return list(self.values)
        if self.count is None:
            ends = f"{self.low:g}:{self.high:g}"
            raise TuneError(f"{self.path}: {ends} has no number of steps; write {ends}:5, or leave out --sampler grid")
        space = np.geomspace if self.log else np.linspace
        return list(dict.fromkeys(map(self.fitting, space(self.low, self.high, self.count).tolist())))


def parse_axis(text: str) -> Axis:
    """Read ``FIELD=VALUES`` such as ``outliers.k=10,20`` or ``tolerance.t=0.005:0.03:6log``."""
    path, _, given = (part.strip() for part in text.partition("="))
    if (found := _RANGE.fullmatch(given)) is not None and not given.startswith(("[", "{", '"')):
        low, high, count, log = found.groups()
        with suppress(ValueError):
            axis = Axis(path, (), float(low), float(high), int(count) if count else None, bool(log))
            fits = 2 <= (axis.count or 2) <= MAX_GRID and (axis.low > 0 or not log)
            if fits and 0 < axis.high - axis.low < math.inf:
                return axis
        raise TuneError(
            f"{path}: {given} is no range; write LOW:HIGH, LOW:HIGH:STEPS, or LOW:HIGH:STEPSlog for equal ratios, with "
            f"a high end above the low end, 2 to {MAX_GRID} steps, and for equal ratios a low end above 0"
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
    for path in checked:
        section, _, field = path.partition(".")
        needs: list[tuple[str, Any]] = [
            ("contact_test", test.name) for test in CONTACT_TESTS.values() if section in test.sections
        ]
        if f"{section}.enabled" in preset_paths() and field not in ("enabled", "min_cluster_area_mm2"):  # 0: off
            needs.append((f"{section}.enabled", True))
        for needed, value in needs:
            if value not in (checked[needed].values if needed in checked else (base.value(needed),)):
                word = json.dumps(value).strip('"')
                raise TuneError(f"{path} changes nothing unless {needed} is {word}; add --set {needed}={word}")
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
    """Return the value of a field as plain JSON data."""
    value = preset.value(path)
    return json.loads(json.dumps(value.model_dump(mode="json") if hasattr(value, "model_dump") else value))


def default_axes(preset: Preset) -> tuple[Axis, ...]:
    """Return the numbers of the preset's contact test over their sliders' ranges, the present values included.

    The number of averaged frames is left out: it trades time resolution, which no objective sees. So are fields of a
    section that is turned off.
    """
    axes: list[Axis] = []
    for section, model in preset.test.sections.items():
        for name, field in model.model_fields.items():
            path, extra = f"{section}.{name}", field.json_schema_extra
            if isinstance(extra, dict) and "slider" in extra and path != preset.test.frames_field:
                slider: Any = extra["slider"]
                low, high = min(slider[0], preset.value(path)), max(slider[1], preset.value(path))
                with suppress(TuneError):  # it changes nothing
                    axes += check_axes([Axis(path, (), low, high, log=extra.get("scale") == "log" and low > 0)], preset)
    return tuple(axes)


def grid_of(axes: Sequence[Axis]) -> list[dict[str, Any]]:
    """Return all combinations of the axes' values; fields of early steps vary slowest, so that steps are shared."""
    columns = {axis.path: axis.steps() for axis in sorted(axes, key=lambda axis: STAGE_OF.get(axis.path, 0))}
    if (count := math.prod(map(len, columns.values()))) > MAX_GRID:
        raise TuneError(
            f"the grid has {count} points, but the limit is {MAX_GRID}; give fewer values, or search with --trials N"
        )
    return [dict(zip(columns, row, strict=True)) for row in itertools.product(*columns.values())]


@dataclass(frozen=True)
class Clip:
    """Frames of one source: as the user wrote it, as every process can open it, and whether they have truth."""

    source: str
    name: str
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
    sampler: Sampler
    trials: int
    seed: int

    @property
    def identity(self) -> str:
        """Hash of the request: the same command continues its search."""
        base = self.base.model_dump_json(exclude={"name", "notes", "created", "modified"})
        clips = [(clip.name, list(clip.frames)) for clip in self.clips]
        decisive = [base, list(map(asdict, self.axes)), clips, self.objectives, self.sampler, self.seed]
        return hashlib.sha256(json.dumps(decisive).encode()).hexdigest()[:12]


def make_plan(
    base: Preset,
    axes: Sequence[Axis],
    sources: Sequence[str],
    *,
    frames: slice = slice(None),
    objectives: Sequence[str] = (),
    sampler: Sampler | None = None,
    trials: int | None = None,
    seed: int = 0,
    opener: Callable[[str], FrameSource] = open_source,
) -> Plan:
    """Check a request and return the plan. Sources are opened; no trial is run.

    Defaults: `default_axes`; all frames; the RMSE and the time, or without truth the stability and the time; the grid
    with all its points if each axis has steps and no number of trials is given, else TPE with `TRIALS`.
    """
    if not sources:
        raise TuneError("there is nothing to search on; give --source, such as --source 'sim:cup?press=medium'")
    for name in objectives:
        if name not in OBJECTIVES:
            raise TuneError(f"there is no objective {name!r}; choose from {', '.join(OBJECTIVES)}")
    axes = check_axes(axes, base) if axes else default_axes(base)
    gridded = all(axis.values or axis.count for axis in axes)
    chosen: Sampler = sampler or ("grid" if gridded and trials is None else "tpe")
    count = len(grid_of(axes)) if chosen == "grid" else trials or TRIALS
    clips = tuple(_inspect(source, frames, base, opener) for source in dict.fromkeys(sources))
    blind = next((clip.source for clip in clips if not clip.has_truth), None)
    wanted = tuple(dict.fromkeys(objectives)) or (("rmse", "ms") if blind is None else ("stability", "ms"))
    for name in wanted:
        if blind is not None and OBJECTIVES[name].needs_truth:
            without = ", ".join(name for name, figure in OBJECTIVES.items() if not figure.needs_truth)
            raise TuneError(f"{blind} has no ground truth, so {name} is undefined; choose from {without}")
        if name == "stability" and all(len(clip.frames) == 1 for clip in clips):
            raise TuneError("stability compares consecutive frames, but there is only one; choose another --objective")
    return Plan(base, axes, clips, wanted, chosen, count, seed)


def _inspect(source: str, frames: slice, preset: Preset, opener: Callable[[str], FrameSource]) -> Clip:
    name = source
    if is_recording(source):  # workers may run in another folder
        scheme, colon, rest = source.partition(":") if opens_by_name(source) else ("", "", source)
        files = recording_files(rest) or ((user_path(rest),) if path_exists(rest) else ())
        name = f"{scheme}{colon}{','.join(str(file.absolute()) for file in files) or rest}"
    with open_recording(name, opener) as opened:
        check_rig(preset, opened.rig)
        if not (chosen := range(opened.length)[frames]):
            raise TuneError(f"{source} has {opened.length} frames, none of them chosen; choose others with --frames")
        return Clip(source, name, chosen, opened.read(chosen[0]).truth is not None)
