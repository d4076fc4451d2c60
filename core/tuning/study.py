"""The search: an Optuna study in a journal file, which any number of processes and computers may share.

The file is the only state. A search that was killed continues with the same command; ``optuna-dashboard`` reads it.
"""

from __future__ import annotations

import hashlib
import json
import secrets
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Any, Final, Literal, Self

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
#: Grace period of a lock whose holder was killed, and of a trial that was begun but not yet claimed, seconds.
_GRACE_S: Final = 10

#: The trial of the preset that the search starts from.
PRESENT: Final = "present"
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
        decisive = [
            fixed,
            list(map(asdict, self.axes)),
            clips,
            self.objectives,
            self.sampler,
            self.seed,
            code_version(),
        ]
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

    Several processes may work on the same study. Each holds a lock on a file of its own beside the journal, which the
    system releases however the process ends, so that the others can tell which running trials are abandoned.

    Parameters
    ----------
    plan : Plan
    path : Path
        Created if it does not exist. May hold several studies.
    """

    def __init__(self, plan: Plan, path: Path) -> None:
        self.plan, self.path = plan, path
        self._grid = grid_of(plan.axes) if plan.sampler == "grid" else []
        self._distributions = {axis.path: _distribution(axis) for axis in plan.axes}
        self._present = {axis.path: plain_value(plan.base, axis.path) for axis in plan.axes}
        self._searcher = secrets.token_hex(4)

    def __enter__(self) -> Self:
        """Open the file, and free the trials of searches that were killed.

        Raises
        ------
        TuneError
            The file is not a journal.
        ExportError
            It cannot be written.
        """
        if self.path.exists() and not self.path.is_file():
            raise TuneError(f"{self.path} is no ordinary file; choose another --study")
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with self._undamaged():
                self._study = self._open()
                self.trials()
            self._alive = self._alive_file(self._searcher).open("xb")
            _lock(self._alive)
        except OSError as error:
            raise ExportError(f"cannot write {self.path}: {error.strerror or error}; choose another --study") from error
        return self

    def __exit__(self, *_: object) -> None:
        """Free this search's own unfinished trials."""
        with suppress(*_DAMAGE, OSError):  # it was told already, and the next search frees them
            for trial in self._all(TrialState.RUNNING):
                if trial.user_attrs.get("searcher") == self._searcher:
                    self._study.tell(trial.number, state=TrialState.FAIL)
        self._alive.close()
        self._alive_file(self._searcher).unlink(missing_ok=True)

    def trials(self) -> list[Trial]:
        """Return all measured trials, by number."""
        return [self._trial(trial) for trial in self._all() if _is_measured(trial)]

    def front(self) -> list[Trial]:
        """Return the trials that no other trial beats in all objectives, the best by the first objective first.

        Trials that found no contact at all do not count.
        """
        found = [self._trial(trial) for trial in self._study.best_trials]
        first = self.plan.objectives[0]
        sign = -1.0 if OBJECTIVES[first].larger else 1.0

        def rank(trial: Trial) -> tuple[float, float]:
            return float(f"{sign * trial.figures[first]:.9g}"), trial.figures.get("ms", 0.0)

        return sorted(found, key=rank)

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
        self._study.sampler = self._sampler()
        ahead = 2 if self.plan.sampler in ("grid", "qmc") else 1
        said = len(self.trials())
        yield said
        while not stopped():
            while len(running) < ahead * max(1, workers.count()) and (trials := self._ask(workers.count())):
                values = tuple(self._values(trial) for trial in trials)
                timed = "ms" in self.plan.objectives
                batch = Batch(self.plan.base, self.plan.clips, code_version(), values, timed)
                try:
                    running[workers.executor.submit(measure_batch, batch)] = trials
                except BrokenProcessPool as error:
                    raise TuneError(_KILLED) from error
            if not running and not self._all(TrialState.RUNNING, TrialState.WAITING) and not self._missing_points():
                break
            if not running:
                time.sleep(_LOOK_S)  # another search is about to finish the last trials
            for future in wait(running, _LOOK_S, FIRST_COMPLETED).done:
                for trial, measured in zip(running.pop(future), _result(future, workers), strict=True):
                    self._tell(trial, measured)
            workers.check()
            if (done := len(self.trials())) != said:
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
        directions: list[Direction] = [
            "maximize" if OBJECTIVES[name].larger else "minimize" for name in self.plan.objectives
        ]
        study = optuna.create_study(
            storage=JournalStorage(JournalFileBackend(str(self.path), lock_obj=lock)),
            study_name=f"{self.plan.base.name[:60]} {self.plan.identity}",
            directions=directions,
            load_if_exists=True,
        )
        if not study.user_attrs:
            with warnings.catch_warnings(action="ignore", category=optuna.exceptions.ExperimentalWarning):
                study.set_metric_names(list(self.plan.objectives))
            study.set_user_attr("sources", [clip.source for clip in self.plan.clips])
            study.set_user_attr("preset", {path: plain_value(self.plan.base, path) for path in result_paths()})
        return study

    @contextmanager
    def _undamaged(self) -> Iterator[None]:
        """Raise a `TuneError` where the journal is damaged or was removed."""
        try:
            yield
        except _DAMAGE as error:
            raise TuneError(f"{self.path} is damaged or not the file of a search; choose another --study") from error

    def _sampler(self) -> optuna.samplers.BaseSampler:
        """Return the sampler. Its seed changes as trials are added, lest a continued search draws the same again."""
        seed = self.plan.seed + len(self._all()) + (0 if not self._others() else int(self._searcher, 16) % 2**20)
        if self.plan.sampler == "qmc":
            with warnings.catch_warnings(action="ignore", category=optuna.exceptions.ExperimentalWarning):
                return optuna.samplers.QMCSampler(scramble=True, seed=self.plan.seed, warn_independent_sampling=False)
        if self.plan.sampler == "nsga2":
            return optuna.samplers.NSGAIISampler(population_size=_POPULATION, seed=seed)
        if self.plan.sampler == "tpe":
            return optuna.samplers.TPESampler(seed=seed)
        return optuna.samplers.RandomSampler(seed=seed)  # its draws do not count: all points of a grid are queued

    def _ask(self, workers: int) -> list[optuna.Trial]:
        """Begin the trials of one batch; none if all are measured or running."""
        self._free_abandoned()
        if not self._grid and all(axis.holds(self._present[axis.path]) for axis in self.plan.axes):
            self._offer(PRESENT, self._present)
        waiting = self._all(TrialState.WAITING)
        missing = self._missing_points()
        left = (
            len(missing) + len(waiting) if self._grid else self.plan.trials - len(list(filter(_is_begun, self._all())))
        )
        frames = sum(len(clip.frames) for clip in self.plan.clips)
        share = -(-left // (_BATCHES_A_WORKER * max(1, workers)))
        size = max(1, min(_FRAMES_A_BATCH // frames, _TRIALS_A_BATCH[self.plan.sampler], share))
        begun = []
        for at in range(min(size, left)):
            if self._grid and at >= len(waiting):
                point = missing[at - len(waiting)]
                self._offer(point, self._grid[point])
            trial = self._study.ask(self._distributions)
            trial.set_user_attr("searcher", self._searcher)
            if self._is_surplus(trial.number):
                self._study.tell(trial, state=TrialState.FAIL)
            else:
                begun.append(trial)
        return begun

    def _missing_points(self) -> list[int]:
        """Return the points of the grid that are neither measured nor begun nor queued, in the grid's order."""
        known = {trial.user_attrs.get("point") for trial in self._all() if _is_live(trial)}
        return [point for point in range(len(self._grid)) if point not in known]

    def _is_surplus(self, number: int) -> bool:
        """Return whether another search has begun the same point, or the last trial, before this trial.

        A trial of a grid without a point was drawn at random, since another search had begun the queued one.
        """
        *before, mine = [trial for trial in self._all() if trial.number <= number and _is_begun(trial)]
        point = mine.user_attrs.get("point")
        doubled = point is not None and any(trial.user_attrs.get("point") == point for trial in before)
        return doubled or (point is None if self._grid else len(before) >= self.plan.trials)

    def _offer(self, point: int | str, values: dict[str, Any]) -> None:
        """Queue a trial unless there is one."""
        if not any(trial.user_attrs.get("point") == point for trial in self._all() if _is_live(trial)):
            self._study.enqueue_trial(self._params(values), user_attrs={"point": point})

    def _tell(self, trial: optuna.Trial | FrozenTrial, measured: Measured) -> None:
        objectives = self.plan.objectives
        absent = [name for name in objectives if name not in measured.figures]
        failure = measured.failure or (f"{absent[0]} is undefined on these frames" if absent else "")
        if isinstance(trial, optuna.Trial):
            if not failure and not measured.figures["points"]:
                trial.set_constraint("contact found", 1.0)
            trial.set_user_attr("measured", {"figures": measured.figures, "failure": failure})
        with suppress(optuna.exceptions.UpdateFinishedTrialError):  # another search took it for abandoned
            if failure:
                self._study.tell(trial.number, state=TrialState.FAIL)
            else:
                self._study.tell(trial.number, [measured.figures[name] for name in objectives])

    def _free_abandoned(self) -> None:
        """Finish the running trials of searches that have ended, as failed; measured ones keep their result."""
        running = self._all(TrialState.RUNNING)
        if all(trial.user_attrs.get("searcher") == self._searcher for trial in running):
            return
        others = self._others()
        for trial in running:
            owner = trial.user_attrs.get("searcher")
            if owner is None and others:
                begun = trial.datetime_start.timestamp() if trial.datetime_start else 0.0
                abandoned = time.time() - begun > _GRACE_S
            else:
                abandoned = owner not in {*others, self._searcher}
            with suppress(ValueError, optuna.exceptions.UpdateFinishedTrialError):  # freed by another search
                if abandoned and "measured" in trial.user_attrs:
                    self._tell(trial, Measured(**trial.user_attrs["measured"]))
                elif abandoned:
                    self._study.tell(trial.number, state=TrialState.FAIL)

    def _others(self) -> set[str]:
        """Return the other searches that are alive; remove the files of those that have ended."""
        alive = set()
        for path in self.path.parent.glob(f"{self.path.name}.*.alive"):
            name = path.name.split(".")[-2]
            if name == self._searcher:
                continue
            try:
                with path.open("r+b") as file:
                    _lock(file)
                path.unlink(missing_ok=True)
            except FileNotFoundError:
                continue
            except OSError:
                alive.add(name)
        return alive

    def _alive_file(self, searcher: str) -> Path:
        return self.path.with_name(f"{self.path.name}.{searcher}.alive")

    def _all(self, *states: TrialState) -> list[FrozenTrial]:
        return self._study.get_trials(deepcopy=False, states=states or None)

    def _trial(self, trial: FrozenTrial) -> Trial:
        found = trial.user_attrs["measured"]
        values = self._values(trial)
        return Trial(trial.number, values, found["figures"], found["failure"], values == self._present)

    def _params(self, values: dict[str, Any]) -> dict[str, Any]:
        return {axis.path: _label(values[axis.path]) if axis.values else values[axis.path] for axis in self.plan.axes}

    def _values(self, trial: optuna.Trial | FrozenTrial) -> dict[str, Any]:
        if trial.user_attrs.get("point") == PRESENT:
            return self._present
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


def _is_measured(trial: FrozenTrial) -> bool:
    return trial.state.is_finished() and "measured" in trial.user_attrs


def _is_live(trial: FrozenTrial) -> bool:
    return not trial.state.is_finished() or _is_measured(trial)


def _is_begun(trial: FrozenTrial) -> bool:
    return trial.state == TrialState.RUNNING or _is_measured(trial)


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


def _lock(file: IO[bytes]) -> None:
    """Lock a file until it is closed; a crash releases the lock. Raises OSError if another process holds it."""
    if sys.platform == "win32":
        import msvcrt

        msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
    else:
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
