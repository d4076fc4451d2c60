"""The search: an Optuna study in a journal file.

The file is the only state. A search that was ended continues with the same command; ``optuna-dashboard`` reads it.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from ..errors import ExportError, MissingExtraError, TactuneError
from ..preset import Preset, now
from .measure import Measured, Workers, measure
from .plan import OBJECTIVES, Axis, Plan, TuneError, grid_of, plain_value

try:
    import optuna
    from optuna.storages.journal import JournalFileBackend, JournalFileOpenLock, JournalStorage
    from optuna.trial import TrialState
except ImportError as missing:
    raise MissingExtraError("a search needs optuna: install it with pip install 'tactune[tune]'") from missing

#: Upper limits of a batch: frames summed over its trials, about ten seconds of work; and its trials.
_FRAMES_A_BATCH, _TRIALS_A_BATCH = 500, 4
#: Interval of looks at workers, seconds.
_LOOK_S: Final = 0.5
#: A lock is held for milliseconds: one that has not changed for so long is that of a process that was killed, seconds.
_DEAD_S: Final = 5
#: In the notes of each preset that a search has written.
FOUND_BY: Final = "found by tactune tune"
#: How each line of Optuna's journal begins.
_JOURNAL: Final = b'{"op_code":'

optuna.logging.set_verbosity(optuna.logging.ERROR)


@dataclass(frozen=True)
class Trial:
    """A measured trial: Optuna's number, values of the fields that vary, and figures or failure."""

    number: int
    values: dict[str, Any]
    figures: dict[str, float]
    failure: str
    present: bool


class Study:
    """The study of a plan in a journal file, which may hold several; `TuneError` if the file is none."""

    def __init__(self, plan: Plan, path: Path) -> None:
        self.plan, self.path = plan, path
        self._present = {axis.path: plain_value(plan.base, axis.path) for axis in plan.axes}
        if path.exists() and not path.is_file():
            raise TuneError(f"{path} is no ordinary file; choose another --study")
        with self._told():
            path.parent.mkdir(parents=True, exist_ok=True)
            self._study = self._open()
        self.results()

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Say in a sentence what is wrong with the file."""
        try:
            yield
        except TactuneError:
            raise
        except OSError as error:
            raise ExportError(
                f"cannot write {self.path}: {error.strerror or error}; trials in it are kept, or choose another --study"
            ) from error
        except Exception as error:  # what Optuna raises for a damaged journal depends on where it is damaged
            raise TuneError(f"{self.path} is damaged, not the file of a search, or in use; choose another") from error

    def results(self) -> tuple[list[Trial], list[Trial]]:
        """Return the measured trials by number, and those that no other beats, by the first objective."""
        first = self.plan.objectives[0]
        sign = -1.0 if OBJECTIVES[first].larger else 1.0
        trials: dict[object, Trial] = {}
        with self._told():
            for trial in self._study.get_trials(deepcopy=False):
                if trial.state.is_finished() and "measured" in trial.user_attrs:
                    values, (figures, failure) = self._values(trial.params), trial.user_attrs["measured"]
                    # two searches at once may measure a point of the grid twice; it counts once
                    key = json.dumps(values, sort_keys=True) if self.plan.grid else trial.number
                    if key not in trials or trial.state == TrialState.COMPLETE:
                        trials[key] = Trial(trial.number, values, figures, failure, values == self._present)
            best = {trial.number for trial in self._study.best_trials}
            front = [trial for trial in trials.values() if trial.number in best]
        front.sort(key=lambda it: (float(f"{sign * it.figures[first]:.9g}"), it.figures.get("ms", 0.0)))
        return list(trials.values()), front

    def run(self, workers: Workers, stopped: Callable[[], bool] = lambda: False) -> Iterator[int]:
        """Measure trials until the plan's number is reached or ``stopped``; yield how many are measured."""
        with self._told():
            yield from self._measure(workers, stopped)

    def _measure(self, workers: Workers, stopped: Callable[[], bool]) -> Iterator[int]:
        self._prepare()
        running: dict[Future[list[Measured]], list[optuna.Trial]] = {}
        done = begun = len(self.results()[0])
        frames = sum(len(clip.frames) for clip in self.plan.clips)
        yield done
        while done < self.plan.trials and not stopped():
            while begun < self.plan.trials and len(running) < workers.count + 1:
                size = max(1, min(_TRIALS_A_BATCH, _FRAMES_A_BATCH // frames, self.plan.trials - begun))
                trials = [_suggest(self.plan.axes, self._study.ask()) for _ in range(size)]
                values = [self._values(trial.params) for trial in trials]
                with _worker():
                    running[workers.submit(measure, self.plan, values)] = trials
                begun += size
            for future in wait(running, _LOOK_S, FIRST_COMPLETED).done:
                with _worker():
                    measured = future.result()
                for trial, found in zip(running.pop(future), measured, strict=True):
                    self._tell(trial, found)
                    done += 1
                yield done

    def _open(self) -> optuna.Study:
        lock = JournalFileOpenLock(str(self.path), grace_period=_DEAD_S)
        with self.path.open("a+b") as file:  # a line that was cut off by a crash would spoil the next one
            file.seek(0)
            data = file.read()
            if not data.startswith(_JOURNAL[: len(data)]):  # a person's file must stay as it is
                raise TuneError(f"{self.path} exists and is not the file of a search; choose another --study")
            file.truncate(data.rfind(b"\n") + 1)
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

    def _prepare(self) -> None:
        """Queue the first trials that are not measured yet: the whole grid, or the present preset."""
        seed = len(self._study.get_trials(deepcopy=False))  # a search that goes on draws others
        with _experimental():
            self._study.sampler = optuna.samplers.TPESampler(seed=seed, constant_liar=True)
        for trial in self._study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):  # of a search that was ended
            self._end(trial.number, *trial.user_attrs.get("measured", ({}, "the search ended")))
        points = [self._present] if all(axis.holds(self._present[axis.path]) for axis in self.plan.axes) else []
        if self.plan.grid:
            points = grid_of(self.plan.axes)
        known = [trial.values for trial in self.results()[0]]
        queued = self._study.get_trials(deepcopy=False, states=(TrialState.WAITING,))
        known += [self._values(trial.system_attrs["fixed_params"]) for trial in queued]
        for point in points:
            if point not in known:
                labels = {axis.path: json.dumps(point[axis.path]) for axis in self.plan.axes if axis.values}
                self._study.enqueue_trial(point | labels)

    def _tell(self, trial: optuna.Trial, measured: Measured) -> None:
        """Write a result to the file."""
        figures, failure = measured
        undefined = [name for name in self.plan.objectives if name not in figures]
        if undefined and not failure:
            failure = f"{undefined[0]} is undefined on these frames"
        if not failure and not figures["points"]:
            trial.set_constraint("contact found", 1.0)
        trial.set_user_attr("measured", (figures, failure))
        self._end(trial.number, figures, failure)

    def _end(self, number: int, figures: dict[str, float], failure: str) -> None:
        if failure:
            self._study.tell(number, state=TrialState.FAIL)
        else:
            self._study.tell(number, [figures[name] for name in self.plan.objectives])

    def _values(self, params: dict[str, Any]) -> dict[str, Any]:
        """Return the fields' values for Optuna's parameters."""
        values = {}
        for axis in self.plan.axes:
            param, present = params[axis.path], self._present[axis.path]
            values[axis.path] = (
                json.loads(param) if axis.values else present if param == present else axis.fitting(param)
            )
        return values


def _experimental() -> warnings.catch_warnings[None]:
    """Return a context in which Optuna does not warn of what it calls experimental."""
    return warnings.catch_warnings(action="ignore", category=optuna.exceptions.ExperimentalWarning)


@contextmanager
def _worker() -> Iterator[None]:
    """Say in a sentence that a worker failed."""
    try:
        yield
    except TactuneError:
        raise
    except Exception as error:
        said = str(error).partition("\n")[0][:200]
        raise TuneError(
            f"a worker failed or was killed ({type(error).__name__}: {said}); try fewer --jobs if memory ran out, "
            "check that each worker has this version of Tactune, and give the same command again"
        ) from error


def _suggest(axes: Sequence[Axis], trial: optuna.Trial) -> optuna.Trial:
    """Have a trial choose its parameters."""
    for axis in axes:
        if axis.values:  # as JSON text, because lists and poses are no choices
            trial.suggest_categorical(axis.path, list(map(json.dumps, axis.values)))
        elif axis.whole:
            trial.suggest_int(axis.path, round(axis.low), round(axis.high), log=axis.log)
        else:
            trial.suggest_float(axis.path, axis.low, axis.high, log=axis.log)
    return trial


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
