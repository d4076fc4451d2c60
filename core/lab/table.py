"""The table of methods: every method on simulated presses with known truth, on any sensor of the simulator.

A *cell* is one method on one press, with one sensor, membrane and seed. Cells are measured by several processes and are
stored, so that an interrupted table goes on where it stopped.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import as_completed
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import fmean, median
from typing import Any, Final

import cv2
import numpy as np

from ..contact.kernels.threads import available_threads, set_threads
from ..contact.pipeline import ContactPipeline
from ..errors import TactuneError
from ..model.files import atomic_path, code_version, finite_or_none
from ..model.frames import GroundTruth, SensorFrame
from ..model.loading import read_json
from ..model.metrics import TruthTree, pixel_scores, true_contact
from ..model.patch import ContactPatch
from ..preset import Preset
from ..rig.noise import NOISE_FRAMES, measure_noise
from ..rig.untouched import untouched_frame
from ..sources.base import FrameSource
from ..sources.registry import open_source
from ..sources.simulator.objects import HELD_OUT
from ..sources.simulator.scenes import MEMBRANES
from ..sources.simulator.sensors import DEFAULT_SENSOR, SENSORS
from ..tuning.measure import local_workers
from .methods import OF_NOISE, PIPELINES, check_methods, make_method, method_names

PRESSES: Final = ("low", "medium", "high")
OBJECTS: Final = ("octopus", "cup", "cube")
#: First seed of held-out tables; development uses smaller seeds only.
FIRST_HELD_OUT_SEED: Final = 100

#: The tolerance test with the tolerance of each frame that is best, which only the truth tells, of `TOLERANCES`.
BEST_T: Final = "best-t"
TOLERANCES: Final = (0.003, 0.004, 0.005, 0.006, 0.007, 0.008, 0.010, 0.012, 0.015, 0.018, 0.022, 0.026, 0.030)

#: A method gets the last frames of this many, the last of which is scored.
FRAMES: Final = 16
_TIMED_FRAMES: Final = 5

#: True points from which the distance to a patch is measured.
_SAMPLES: Final = 6000
NO_CONTACT_FOUND: Final = "it found no contact although there is one"
#: Smallest contact in which an empty patch counts as a failure, mm^2.
MIN_TOUCHED_MM2: Final = 200.0


@dataclass(frozen=True)
class Scene:
    """A simulated press. Presses with ``press="high"`` are off-centre: at ``side`` left and right, else empty."""

    sensor: str
    membrane: str
    object: str
    press: str
    side: str

    def source(self, seed: int) -> str:
        side = f"&side={self.side}" if self.side else ""
        return f"sim:{self.object}?press={self.press}{side}&membrane={self.membrane}&sensor={self.sensor}&seed={seed}"


@dataclass(frozen=True)
class Cell(Scene):
    """One method on one press: symmetric RMSE to the true contact, IoU of the pixels, and why there is no patch."""

    seed: int
    method: str
    rmse_mm: float | None = None
    iou: float | None = None
    force_error: float | None = None  # Of the force over the inflation, share
    points: int = 0
    true_mm2: float = 0.0
    failure: str = ""


@dataclass(frozen=True)
class Plan:
    """What a table compares, with one preset of which `PIPELINES` sets some fields; ``work`` keeps the cells."""

    scenes: tuple[Scene, ...]
    seeds: tuple[int, ...]
    methods: tuple[str, ...]
    preset: Preset
    work: Path

    @property
    def presses(self) -> int:
        """Number of presses with a seed; each has one cell for each method."""
        return len(self.scenes) * len(self.seeds)


def table_methods() -> tuple[str, ...]:
    first, *others = method_names()
    return (first, BEST_T, *others)


def plan_table(
    preset: Preset,
    work: Path,
    *,
    methods: Sequence[str] = (),
    objects: Sequence[str] = (),
    presses: Sequence[str] = PRESSES,
    sensors: Sequence[str] = (DEFAULT_SENSOR,),
    membranes: Sequence[str] = (),
    seeds: int = 2,
    held_out: bool = False,
) -> Plan:
    """Choose the cells of a table. Empty names: all that methods are developed on; with ``held_out``, all others."""
    chosen = methods or table_methods()
    check_methods(chosen, table_methods())
    held = {name: name in HELD_OUT for name in (*OBJECTS, *HELD_OUT)}
    found = [
        _chosen(what, names, known, held_out)
        for what, names, known in (
            ("membrane", membranes, {name: name.startswith("held-") for name in MEMBRANES}),
            ("object", objects, held),
            ("press", presses, dict.fromkeys(PRESSES, held_out)),
            ("sensor", sensors, {name: entry.held_out for name, entry in SENSORS.items()}),
        )
    ]
    scenes = [
        Scene(sensor, membrane, thing, press, side)
        for membrane, thing, press, sensor in itertools.product(*found)
        for side in (("right", "left") if press == "high" else ("",))
    ]
    first = FIRST_HELD_OUT_SEED if held_out else 0
    return Plan(tuple(scenes), tuple(range(first, first + seeds)), tuple(chosen), preset, work)


def _chosen(what: str, names: Sequence[str], known: dict[str, bool], held_out: bool) -> tuple[str, ...]:
    """Return the given names, or all that are held out or not; ``known`` tells which are."""
    for name in names:
        if name not in known or (known[name] and not held_out):
            allowed = ", ".join(name for name in known if held_out or not known[name])
            is_held = f"; {name!r} is held out: add --held-out" if known.get(name) else ""
            raise TactuneError(f"the table has no {what} {name!r}; choose from {allowed}{is_held}")
    return tuple(dict.fromkeys(names)) or tuple(name for name in known if known[name] == held_out)


# Measuring


def measure_table(plan: Plan, processes: int = 0) -> Iterator[list[Cell]]:
    """Yield the cells of one press after another, the stored ones first; stop iterating to cancel."""
    missing: list[tuple[Scene, int]] = []
    for scene, seed in itertools.product(plan.scenes, plan.seeds):
        known = load_cells(plan, scene, seed)
        if known is None:
            missing.append((scene, seed))
        else:
            yield known
    presses = [
        list(group) for _, group in itertools.groupby(missing, key=lambda each: (each[0].membrane, each[0].object))
    ]
    count = min(processes or available_threads(), len(presses))
    if count <= 1:
        yield from itertools.chain.from_iterable(_measure(plan, press) for press in presses)
        return
    with local_workers(count) as workers:
        for done in as_completed([workers.submit(_measure_on_one_core, plan, press) for press in presses]):
            yield from done.result()


def _measure_on_one_core(plan: Plan, presses: list[tuple[Scene, int]]) -> list[list[Cell]]:
    set_threads(1)
    cv2.setNumThreads(1)
    return _measure(plan, presses)


def _measure(plan: Plan, presses: list[tuple[Scene, int]]) -> list[list[Cell]]:
    """Measure and store presses of one object on one membrane."""
    rigs: dict[tuple[str, int], _Rig] = {}
    found = []
    for _, group in itertools.groupby(presses, key=lambda press: replace(press[0], sensor="")):
        with ExitStack() as still_open:  # the sources of a solved scene share its images while one is open
            for scene, seed in group:
                source = still_open.enter_context(open_source(scene.source(seed)))
                key = scene.sensor, seed  # each seed has a bias of its own
                if key not in rigs:
                    rigs[key] = _Rig.measured(plan, source)
                found.append(score(plan, scene, seed, source, rigs[key]))
                save_cells(plan, scene, seed, found[-1])
    return found


@dataclass(frozen=True, eq=False)
class _Rig:
    """What is known of a rig: the preset with its measured noise, or why there is none, and an untouched frame."""

    preset: Preset | TactuneError
    untouched: SensorFrame | None

    @classmethod
    def measured(cls, plan: Plan, source: FrameSource) -> _Rig:
        untouched = untouched_frame(source)
        try:
            return cls(measured_rig(plan.preset, source), untouched)
        except TactuneError as error:
            return cls(error, untouched)


def measured_rig(preset: Preset, source: FrameSource) -> Preset:
    """Return the preset with noise and bias of a simulated rig, measured while nothing touches the membrane."""
    from ..sources.simulator.simulator_source import SimulatorSource  # on demand: it loads the solver

    if not isinstance(source, SimulatorSource):
        raise TactuneError(f"{source.name} has no frames without the object; choose a simulated source")
    with source.with_object_away() as away:
        frames = list(itertools.islice(away, NOISE_FRAMES))
        return preset.model_copy(update={"noise": measure_noise(frames, away.rig, preset)})


def score(plan: Plan, scene: Scene, seed: int, source: FrameSource, rig: _Rig) -> list[Cell]:
    """Return the cells of all methods on one press."""
    frames = list(itertools.islice(source, FRAMES))
    truth, true_mm2 = true_contact(frames[-1], source.rig)
    known = frames[-1].truth
    assert known is not None  # `true_contact` has checked
    patches: dict[str, list[ContactPatch]] = {}
    failures: dict[str, str] = {}
    for name in plan.methods:
        try:
            patches[name] = _patches(name, plan.preset, rig, source, frames)
        except TactuneError as error:
            failures[name] = str(error)
    tree = TruthTree(truth, _SAMPLES)
    base = Cell(**asdict(scene), seed=seed, method="", true_mm2=true_mm2)
    cells = []
    for name in plan.methods:
        scored = [(tree.symmetric_rmse_m(patch.points), patch) for patch in patches.get(name, ()) if len(patch.points)]
        if not scored:
            cells.append(replace(base, method=name, failure=failures.get(name, NO_CONTACT_FOUND)))
            continue
        rmse_m, patch = min(scored, key=lambda pair: pair[0])
        iou = pixel_scores(patch.mask, known.contact).iou
        rmse_mm = finite_or_none(1e3 * rmse_m)
        missed = _force_error(patch, known)
        cells.append(replace(base, method=name, rmse_mm=rmse_mm, iou=iou, force_error=missed, points=len(patch.points)))
    return cells


def _force_error(patch: ContactPatch, truth: GroundTruth) -> float | None:
    """Return the error of the force over the inflation as a share of the true one; None where one is not known."""
    if patch.pressure is None or truth.force_n is None or truth.inflation_pa is None:
        return None
    true_mm2 = 1e6 * np.array(truth.force_n) / truth.inflation_pa
    return finite_or_none(float(np.linalg.norm(patch.pressure.force_mm2 - true_mm2) / np.linalg.norm(true_mm2)))


def _patches(
    name: str, preset: Preset, rig: _Rig, source: FrameSource, frames: Sequence[SensorFrame]
) -> list[ContactPatch]:
    """Return the patches of a method in the last frame: one, or one for each tolerance."""
    if name == BEST_T:
        pipeline = ContactPipeline(preset.with_values(PIPELINES["fusion-rigid"]), source.rig)
        found = []
        for t in TOLERANCES:
            pipeline.update(preset.with_values({**PIPELINES["fusion-rigid"], "tolerance.t": t}))
            found.append(pipeline.process(frames[-1]))
        return found
    if name in OF_NOISE:  # only they use the measured noise
        if isinstance(rig.preset, TactuneError):
            raise rig.preset
        preset = rig.preset
    find = make_method(name, preset, source.rig, rig.untouched)
    seen = int(PIPELINES.get(name, {}).get("membrane.frames", 1))  # up to and including the frame that is judged
    return [[find(frame) for frame in frames[-seen:]][-1]]


def time_table(plan: Plan) -> dict[tuple[str, str, str], float]:
    """Return each method's milliseconds per frame by (sensor, method, press), on the first object and membrane."""
    times: dict[tuple[str, str, str], float] = {}
    rigs: dict[str, _Rig] = {}
    first, seed = plan.scenes[0], plan.seeds[0]
    for scene in plan.scenes:
        if (scene.object, scene.membrane) != (first.object, first.membrane) or scene.side == "left":
            continue
        with open_source(scene.source(seed)) as source:
            rig = rigs.get(scene.sensor) or _Rig.measured(plan, source)
            rigs[scene.sensor] = rig
            frames = list(itertools.islice(source, FRAMES))
            for name in plan.methods:
                with suppress(TactuneError):
                    preset = rig.preset if name in OF_NOISE else plan.preset
                    if name == BEST_T or isinstance(preset, TactuneError):
                        continue
                    find = make_method(name, preset, source.rig, rig.untouched)
                    for frame in frames[:-_TIMED_FRAMES]:
                        find(frame)
                    taken = []
                    for frame in frames[-_TIMED_FRAMES:]:
                        started = time.perf_counter()
                        find(frame)
                        taken.append(1e3 * (time.perf_counter() - started))
                    times[scene.sensor, name, scene.press] = median(taken)
    return times


# Finished cells


def _path(plan: Plan, scene: Scene, seed: int) -> Path:
    settings = plan.preset.model_dump(mode="json", exclude={"name", "notes", "created", "modified"})
    key = json.dumps([asdict(scene), seed, settings, code_version()], sort_keys=True)
    digest = hashlib.sha256(key.encode()).hexdigest()[:20]
    return plan.work / f"{scene.sensor}-{scene.membrane}-{scene.object}-{scene.press}-{digest}.json"


def load_cells(plan: Plan, scene: Scene, seed: int) -> list[Cell] | None:
    """Return the stored cells of a press; None if one is missing or the file is damaged."""
    try:
        cells = {found["method"]: Cell(**found) for found in read_json(_path(plan, scene, seed))}
    except (OSError, ValueError, TypeError, KeyError):
        return None
    return [cells[name] for name in plan.methods] if cells.keys() >= set(plan.methods) else None


def save_cells(plan: Plan, scene: Scene, seed: int, cells: Sequence[Cell]) -> None:
    """Store the cells of a press; raises `ExportError`."""
    with atomic_path(_path(plan, scene, seed)) as temporary:
        temporary.write_text(json.dumps([asdict(cell) for cell in cells], allow_nan=False), encoding="utf-8")


# Averages and text


def mean_rmse_mm(cells: Iterable[Cell]) -> float:
    """Return the mean over membranes of that over seeds, objects and sides, without cells that have no patch."""

    def mean(cells: list[Cell], keys: Sequence[str]) -> float:
        if not keys:
            return fmean(cell.rmse_mm for cell in cells if cell.rmse_mm is not None)
        groups: dict[Any, list[Cell]] = {}
        for cell in cells:
            groups.setdefault(getattr(cell, keys[0]), []).append(cell)
        return fmean(mean(group, keys[1:]) for group in groups.values())

    known = [cell for cell in cells if cell.rmse_mm is not None]
    return mean(known, ("membrane", "seed", "object")) if known else math.nan


def cell_line(cells: Sequence[Cell]) -> str:
    first = cells[0]
    where = " ".join(filter(None, (first.sensor, first.membrane, first.object, first.press, first.side)))
    rmses = ", ".join(f"{cell.method} {_number(cell.rmse_mm, 2)}" for cell in cells)
    return f"{where} seed {first.seed}, RMSE in mm: {rmses}"


def table_text(cells: Sequence[Cell], times: dict[tuple[str, str, str], float]) -> str:
    """Return the table: a line for each sensor and method."""
    presses = [press for press in PRESSES if any(cell.press == press for cell in cells)]
    lines = [["sensor", "method", *presses, "IoU", "force %", "empty", *(f"ms {press}" for press in presses)]]
    for sensor, method in dict.fromkeys((cell.sensor, cell.method) for cell in cells):
        mine = [cell for cell in cells if (cell.sensor, cell.method) == (sensor, method)]
        ious = [[cell.iou or 0.0 for cell in mine if cell.press == press] for press in presses]
        iou = "/".join(_number(fmean(each) if each else None, 2) for each in ious)
        errors = [100 * cell.force_error for cell in mine if cell.force_error is not None and cell.press != "low"]
        force = median(errors) if errors else None
        empty = sum(1 for cell in mine if cell.failure and cell.true_mm2 >= MIN_TOUCHED_MM2)
        rmses = [_number(mean_rmse_mm(cell for cell in mine if cell.press == press), 2) for press in presses]
        ms = [_number(times.get((sensor, method, press)), 1) for press in presses]
        lines.append([sensor, method, *rmses, iou, _number(force, 1), str(empty), *ms])
    note = (
        "RMSE to the true contact in mm (symmetric), mean over membranes, seeds and objects. best-t: the tolerance\n"
        "test with the best t of each frame. IoU of pixels by press, 0 without a patch. force: median error at\n"
        "medium and high press, of the force over the inflation. empty: presses without a patch although\n"
        f"{MIN_TOUCHED_MM2:g} mm2 or more touch. ms: per frame, on all cores, first object and membrane."
    )
    failures = dict.fromkeys(f"{c.method}: {c.failure}" for c in cells if c.failure not in ("", NO_CONTACT_FOUND))
    return "\n".join([aligned(lines), note, *failures])


def _number(number: float | None, digits: int) -> str:
    return "-" if number is None or not math.isfinite(number) else f"{number:.{digits}f}"


def aligned(lines: Sequence[Sequence[str]]) -> str:
    """Return lines of text cells as text: the first two columns to the left, the others to the right."""
    widths = [max(len(line[column]) for line in lines) for column in range(len(lines[0]))]
    return "\n".join(
        "  ".join(
            text.ljust(width) if column < 2 else text.rjust(width)
            for column, (text, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )
