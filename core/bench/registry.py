"""The engines: every way to do a job that the benchmark compares, registered by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from importlib import import_module
from importlib.util import find_spec

from ..errors import TactuneError
from ..model.arrays import AnyArray, BoolArray
from .scenes import BenchScene


class Job(StrEnum):
    """What an engine does. Engines of the same job are compared."""

    PIPELINE = "pipeline"
    PER_PIXEL = "per pixel"
    OUTLIERS = "outliers"


@dataclass(frozen=True, eq=False)
class Outcome:
    """What an engine found.

    Attributes
    ----------
    make_mask : callable
        Returns the proximity pixels that are contact (pipeline, per pixel) or inliers (outliers). It is called
        after the clock has stopped, because most consumers need the points only.
    points : float, shape (N, 3), or None
        Metres, proximity depth frame.
    """

    make_mask: Callable[[], BoolArray]
    points: AnyArray | None = None

    @property
    def mask(self) -> BoolArray:
        """The mask, bool, shape (H, W)."""
        return self.make_mask()


#: Does the job once, on the scene that it was made for. Everything that can be prepared is prepared.
Runner = Callable[[], Outcome]


@dataclass(frozen=True)
class Engine:
    """One way to do a job.

    Attributes
    ----------
    make : callable
        Prepares the engine for a scene.
    exact : bool
        Whether it promises the outcome of the float64 reference up to rounding.
    baseline : bool
        Whether ratios are relative to this engine.
    needs : tuple of str
        Packages without which the engine is skipped.
    """

    name: str
    job: Job
    title: str
    make: Callable[[BenchScene], Runner]
    exact: bool = True
    baseline: bool = False
    needs: tuple[str, ...] = ()

    @property
    def missing(self) -> tuple[str, ...]:
        """Packages that are needed but not installed."""
        return tuple(package for package in self.needs if find_spec(package) is None)


_ENGINES: dict[str, Engine] = {}

#: Modules of `engines`; each registers its engines when it is imported.
_MODULES = ("reference", "open3d_only", "tactune")


def engine(
    name: str, job: Job, title: str, *, exact: bool = True, baseline: bool = False, needs: tuple[str, ...] = ()
) -> Callable[[Callable[[BenchScene], Runner]], Callable[[BenchScene], Runner]]:
    """Register a function that prepares an engine for a scene and returns the function to be timed."""

    def register(make: Callable[[BenchScene], Runner]) -> Callable[[BenchScene], Runner]:
        if name in _ENGINES:
            raise ValueError(f"two engines are called {name!r}")
        _ENGINES[name] = Engine(name, job, title, make, exact, baseline, needs)
        return make

    return register


def engines(job: Job | None = None) -> list[Engine]:
    """Return the engines of one job, or all engines, in the order of registration."""
    for module in _MODULES:
        import_module(f".engines.{module}", __package__)
    return [found for found in _ENGINES.values() if job is None or found.job == job]


def find_engine(name: str) -> Engine:
    """Return an engine by its name.

    Raises
    ------
    TactuneError
        There is no such engine; the message lists the known ones.
    """
    engines()
    if name not in _ENGINES:
        raise TactuneError(f"there is no engine {name!r}; known are {', '.join(_ENGINES)}")
    return _ENGINES[name]
