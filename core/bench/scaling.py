"""How run time depends on the number of contact points, the image size, the stage and the number of threads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..contact.kernels.threads import available_threads, get_threads, set_threads
from ..contact.pipeline import ContactPipeline
from .measure import Timing, time_in_turns
from .registry import Outcome, Progress, Runner, find_engine
from .scenes import BenchScene, make_scene, synthetic_scene

POINTS = (1_000, 3_000, 10_000, 30_000, 100_000, 300_000)
SIZES = ((320, 240), (640, 480), (960, 540), (1280, 720))
ENGINES = ("reference", "tactune")


@dataclass(frozen=True)
class GrowthRow:
    """Run times of several engines at one size."""

    points: int
    width: int
    height: int
    timings: dict[str, Timing]


def growth_with_points(
    rounds: int, names: Sequence[str] = ENGINES, progress: Progress = lambda share, words: None
) -> list[GrowthRow]:
    """Measure from 1,000 to 300,000 contact points in 640 x 480 images."""
    return _grow([synthetic_scene(points) for points in POINTS], rounds, names, progress)


def growth_with_size(
    rounds: int, names: Sequence[str] = ENGINES, progress: Progress = lambda share, words: None
) -> list[GrowthRow]:
    """Measure images from 320 x 240 to 1280 x 720 with a tenth of the pixels in contact."""
    scenes = [synthetic_scene(width * height // 10, width, height) for width, height in SIZES]
    return _grow(scenes, rounds, names, progress)


def _grow(scenes: list[BenchScene], rounds: int, names: Sequence[str], progress: Progress) -> list[GrowthRow]:
    rows = []
    for done, scene in enumerate(scenes):
        height, width = scene.frame.proximity_depth.shape
        progress(done / len(scenes), f"{scene.name}, {width} x {height}")
        runners: dict[str, Runner] = {name: find_engine(name).make(scene) for name in names}
        truth = scene.truth
        points = int(truth.contact.sum()) if truth is not None else 0
        rows.append(GrowthRow(points, width, height, time_in_turns(runners, rounds)))
    return rows


def growth_as_text(rows: list[GrowthRow]) -> str:
    """Return a table with a line per size and a column per engine, milliseconds."""
    names = list(rows[0].timings) if rows else []
    lines = [f"{'points':>9} {'image':>11}" + "".join(f"{name:>24}" for name in names)]
    for row in rows:
        cells = "".join(f"{row.timings[name].median_ms:>21.3f} ms" for name in names)
        lines.append(f"{row.points:>9,} {row.width:>5} x {row.height:<4}" + cells)
    return "\n".join(lines)


@dataclass(frozen=True)
class StageRow:
    """Median time of each pipeline stage on one scene, milliseconds."""

    scene: str
    points: int
    stage_ms: dict[str, float]


def stage_breakdown(scenes: Sequence[str], frames: int = 60) -> list[StageRow]:
    """Process each scene's frame many times without cached results, and take the median of each stage."""
    rows = []
    for name in scenes:
        scene = make_scene(name)
        pipeline = ContactPipeline(scene.preset, scene.rig)
        patches = [pipeline.process(replace(scene.frame, sequence=number)) for number in range(frames)]
        stages = patches[-1].stage_ms
        medians = {stage: float(np.median([patch.stage_ms[stage] for patch in patches])) for stage in stages}
        rows.append(StageRow(name, len(patches[-1].points), medians))
    return rows


def thread_scaling(scenes: Sequence[str], rounds: int) -> dict[str, dict[int, Timing]]:
    """Measure each scene with one thread and with all available threads, in turns."""
    counts = sorted({1, available_threads()})
    usual = get_threads()
    scaling = {}
    for name in scenes:
        run = find_engine("tactune").make(make_scene(name))
        timings = time_in_turns({str(count): partial(_with_threads, run, count) for count in counts}, rounds)
        scaling[name] = {count: timings[str(count)] for count in counts}
    set_threads(usual)
    return scaling


def _with_threads(run: Runner, count: int) -> Outcome:
    set_threads(count)
    return run()
