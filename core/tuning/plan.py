"""The plan of a sweep: settings, clips, the order of the runs, and their batches."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

from ..evaluation.table_cell import code_version
from ..methods.registry import check_known, fields_of, method_kind, method_names, needs_untouched
from ..model.frames import SensorFrame
from ..preset import CONTACT_TESTS, Preset
from ..preset.preset import preset_paths
from ..sources.registry import open_source
from .clips import Clip, FrameRange, OpenSource, inspect_clips
from .values import (
    MAX_RUNS,
    Axis,
    Choice,
    SweepError,
    check_contact_test,
    check_free,
    check_switched_on,
    checked_axis,
    grid,
    grid_size,
    plain_value,
    result_paths,
    sample,
)

#: The preset's own pipeline.
FUSION: Final = "fusion"

_ALL_FRAMES: Final = FrameRange()

#: Upper limit of the frames of a batch, summed over its runs; about ten seconds of work.
_FRAMES_A_BATCH: Final = 500
#: Upper limit of the runs of a batch. All of them are in memory at once; a run of a method needs about 5 MB.
_RUNS_A_BATCH: Final = 50
#: Minimum number of batches per worker, so that no worker is idle towards the end.
_BATCHES_A_WORKER: Final = 4

#: Index of the step of the contact test in which each field is first used. Fields of late steps vary fastest.
STAGE_OF: Final = {
    path: number
    for test in CONTACT_TESTS.values()
    for number, step in enumerate(test.steps)
    for path in step.fields
    if path in preset_paths()
}


@dataclass(frozen=True)
class Request:
    """The request for a sweep, from which `make_plan` makes the plan.

    Attributes
    ----------
    axes : tuple of Axis
    sources : tuple of str
    methods : tuple of str
        ``fusion`` or names of `tactune.core.methods.registry.method_names`.
    frames : FrameRange
    seeds : int
        Number of noise seeds for each simulated source.
    sample : int or None
        Number of combinations to draw; None runs all of them.
    sample_seed : int
    untouched : SensorFrame or None
        The preset's own untouched frame, for methods that need one. None: each source's own is used.
    """

    axes: tuple[Axis, ...]
    sources: tuple[str, ...]
    methods: tuple[str, ...] = (FUSION,)
    frames: FrameRange = _ALL_FRAMES
    seeds: int = 1
    sample: int | None = None
    sample_seed: int = 0
    untouched: SensorFrame | None = None


@dataclass(frozen=True)
class Setting:
    """One method with one combination of parameters.

    Attributes
    ----------
    values : dict
        Path and plain value of each swept field.
    parameters : dict
        Path and plain value of every field that affects results, including the fields that the method sets.
    """

    method: str
    values: dict[str, Any]
    parameters: dict[str, Any]


@dataclass(frozen=True)
class Run:
    """One setting on one clip; the key is a hash of everything that affects the result."""

    key: str
    setting: Setting
    clip: Clip


@dataclass(frozen=True)
class Batch:
    """Runs over one clip that a worker processes together."""

    base: Preset
    clip: Clip
    code: str
    runs: tuple[tuple[str, str, dict[str, Any]], ...]
    untouched: SensorFrame | None = None

    @property
    def name(self) -> str:
        """Hash of the keys of its runs."""
        return hashlib.sha256("".join(key for key, _, _ in self.runs).encode()).hexdigest()[:24]


@dataclass(frozen=True)
class Plan:
    """All settings and clips of a sweep.

    Attributes
    ----------
    base : Preset
    paths : tuple of str
        The swept fields.
    settings : tuple of Setting
    clips : tuple of Clip
    code : str
        Version of the program's code.
    untouched : SensorFrame or None
        As in `Request`; None if no method needs it.
    """

    base: Preset
    paths: tuple[str, ...]
    settings: tuple[Setting, ...]
    clips: tuple[Clip, ...]
    code: str
    untouched: SensorFrame | None = None

    @cached_property
    def runs(self) -> tuple[Run, ...]:
        """All runs, clip by clip; parameters of late steps vary fastest."""
        return tuple(Run(self._key(setting, clip), setting, clip) for clip in self.clips for setting in self.settings)

    @property
    def has_truth(self) -> bool:
        """Whether every source has ground truth."""
        return all(clip.has_truth for clip in self.clips)

    def batches(self, done: Callable[[str], bool], workers: int) -> Iterator[Batch]:
        """Split the unfinished runs into batches, each over one clip."""
        for number, clip in enumerate(self.clips):
            of_take = self.runs[number * len(self.settings) : (number + 1) * len(self.settings)]
            waiting = [run for run in of_take if not done(run.key)]
            share = -(-len(waiting) // (_BATCHES_A_WORKER * workers))
            size = max(1, min(_FRAMES_A_BATCH // len(clip.frames), _RUNS_A_BATCH, share))
            for start in range(0, len(waiting), size):
                part = waiting[start : start + size]
                runs = tuple((run.key, run.setting.method, run.setting.values) for run in part)
                yield Batch(self.base, clip, self.code, runs, self.untouched)

    def _key(self, setting: Setting, clip: Clip) -> str:
        untouched = clip.untouched if needs_untouched(setting.method) else ""
        frames = clip.frames
        text = json.dumps(
            [setting.method, setting.parameters, clip.source, clip.seed, frames.start, frames.stop, frames.step,
             clip.identity, untouched, self.code],
            sort_keys=True,
        )  # fmt: skip
        return hashlib.sha256(text.encode()).hexdigest()[:32]


def make_plan(
    base: Preset,
    request: Request,
    opener: OpenSource = open_source,
    progress: Callable[[str], None] = lambda source: None,
) -> Plan:
    """Check a request and return the plan. Sources are opened and hashed; no run is started.

    Parameters
    ----------
    base : Preset
        Preset for the parameters that are not swept.
    request : Request
    opener : callable
        Opens sources.
    progress : callable
        Called with the name of each source when it is read.

    Raises
    ------
    TactuneError
        An unknown field, value, method or source, too many runs, or nothing to run over.
    """
    check_known(request.methods, (FUSION, *method_names()))
    paths = [axis.path for axis in request.axes]
    for path in paths:
        if paths.count(path) > 1:
            raise SweepError(f"{path} is given twice; give all its values at once, separated by commas")
    if not request.sources:
        raise SweepError("there is nothing to run over; give --source, such as --source 'sim:cup?press=medium'")
    axes = [checked_axis(axis, base) for axis in request.axes]
    check_free(axes, request.methods)
    check_switched_on(axes, base)
    if set(request.methods) == {FUSION}:
        check_contact_test(axes, base)
    settings = _settings(base, axes, request)
    wanted = any(map(needs_untouched, request.methods))
    clips = inspect_clips(
        request.sources, request.seeds, request.frames, base, wanted, request.untouched, opener, progress
    )
    count = len(settings) * len(clips)
    _check_size(count, request)
    untouched = request.untouched if wanted else None
    return Plan(base, tuple(paths), tuple(settings), tuple(clips), code_version(), untouched)


def short_clips(plan: Plan, frames: FrameRange) -> list[str]:
    """Return a sentence for each source with fewer frames than requested."""
    if frames.last is None:
        return []
    return list(dict.fromkeys(
        f"{clip.source} ends after {clip.frames.stop} frames, so of --frames {frames} only "
        f"{len(clip.frames)} {'are' if len(clip.frames) > 1 else 'is'} used"
        for clip in plan.clips if clip.frames.stop < frames.last
    ))  # fmt: skip


def little_averaged(plan: Plan) -> list[str]:
    """Return a sentence for each source with too few frames for the temporal average, or with skipped frames."""
    field, most = "", 1
    for setting in plan.settings:
        test = CONTACT_TESTS[setting.parameters["contact_test"]]
        is_fusion = setting.method == FUSION or method_kind(setting.method).fields is not None
        if test.frames_field and is_fusion:
            field, most = max(
                (field, most), (test.frames_field, setting.parameters[test.frames_field]), key=lambda pair: pair[1]
            )
    said = []
    for clip in plan.clips:
        count, step = len(clip.frames), clip.frames.step
        if step > 1 < min(most, count):
            said.append(
                f"{clip.source} gives one frame in {step}, so {field} {most} averages frames that do not follow each "
                "other; leave the step out of --frames"
            )
        elif count < most:
            said.append(
                f"{clip.source} gives {count} frame{'' if count == 1 else 's'}, so {field} {most} averages no more "
                "than that; take more frames"
            )
    return list(dict.fromkeys(said))


def _settings(base: Preset, axes: Sequence[Axis], request: Request) -> list[Setting]:
    if request.sample is None:
        _check_size(grid_size(axes) * len(request.methods) * len(request.sources) * request.seeds, request)
        combinations = grid(axes, base)
    else:
        _check_size(request.sample * len(request.methods) * len(request.sources), request)
        if not axes:
            raise SweepError("there is nothing to sample; give --set FIELD=LOW:HIGH")
        combinations = sample(axes, base, request.sample, request.sample_seed)
    fixed = {path: plain_value(base, path) for path in result_paths()}
    found = [
        Setting(method, values, fixed | values | fields_of(method))
        for values in combinations
        for method in dict.fromkeys(request.methods)
    ]  # fmt: skip
    numbers = {axis.path: axis.values for axis in axes if isinstance(axis, Choice)}

    def order(setting: Setting) -> list[Any]:
        """Sort by the fields of early steps first; values of a field keep their listed order."""
        ranks = sorted(setting.values, key=lambda path: (STAGE_OF.get(path, 0), path))
        return [setting.method, *(
            numbers[path].index(setting.values[path]) if path in numbers else setting.values[path] for path in ranks
        )]  # fmt: skip

    return list({json.dumps([setting.method, setting.parameters]): setting for setting in sorted(found, key=order)}
                .values())  # fmt: skip


def _check_size(count: int, request: Request) -> None:
    if count > MAX_RUNS:
        remedy = (
            "use a smaller --sample"
            if request.sample is not None
            else "draw some of them with --sample N, or give fewer values"
        )
        raise SweepError(f"the sweep has {count} runs, but the limit is {MAX_RUNS}; {remedy}")
