"""The table of sensors: the shipped contact test beside the tolerance test, on many sensors and membranes.

A *case* is one sensor, one membrane and one press; its numbers are means over objects and seeds. One frame is scored
for each scene and seed, and all methods get the same frames.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal

from ..errors import TactuneError
from ..methods.method import ContactMethod, MethodPatch
from ..methods.registry import make_method
from ..model.files import finite_or_none
from ..model.frames import Rig, SensorFrame
from ..preset import Preset
from ..rig.noise import NOISE_FRAMES, measure_noise
from ..sources.base import FrameSource, Progress
from ..sources.registry import open_source
from ..sources.simulator.membranes import MEMBRANES
from ..sources.simulator.scenes import HELD_OUT
from ..sources.simulator.sensors import SENSORS
from .metrics import TruthTree
from .table_cell import (
    FRAMES_PER_CELL,
    OBJECTS,
    PRESSES,
    STRAIGHT,
    MakeMethod,
    MethodRun,
    PlannedScene,
    TableCell,
    TableCellFolder,
    build_method,
    check_choice,
    failure_of,
    plan_scenes,
    run_method,
    score_run,
    true_contact,
)

#: Tolerances from which the oracle and the best fixed tolerance are chosen.
TOLERANCES: Final = (0.003, 0.004, 0.005, 0.006, 0.007, 0.008, 0.010, 0.012, 0.015, 0.018, 0.022, 0.026, 0.030)
#: The tolerance test with rigid alignment, one name for each tolerance.
TOLERANCE_TESTS: Final = {f"tolerance-{t:.3f}": t for t in TOLERANCES}
SHIPPED: Final = "fusion-membrane"
AVERAGED: Final = "fusion-averaged"
METHODS: Final = (STRAIGHT, *TOLERANCE_TESTS, SHIPPED, AVERAGED)

#: Whether the noise and bias of each rig are measured before its contact is.
RigKnowledge = Literal["measured", "unmeasured"]
#: Returns the preset with the measured noise of a rig, from the source of a scene.
MeasureRig = Callable[[Preset, FrameSource], Preset]
#: Opens a scene by its name; calls the given function with its progress.
OpenScene = Callable[[str, Progress], FrameSource]


def measured_rig(preset: Preset, source: FrameSource) -> Preset:
    """Return the preset with noise and bias of a simulated rig, measured while nothing touches the membrane.

    Raises
    ------
    TactuneError
        The source is no simulator, or the noise cannot be measured.
    """
    from ..sources.simulator.source import SimulatorSource  # on demand: it loads the solver

    if not isinstance(source, SimulatorSource):
        raise TactuneError(f"{source.name} has no frames without the object; choose a simulated source")
    with source.with_object_away() as away:
        frames = list(itertools.islice(away, NOISE_FRAMES))
        return preset.model_copy(update={"noise": measure_noise(frames, away.rig, preset)})


@dataclass(frozen=True)
class SensorPlan:
    """Scenes and seeds of a table of sensors.

    Attributes
    ----------
    scenes : tuple of PlannedScene
        Each with its sensor and membrane; scenes that share the solved membrane follow one another.
    seeds : tuple of int
        Noise seeds.
    preset : Preset
    work : Path
        Folder of finished frames.
    rig : {"measured", "unmeasured"}
    """

    scenes: tuple[PlannedScene, ...]
    seeds: tuple[int, ...]
    preset: Preset
    work: Path
    rig: RigKnowledge = "measured"

    @property
    def count(self) -> int:
        """Number of scored frames."""
        return len(self.scenes) * len(self.seeds)


def plan_sensors(
    sensors: Sequence[str] = (),
    membranes: Sequence[str] = (),
    objects: Sequence[str] = (),
    presses: Sequence[str] = PRESSES,
    *,
    held_out: bool = False,
) -> tuple[PlannedScene, ...]:
    """List the scenes of a table of sensors.

    Parameters
    ----------
    sensors, membranes : sequence of str
        Names of the simulator. Empty: all that methods are developed on; with ``held_out``, all others.
    objects, presses : sequence of str
        As in `plan_scenes`.
    held_out : bool
        Allow sensors, membranes and objects that are held out of development.

    Raises
    ------
    TactuneError
        A name is unknown, or held out without ``held_out``.
    """
    chosen = {
        what: _chosen(what, names, {name: entry.held_out for name, entry in known.items()}, held_out)
        for what, names, known in (("sensor", sensors, SENSORS), ("membrane", membranes, MEMBRANES))
    }
    still = plan_scenes(objects or (HELD_OUT if held_out else OBJECTS), presses, extra=False, held_out=held_out)
    return tuple(
        replace(scene, sensor=sensor, membrane=membrane)
        for membrane, scene, sensor in itertools.product(chosen["membrane"], still, chosen["sensor"])
    )


def _chosen(what: str, names: Sequence[str], known: dict[str, bool], held_out: bool) -> tuple[str, ...]:
    """Return the given names, or all that are held out or not, after a check.

    Parameters
    ----------
    known : dict of str to bool
        Each known name, and whether it is held out.
    """
    allowed = [name for name in known if held_out or not known[name]]
    check_choice("the simulator", what, names, allowed, known)
    return tuple(dict.fromkeys(names)) or tuple(name for name in known if known[name] == held_out)


def measure_sensors(
    plan: SensorPlan,
    measure_rig: MeasureRig = measured_rig,
    make: MakeMethod = make_method,
    open_scene: OpenScene = open_source,
) -> Iterator[list[TableCell]]:
    """Yield the cells of all `METHODS`, frame by frame; frames stored in ``plan.work`` are not measured again.

    Stop iterating to cancel: all yielded cells are stored. The next frame is read while this one is scored; no other
    work runs while a method is timed.

    Parameters
    ----------
    plan : SensorPlan
    measure_rig : callable, optional
        Measures a rig, once for each sensor and membrane, if the plan says so. If it fails, so do the methods that use
        the measured noise.

    Raises
    ------
    TactuneError
        A scene cannot be opened or a cell cannot be stored.
    """
    folder = TableCellFolder(plan.work, plan.preset, variant=f"rig {plan.rig}")
    wanted = list(itertools.product(plan.scenes, plan.seeds))
    stored = [folder.load(METHODS, scene, seed) for scene, seed in wanted]
    missing = iter([frame for frame, cells in zip(wanted, stored, strict=True) if cells is None])
    bench = _Bench(plan.preset, make)
    with _Reader(plan.preset, measure_rig if plan.rig == "measured" else None, open_scene) as reader:
        reader.begin(next(missing, None))
        for (scene, seed), known in zip(wanted, stored, strict=True):
            cells = known
            if cells is None:
                shown = reader.finish()
                runs = bench.run(shown)
                reader.begin(next(missing, None))
                cells = score_runs(runs, scene, seed, shown.frames[-1], shown.rig)
                folder.save(cells, scene)
            yield cells


@dataclass(frozen=True, eq=False)
class _Shown:
    """Frames of one scene with one seed, their rig, and the preset with its measured noise or why it has none."""

    frames: list[SensorFrame]
    rig: Rig
    preset: Preset | TactuneError


class _Reader:
    """Reads the frames of one scene and seed after another, in a thread of its own. A context manager."""

    def __init__(self, preset: Preset, measure_rig: MeasureRig | None, open_scene: OpenScene) -> None:
        self._preset, self._measure, self._open = preset, measure_rig, open_scene
        self._measured: dict[tuple[str, str, int], Preset | TactuneError] = {}
        self._pool = ThreadPoolExecutor(1)
        self._next: Future[_Shown] | None = None
        self._last: FrameSource | None = None
        self._closing = False

    def begin(self, frame: tuple[PlannedScene, int] | None) -> None:
        """Begin to read the frames of a scene with a seed; nothing for None."""
        self._next = self._pool.submit(self._read, *frame) if frame is not None else None

    def finish(self) -> _Shown:
        """Return what `begin` was asked for; wait for it."""
        assert self._next is not None
        return self._next.result()

    def _read(self, scene: PlannedScene, seed: int) -> _Shown:
        source = self._open(f"{scene.source}&seed={seed}", self._go_on)
        before, self._last = self._last, source  # closed after the next one is open: they share the solved membrane
        if before is not None:
            before.close()
        rig = (scene.sensor, scene.membrane, seed)  # each seed has a bias of its own
        if rig not in self._measured:
            try:
                self._measured[rig] = self._measure(self._preset, source) if self._measure else self._preset
            except TactuneError as error:
                self._measured[rig] = error
        return _Shown(list(itertools.islice(source, FRAMES_PER_CELL)), source.rig, self._measured[rig])

    def _go_on(self, _fraction: float, _text: str) -> None:
        """Stop solving a scene that nobody waits for any longer."""
        if self._closing:
            raise TactuneError("the table was cancelled")

    def __enter__(self) -> _Reader:
        return self

    def __exit__(self, *_: object) -> None:
        self._closing = True
        self._pool.shutdown(cancel_futures=True)
        if self._last is not None:
            self._last.close()


class _Bench:
    """Runs all methods on a frame. Methods that do not depend on the measured noise are built once for each rig."""

    def __init__(self, preset: Preset, make: MakeMethod) -> None:
        self._preset, self._make = preset, make
        self._rig: Rig | None = None
        self._kept: dict[str, ContactMethod] = {}

    def run(self, shown: _Shown) -> dict[str, MethodRun]:
        """Run `METHODS` on the frames; those with memory or measured noise on several, the others on the last."""
        if shown.rig != self._rig:
            self._rig, self._kept = shown.rig, {}
        runs = {}
        for name in METHODS:
            build = partial(self._by_noise if name in (SHIPPED, AVERAGED) else self._plain, name, shown)
            runs[name] = run_method(build, shown.frames, warm=name in self._kept)
        return runs

    def _by_noise(self, name: str, shown: _Shown) -> ContactMethod:
        if isinstance(shown.preset, TactuneError):
            raise shown.preset
        return build_method(name, shown.preset, shown.rig, None, self._make)

    def _plain(self, name: str, shown: _Shown) -> ContactMethod:
        if name not in self._kept:
            kind, preset = name, self._preset
            if name in TOLERANCE_TESTS:
                kind, preset = "fusion-rigid", preset.with_values({"tolerance.t": TOLERANCE_TESTS[name]})
            self._kept[name] = build_method(kind, preset, shown.rig, None, self._make)
        return self._kept[name]


def score_runs(
    runs: dict[str, MethodRun], scene: PlannedScene, seed: int, frame: SensorFrame, rig: Rig
) -> list[TableCell]:
    """Score what all methods found in one frame: number of points, and the RMSE as `TruthTree` measures it.

    Raises
    ------
    TactuneError
        The frame has no ground truth.
    """
    truth, truth_mm2 = true_contact(frame, rig)
    patches = [run.patch for run in runs.values() if run.patch is not None]
    rmses_m = TruthTree(truth).symmetric_rmses_m([patch.points for patch in patches])
    rmse_mm = {id(patch): finite_or_none(1e3 * rmse_m) for patch, rmse_m in zip(patches, rmses_m, strict=True)}

    def scores(patch: MethodPatch, frame: SensorFrame, rig: Rig) -> dict[str, Any]:
        reason = failure_of(patch, truth)
        numbers = {"failure": reason} if reason else {"rmse_mm": rmse_mm[id(patch)], "points": len(patch.points)}
        return {"true_mm2": truth_mm2, **numbers}

    cells = [score_run(name, scene, seed, run, frame, rig, scores) for name, run in runs.items()]
    return [replace(cell, true_mm2=truth_mm2) for cell in cells]
