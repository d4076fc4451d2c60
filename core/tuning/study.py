"""The search: an Optuna study in a journal file, which any number of processes and computers may share.

The file is the only state. A search that was killed continues with the same command; ``optuna-dashboard`` reads it.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from ..errors import ExportError, MissingExtraError
from ..preset import Preset, now
from .measure import Measured, measure
from .plan import OBJECTIVES, Axis, Plan, TuneError, grid_of, plain_value
from .workers import Workers

try:
    import optuna
    from optuna.storages.journal import JournalFileBackend, JournalFileOpenLock, JournalStorage
    from optuna.trial import TrialState
except ImportError as missing:
    raise MissingExtraError("a search needs optuna: install it with pip install 'tactune[tune]'") from missing

#: Upper limits of a batch: frames summed over its trials, about ten seconds of work; and its trials. Samplers that
#: learn from earlier trials get small batches.
_FRAMES_A_BATCH: Final = 500
_TRIALS_A_BATCH: Final = {"grid": 50, "qmc": 50, "tpe": 4, "nsga2": 10}
_POPULATION: Final = 20
#: Minimum number of batches per worker, so that no worker is idle towards the end.
_BATCHES_A_WORKER: Final = 4
#: Interval of looks at workers and other searches, and grace period of a lock whose holder was killed, seconds.
_LOOK_S: Final = 0.5
_GRACE_S: Final = 5
#: In the notes of each preset that a search has written.
FOUND_BY: Final = "found by tactune tune"

#: How each line of Optuna's journal begins.
_JOURNAL: Final = b'{"op_code":'
#: What Optuna, or reading a trial, raises for a journal that is damaged or was removed.
_DAMAGE: Final = (ValueError, LookupError, TypeError, AttributeError, AssertionError, RecursionError, OverflowError)

optuna.logging.set_verbosity(optuna.logging.ERROR)


@dataclass(frozen=True)
class Trial:
    """A measured trial: Optuna's number, plain values of the fields that vary, and `Measured` as figures or failure.

    ``present``: it is the preset that the search started from.
    """

    number: int
    values: dict[str, Any]
    figures: dict[str, float]
    failure: str
    present: bool


class Study:
    """The study of a plan in a journal file.

    A trial of Optuna is begun in the file, then measured, then told. Whoever finds no more to begin takes over what
    others have begun, because they may be dead; Optuna keeps the first result of a trial and refuses others.

    The file is created if it does not exist, and may hold several studies. Raises a `TuneError` if it is not a journal,
    an `ExportError` if it cannot be written.
    """

    def __init__(self, plan: Plan, path: Path) -> None:
        self.plan, self.path = plan, path
        self._present = {axis.path: plain_value(plan.base, axis.path) for axis in plan.axes}
        if path.exists() and not path.is_file():
            raise TuneError(f"{path} is no ordinary file; choose another --study")
        with self._undamaged():
            path.parent.mkdir(parents=True, exist_ok=True)
            self._study = self._open()
        self.results()

    def results(self) -> tuple[list[Trial], list[Trial]]:
        """Return the measured trials by number, and the front: those that no other beats in all objectives.

        The best by the first objective comes first. Trials that found no contact at all are not on the front.
        """
        first = self.plan.objectives[0]
        sign = -1.0 if OBJECTIVES[first].larger else 1.0
        with self._undamaged():
            best = self._study.best_trials  # before all trials: another search may finish one in between
            trials = {}
            for trial in self._study.get_trials(deepcopy=False):
                if trial.state.is_finished():
                    values, (figures, failure) = self._values(trial.params), trial.user_attrs["measured"]
                    told = dict(zip(self.plan.objectives, trial.values or (), strict=False))
                    figures = figures | told  # another search may have measured it, too
                    trials[trial.number] = Trial(trial.number, values, figures, failure, values == self._present)
            front = [trials[trial.number] for trial in best]
            front.sort(key=lambda it: (float(f"{sign * it.figures[first]:.9g}"), it.figures.get("ms", 0.0)))
            return list(trials.values()), front

    def run(self, workers: Workers, stopped: Callable[[], bool] = lambda: False) -> Iterator[int]:
        """Measure trials until the plan's number is reached; yield the number that is measured each time it grows.

        Close the iterator or let ``stopped`` return True to cancel. Trials that have been counted are in the file.

        Raises
        ------
        TactuneError
            A batch cannot be measured, the workers are gone, or the file was damaged or removed meanwhile.
        """
        with self._undamaged():
            self._points = self._first_points()
            ahead = 2 if len(self._points) > 1 else 1
            running: dict[Future[list[Measured]], list[optuna.Trial]] = {}
            said = -1
            while said < self.plan.trials and not stopped():
                take_over = not running
                while len(running) < ahead * max(1, workers.count()):
                    numbers = {trial.number for batch in running.values() for trial in batch}
                    if not (trials := self._begin(workers.count(), numbers, take_over)):
                        break
                    with workers.told():
                        values = [self._values(trial.params) for trial in trials]
                        running[workers.submit(measure, self.plan, values)] = trials
                for future in wait(running, _LOOK_S, FIRST_COMPLETED).done:
                    with workers.told():
                        measured = future.result()
                    for trial, found in zip(running.pop(future), measured, strict=True):
                        self._tell(trial, found)
                done = sum(trial.state.is_finished() for trial in self._study.get_trials(deepcopy=False))
                if done != said:
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
            directions=["maximize" if OBJECTIVES[name].larger else "minimize" for name in self.plan.objectives],
            load_if_exists=True,
        )
        if not study.user_attrs:
            with _experimental():
                study.set_metric_names(list(self.plan.objectives))
            study.set_user_attr("sources", [clip.source for clip in self.plan.clips])
        return study

    @contextmanager
    def _undamaged(self) -> Iterator[None]:
        """Raise a `TuneError` where the journal is damaged, an `ExportError` where it cannot be written."""
        try:
            yield
        except _DAMAGE as error:
            raise TuneError(f"{self.path} is damaged or not the file of a search; choose another --study") from error
        except OSError as error:
            raise ExportError(f"cannot write {self.path}: {error.strerror or error}; choose another --study") from error

    def _first_points(self) -> list[dict[str, Any]]:
        """Return Optuna's parameters of the first trials: a grid or quasi-random sequence, or the present preset's."""
        if self.plan.sampler == "grid":
            return [{axis.path: _label(axis, point[axis.path]) for axis in self.plan.axes}
                    for point in grid_of(self.plan.axes)]  # fmt: skip
        present = {axis.path: _label(axis, self._present[axis.path]) for axis in self.plan.axes}
        points = [present] if all(axis.holds(self._present[axis.path]) for axis in self.plan.axes) else []
        if self.plan.sampler == "qmc":
            with _experimental():
                qmc = optuna.samplers.QMCSampler(scramble=True, seed=self.plan.seed, warn_independent_sampling=False)
            drawn = optuna.create_study(sampler=qmc)
            drawn.tell(_suggest(self.plan.axes, drawn.ask()), 0.0)  # the sequence begins after the first trial
            points += [_suggest(self.plan.axes, drawn.ask()).params for _ in range(self.plan.trials)]
        return points

    def _begin(self, workers: int, running: Collection[int], take_over: bool) -> list[optuna.Trial]:
        """Begin the trials of one batch; none if all have begun. What others have begun may be taken over then."""
        begun = self._study.get_trials(deepcopy=False)
        left = max(self.plan.trials - len(begun), 0)
        others: list[int] = []
        if not left and take_over:
            unfinished = (trial for trial in begun[: self.plan.trials] if not trial.state.is_finished())
            others = [trial._trial_id for trial in unfinished if trial.number not in running]
        size = self._batch_size(max(left, len(others)), workers)
        trials = [self._study.ask() for _ in range(min(size, left))]
        trials += [optuna.Trial(self._study, trial_id) for trial_id in others[:size]]
        chosen = []
        for trial in trials:
            with suppress(optuna.exceptions.UpdateFinishedTrialError):  # another search was first with one taken over
                if trial.number < self.plan.trials:  # not so where another search began the last ones meanwhile
                    chosen.append(self._choose(trial))
        return chosen

    def _batch_size(self, trials: int, workers: int) -> int:
        """Return how many trials a worker measures at once: few enough that none is idle towards the end."""
        share = -(-trials // (_BATCHES_A_WORKER * max(1, workers)))
        frames = sum(len(clip.frames) for clip in self.plan.clips)
        return max(1, min(_FRAMES_A_BATCH // frames, _TRIALS_A_BATCH[self.plan.sampler], share))

    def _choose(self, trial: optuna.Trial) -> optuna.Trial:
        """Choose a trial's parameters by its number, so that searches that share a file never draw the same."""
        seed = int(np.random.SeedSequence((self.plan.seed, trial.number)).generate_state(1)[0])
        sampler: optuna.samplers.BaseSampler = optuna.samplers.TPESampler(seed=seed)
        if self.plan.sampler == "nsga2":
            sampler = optuna.samplers.NSGAIISampler(population_size=_POPULATION, seed=seed)
        if trial.number < len(self._points):
            with _experimental():
                sampler = optuna.samplers.PartialFixedSampler(self._points[trial.number], sampler)
        self._study.sampler = sampler
        return _suggest(self.plan.axes, trial)

    def _tell(self, trial: optuna.Trial, measured: Measured) -> None:
        """Write a result to the file, unless another search was first."""
        if self._study.get_trials(deepcopy=False)[trial.number].params != trial.params:
            return  # another search chose others at the same moment; the trial is measured again with those in the file
        figures, failure = measured
        undefined = [name for name in self.plan.objectives if name not in figures]
        if undefined and not failure:
            failure = f"{undefined[0]} is undefined on these frames"
        with suppress(optuna.exceptions.UpdateFinishedTrialError):
            trial.set_user_attr("measured", (figures, failure))
            if failure:
                self._study.tell(trial, state=TrialState.FAIL, skip_if_finished=True)
                return
            if not figures["points"]:
                trial.set_constraint("contact found", 1.0)
            self._study.tell(trial, [figures[name] for name in self.plan.objectives], skip_if_finished=True)

    def _values(self, params: dict[str, Any]) -> dict[str, Any]:
        """Return the fields' values for Optuna's parameters."""
        values = {}
        for axis in self.plan.axes:
            param, present = params[axis.path], self._present[axis.path]
            values[axis.path] = (
                json.loads(param) if axis.values else present if param == present else axis.fitting(param)
            )
        return values


def _suggest(axes: Sequence[Axis], trial: optuna.Trial) -> optuna.Trial:
    """Have a trial choose its parameters; those that it has stay."""
    for axis in axes:
        if axis.values:
            trial.suggest_categorical(axis.path, [_label(axis, value) for value in axis.values])
        elif axis.whole:
            trial.suggest_int(axis.path, round(axis.low), round(axis.high), log=axis.log)
        else:
            trial.suggest_float(axis.path, axis.low, axis.high, log=axis.log)
    return trial


def _label(axis: Axis, value: Any) -> Any:
    """Return a value as Optuna stores it: a listed one as JSON text, because lists and poses are no choices."""
    return json.dumps(value) if axis.values else value


@contextmanager
def _experimental() -> Iterator[None]:
    """Use what Optuna calls experimental."""
    with warnings.catch_warnings(action="ignore", category=optuna.exceptions.ExperimentalWarning):
        yield


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
