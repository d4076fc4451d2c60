"""The search: an Optuna study in a journal file, which any number of processes and computers may share.

The file is the only state. A search that was killed continues with the same command; ``optuna-dashboard`` reads it.
"""

from __future__ import annotations

import hashlib
import json
import secrets
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Literal, Self

from ..errors import ExportError, MissingExtraError, TactuneError
from ..evaluation.table_cell import code_version
from ..preset import Preset, now
from ..sources.registry import open_source
from .clips import ALL_FRAMES, Clip, FrameRange, OpenSource, inspect_clips
from .measure import OBJECTIVES, Batch, Measured, measure_batch
from .space import Axis, TuneError, check_axes, default_axes, grid_of, plain_value, result_paths
from .workers import SCHEDULER_GONE, Workers

try:
    import optuna
    from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution
    from optuna.storages.journal import JournalFileBackend, JournalFileOpenLock, JournalStorage
    from optuna.trial import FrozenTrial, TrialState
except ImportError as missing:
    raise MissingExtraError("a search needs optuna: install it with pip install 'tactune[tune]'") from missing

Direction = Literal["minimize", "maximize"]
Sampler = Literal["grid", "qmc", "tpe", "nsga2"]
#: Trials of a search without a number of trials.
TRIALS: Final = 60

#: Upper limits of a batch: frames summed over its trials, about ten seconds of work; and its trials. Samplers that
#: learn from earlier trials get small batches.
_FRAMES_A_BATCH: Final = 500
_TRIALS_A_BATCH: Final = {"grid": 50, "qmc": 50, "tpe": 4, "nsga2": 10}
_POPULATION: Final = 20
#: Minimum number of batches per worker, so that no worker is idle towards the end.
_BATCHES_A_WORKER: Final = 4
#: Interval of looks at workers and other searches, seconds.
_LOOK_S: Final = 0.5
#: Grace period of a lock whose holder was killed, seconds.
_GRACE_S: Final = 5
#: Begin of the name of each search, and of the study's user attribute that holds the listed points that it measures.
_SEARCH: Final = "search "
#: In the notes of each preset that a search has written.
FOUND_BY: Final = "found by tactune tune"

_KILLED: Final = (
    "a worker process was killed, perhaps for lack of memory; try fewer --jobs, and the same command continues"
)
#: How each line of Optuna's journal begins.
_JOURNAL: Final = b'{"op_code":'
#: What Optuna, or reading a trial, raises for a journal that is damaged or was removed.
_DAMAGE: Final = (ValueError, LookupError, TypeError, AttributeError, AssertionError, RecursionError)

optuna.logging.set_verbosity(optuna.logging.ERROR)


@dataclass(frozen=True)
class Plan:
    """All that decides a search.

    Attributes
    ----------
    base : Preset
        Values of the fields that do not vary, and the first trial.
    axes : tuple of Axis
    clips : tuple of Clip
    objectives : tuple of str
        Names in `OBJECTIVES`.
    sampler : {"grid", "qmc", "tpe", "nsga2"}
    trials : int
    seed : int
    """

    base: Preset
    axes: tuple[Axis, ...]
    clips: tuple[Clip, ...]
    objectives: tuple[str, ...]
    sampler: Sampler
    trials: int
    seed: int = 0

    @property
    def identity(self) -> str:
        """Hash of all that a trial's result and the choice of trials depend on, the program's code included."""
        fixed = {path: plain_value(self.base, path) for path in result_paths()}
        clips = [(clip.identity, list(clip.frames)) for clip in self.clips]
        axes = list(map(asdict, self.axes))
        decisive = [fixed, axes, clips, self.objectives, self.sampler, self.seed, code_version()]
        return hashlib.sha256(json.dumps(decisive, sort_keys=True).encode()).hexdigest()[:12]


@dataclass(frozen=True)
class Trial:
    """A measured trial.

    Attributes
    ----------
    number : int
        As Optuna counts.
    values : dict of str to object
        Plain values of the fields that vary.
    figures : dict of str to float
        As in `Measured`.
    failure : str
    present : bool
        Whether it is the preset that the search started from.
    """

    number: int
    values: dict[str, Any]
    figures: dict[str, float]
    failure: str = ""
    present: bool = False


def make_plan(
    base: Preset,
    axes: Sequence[Axis],
    sources: Sequence[str],
    *,
    frames: FrameRange = ALL_FRAMES,
    objectives: Sequence[str] = (),
    sampler: Sampler | None = None,
    trials: int | None = None,
    seed: int = 0,
    opener: OpenSource = open_source,
    progress: Callable[[str], None] = lambda source: None,
) -> Plan:
    """Check a request and return the plan. Sources are opened and hashed; no trial is run.

    Parameters
    ----------
    base : Preset
    axes : sequence of Axis
        Empty: `default_axes`.
    sources : sequence of str
    frames : FrameRange
    objectives : sequence of str
        Empty: the RMSE and the time, or without truth the stability and the time.
    sampler : str, optional
        Default: the grid if each axis has steps and no number of trials is given, else TPE.
    trials : int, optional
        Default: the whole grid, or `TRIALS`.
    seed : int
    opener, progress : callable
        See `inspect_clips`.

    Raises
    ------
    TactuneError
        An unknown field, value, objective or source, or nothing to search.
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
    clips = inspect_clips(sources, frames, base, opener, progress)
    blind = next((clip.source for clip in clips if not clip.has_truth), None)
    wanted = tuple(dict.fromkeys(objectives)) or (("rmse", "ms") if blind is None else ("stability", "ms"))
    for name in wanted:
        if blind is not None and OBJECTIVES[name].needs_truth:
            without = ", ".join(name for name, figure in OBJECTIVES.items() if not figure.needs_truth)
            raise TuneError(f"{blind} has no ground truth, so {name} is undefined; choose from {without}")
        if name == "stability" and not any(len(clip.frames) > 1 for clip in clips):
            raise TuneError("stability compares consecutive frames, but there is only one; choose another --objective")
    return Plan(base, axes, tuple(clips), wanted, chosen, count, seed)


class Study:
    """The study of a plan in a journal file; a context manager.

    The file holds finished trials only, each written at once, so a search that is killed leaves nothing to mend. It is
    sampled from a copy in memory. Several searches may work on one study: each notes in the file which listed points
    (of a grid or quasi-random) it measures, and takes those of others once no other points are left, because the others
    may be dead. The first result of a point counts.

    Parameters
    ----------
    plan : Plan
    path : Path
        Created if it does not exist. May hold several studies.
    """

    def __init__(self, plan: Plan, path: Path) -> None:
        self.plan, self.path = plan, path
        self._distributions = {axis.path: _distribution(axis) for axis in plan.axes}
        self._present = {axis.path: plain_value(plan.base, axis.path) for axis in plan.axes}
        self._search = f"{_SEARCH}{secrets.token_hex(4)}"

    def __enter__(self) -> Self:
        """Open the file.

        Raises
        ------
        TuneError
            The file is not a journal.
        ExportError
            It cannot be written.
        """
        if self.path.exists() and not self.path.is_file():
            raise TuneError(f"{self.path} is no ordinary file; choose another --study")
        with self._undamaged():
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._study = self._open()
            self.trials()
            self._claim([])
        return self

    def __exit__(self, *_: object) -> None:
        """Give up the points that were not measured."""
        with suppress(*_DAMAGE, OSError):  # it was told already
            self._claim([])

    def trials(self) -> list[Trial]:
        """Return all measured trials, by number."""
        with self._undamaged():
            return [self._trial(trial) for trial in self._measured()]

    def front(self) -> list[Trial]:
        """Return the trials that no other trial beats in all objectives, the best by the first objective first.

        Trials that found no contact at all do not count.
        """
        first = self.plan.objectives[0]
        sign = -1.0 if OBJECTIVES[first].larger else 1.0

        def rank(trial: Trial) -> tuple[float, float]:
            return float(f"{sign * trial.figures[first]:.9g}"), trial.figures.get("ms", 0.0)

        with self._undamaged():
            counted = {trial.number for trial in self._measured()}
            return sorted((self._trial(it) for it in self._study.best_trials if it.number in counted), key=rank)

    def run(self, workers: Workers, stopped: Callable[[], bool] = lambda: False) -> Iterator[int]:
        """Measure trials until the plan's number is reached; yield the number that is measured each time it grows.

        Close the iterator or let ``stopped`` return True to cancel. Trials that have been counted are in the file.

        Raises
        ------
        TactuneError
            A batch cannot be measured, the workers are gone, or the file was damaged or removed meanwhile.
        """
        with self._undamaged():
            yield from self._run(workers, stopped)

    def _run(self, workers: Workers, stopped: Callable[[], bool]) -> Iterator[int]:
        running: dict[Future[list[Measured]], list[optuna.Trial]] = {}
        self._listed = self._list_points()
        self._sampled = self._make_sampled()
        self._known = 0
        ahead = 2 if self._listed else 1
        said = len(self._measured())
        yield said
        while said < self.plan.trials and not stopped():
            take_over = not running
            while len(running) < ahead * max(1, workers.count()):
                trials = self._ask(workers.count(), [trial for batch in running.values() for trial in batch], take_over)
                if not trials:
                    break
                values = tuple(self._values(trial) for trial in trials)
                timed = "ms" in self.plan.objectives
                batch = Batch(self.plan.base, self.plan.clips, code_version(), values, timed)
                try:
                    running[workers.executor.submit(measure_batch, batch)] = trials
                except BrokenProcessPool as error:
                    raise TuneError(_KILLED) from error
            for future in wait(running, _LOOK_S, FIRST_COMPLETED).done:
                for trial, measured in zip(running.pop(future), _result(future, workers), strict=True):
                    self._tell(trial, measured)
            workers.check()
            if (done := len(self._measured())) != said:
                said = done
                yield done

    def _open(self) -> optuna.Study:
        lock = JournalFileOpenLock(str(self.path), grace_period=_GRACE_S)
        lock.acquire()
        try:
            with self.path.open("a+b") as file:  # a line that was cut off by a crash would spoil the next one
                file.seek(0)
                data = file.read()
                if not data.startswith(_JOURNAL[: len(data)]):  # a person's file must stay as it is
                    raise TuneError(f"{self.path} exists and is not the file of a search; choose another --study")
                file.truncate(data.rfind(b"\n") + 1)
        finally:
            lock.release()
        study = optuna.create_study(
            storage=JournalStorage(JournalFileBackend(str(self.path), lock_obj=lock)),
            study_name=f"{self.plan.base.name[:60]} {self.plan.identity}",
            directions=self._directions,
            load_if_exists=True,
        )
        if not study.user_attrs:
            with _no_experimental_warning():
                study.set_metric_names(list(self.plan.objectives))
            study.set_user_attr("sources", [clip.source for clip in self.plan.clips])
            study.set_user_attr("preset", {path: plain_value(self.plan.base, path) for path in result_paths()})
        return study

    @property
    def _directions(self) -> list[Direction]:
        return ["maximize" if OBJECTIVES[name].larger else "minimize" for name in self.plan.objectives]

    @contextmanager
    def _undamaged(self) -> Iterator[None]:
        """Raise a `TuneError` where the journal is damaged, an `ExportError` where it cannot be written."""
        try:
            yield
        except _DAMAGE as error:
            raise TuneError(f"{self.path} is damaged or not the file of a search; choose another --study") from error
        except OSError as error:
            raise ExportError(f"cannot write {self.path}: {error.strerror or error}; choose another --study") from error

    def _list_points(self) -> list[dict[str, Any]]:
        """Return the points of a grid or of a quasi-random sequence; none if a sampler learns from earlier trials."""
        if self.plan.sampler == "grid":
            return grid_of(self.plan.axes)
        if self.plan.sampler != "qmc":
            return []
        with _no_experimental_warning():
            sampler = optuna.samplers.QMCSampler(scramble=True, seed=self.plan.seed, warn_independent_sampling=False)
        study = optuna.create_study(sampler=sampler)
        study.tell(study.ask(self._distributions), 0.0)  # the sequence begins after the first trial
        drawn = [self._values(study.ask(self._distributions)) for _ in range(self.plan.trials)]
        return [*self._first(), *drawn][: self.plan.trials]

    def _first(self) -> list[dict[str, Any]]:
        """Return the present preset's values if they belong to the space."""
        return [self._present] if all(axis.holds(self._present[axis.path]) for axis in self.plan.axes) else []

    def _make_sampled(self) -> optuna.Study:
        """Return an empty study in memory with the sampler; each search has a seed of its own."""
        searches = [name for name in self._study.user_attrs if name.startswith(_SEARCH)]
        seed = self.plan.seed + searches.index(self._search)
        sampler: optuna.samplers.BaseSampler = optuna.samplers.TPESampler(seed=seed)
        if self.plan.sampler == "nsga2":
            sampler = optuna.samplers.NSGAIISampler(population_size=_POPULATION, seed=seed)
        return optuna.create_study(directions=self._directions, sampler=sampler)

    def _ask(self, workers: int, running: list[optuna.Trial], take_over: bool) -> list[optuna.Trial]:
        """Begin the trials of one batch; none if all are measured or running.

        Parameters
        ----------
        running : list of Trial
            Those that this search measures.
        take_over : bool
            Whether points that another search measures may be taken if no others are left.
        """
        measured = self._measured()
        for trial in measured[self._known :]:  # of earlier and of other searches
            if trial.user_attrs["search"] != self._search:
                self._sampled.add_trial(trial)
        self._known = len(measured)
        mine = [trial.user_attrs["point"] for trial in running if self._listed]
        missing = self._missing_points({*mine, *map(_point, measured)}, take_over)
        left = len(missing) if self._listed else self.plan.trials - len(measured) - len(running)
        frames = sum(len(clip.frames) for clip in self.plan.clips)
        share = -(-left // (_BATCHES_A_WORKER * max(1, workers)))
        size = min(left, max(1, min(_FRAMES_A_BATCH // frames, _TRIALS_A_BATCH[self.plan.sampler], share)))
        if self._listed:
            for point in missing[:size]:
                self._queue(point, self._listed[point])
            self._claim(mine + missing[:size])
        elif not measured and not running:
            for values in self._first():
                self._queue(0, values)
        return [self._sampled.ask(self._distributions) for _ in range(size)]

    def _missing_points(self, known: set[int | None], take_over: bool) -> list[int]:
        """Return the listed points that are not known, those that other searches measure only if no others are left."""
        missing = [point for point in range(len(self._listed)) if point not in known]
        searches = {name: points for name, points in self._study.user_attrs.items() if name.startswith(_SEARCH)}
        claimed = {point for name, points in searches.items() if name != self._search for point in points}
        return [point for point in missing if point not in claimed] or (missing if take_over else [])

    def _queue(self, point: int, values: dict[str, Any]) -> None:
        params = {axis.path: _label(values[axis.path]) if axis.values else values[axis.path] for axis in self.plan.axes}
        self._sampled.enqueue_trial(params, user_attrs={"point": point, "values": values})

    def _claim(self, points: list[int]) -> None:
        """Note in the file which listed points this search measures."""
        self._study.set_user_attr(self._search, points)

    def _tell(self, trial: optuna.Trial, measured: Measured) -> None:
        """Write a result to the file, unless another search was first."""
        point, known = trial.user_attrs.get("point"), self._measured()
        if len(known) >= self.plan.trials or (point is not None and point in map(_point, known)):
            return
        absent = [name for name in self.plan.objectives if name not in measured.figures]
        failure = measured.failure or (f"{absent[0]} is undefined on these frames" if absent else "")
        if not failure and not measured.figures["points"]:
            trial.set_constraint("contact found", 1.0)
        trial.set_user_attr("search", self._search)
        trial.set_user_attr("measured", {"figures": measured.figures, "failure": failure})
        if failure:
            self._sampled.tell(trial, state=TrialState.FAIL)
        else:
            self._sampled.tell(trial, [measured.figures[name] for name in self.plan.objectives])
        self._study.add_trial(self._sampled.get_trials(deepcopy=False)[trial.number])

    def _measured(self) -> list[FrozenTrial]:
        """Return the trials in the file; of a point that two searches have measured, the first."""
        trials, points = [], set[int | None]()
        for trial in self._study.get_trials(deepcopy=False):
            if (point := _point(trial)) is None or point not in points:
                trials.append(trial)
                points.add(point)
        return trials

    def _trial(self, trial: FrozenTrial) -> Trial:
        found, values = trial.user_attrs["measured"], self._values(trial)
        figures = {name: float(figure) for name, figure in found["figures"].items()}
        return Trial(trial.number, values, figures, str(found["failure"]), values == self._present)

    def _values(self, trial: optuna.Trial | FrozenTrial) -> dict[str, Any]:
        if "values" in trial.user_attrs:
            return {axis.path: trial.user_attrs["values"][axis.path] for axis in self.plan.axes}
        return {
            axis.path: next(value for value in axis.values if _label(value) == trial.params[axis.path])
            if axis.values
            else axis.fitting(trial.params[axis.path])
            for axis in self.plan.axes
        }


def tuned_preset(plan: Plan, trial: Trial, trials: int) -> Preset:
    """Return a preset with a trial's values; its name and notes describe the search."""
    figures = ", ".join(f"{name} {trial.figures[name]:.4g} {OBJECTIVES[name].unit}".strip() for name in plan.objectives)
    values = ", ".join(f"{path} {json.dumps(value)}" for path, value in trial.values.items())
    told = (
        f"Trial {trial.number} of {trials}, {FOUND_BY} on {now():%Y-%m-%d}: {figures}. Searched: {values}. "
        f"Sources: {'; '.join(clip.source for clip in plan.clips)}."
    )
    preset = plan.base.with_values(trial.values | {"name": f"{plan.base.name[:90]}, tuned"})
    notes = f"{plan.base.notes}\n\n{told}".strip()[-10_000:]
    return preset.model_copy(update={"notes": notes, "created": now(), "modified": now()})


@contextmanager
def _no_experimental_warning() -> Iterator[None]:
    with warnings.catch_warnings(action="ignore", category=optuna.exceptions.ExperimentalWarning):
        yield


def _point(trial: FrozenTrial) -> int | None:
    """Return the number of a trial's listed point; None if a sampler chose it."""
    point: int | None = trial.user_attrs.get("point")
    return point


def _distribution(axis: Axis) -> BaseDistribution:
    if axis.values:
        return CategoricalDistribution(list(map(_label, axis.values)))
    if axis.whole:
        return IntDistribution(round(axis.low), round(axis.high), log=axis.log)
    return FloatDistribution(axis.low, axis.high, log=axis.log)


def _label(value: Any) -> Any:
    """Return a value as Optuna stores choices: ranges and poses as JSON text."""
    return json.dumps(value) if isinstance(value, list | dict) else value


def _result(future: Future[list[Measured]], workers: Workers) -> list[Measured]:
    try:
        return future.result()
    except TactuneError:
        raise
    except BrokenProcessPool as error:
        raise TuneError(_KILLED) from error
    except CancelledError as error:
        raise TuneError(SCHEDULER_GONE) from error
    except Exception as error:
        workers.check()  # a scheduler that went away is the reason for whatever error its client gives
        raise TuneError(
            f"a worker failed ({type(error).__name__}: {str(error).partition(chr(10))[0][:200]}); check that each has "
            "this version of Tactune and enough memory, and give the same command again"
        ) from error
