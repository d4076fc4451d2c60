"""Where a frame's time goes, and what a second thread brings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..contact.kernels.threads import available_threads, get_threads, set_threads
from ..contact.pipeline import STAGES, ContactPipeline
from .measure import Timing, time_in_turns
from .registry import Outcome, Runner, find_engine
from .scenes import make_scene


@dataclass(frozen=True)
class StageRow:
    """Medians of one scene's stages, milliseconds, in the pipeline's order."""

    scene: str
    points: int
    stage_ms: dict[str, float]


def stage_breakdown(scenes: Sequence[str], frames: int = 60) -> list[StageRow]:
    """Process each scene's frame again and again, never remembered, and take each stage's median."""
    rows = []
    for name in scenes:
        scene = make_scene(name)
        pipeline = ContactPipeline(scene.preset, scene.rig)
        patches = [pipeline.process(replace(scene.frame, sequence=number)) for number in range(frames)]
        medians = {stage: float(np.median([patch.stage_ms[stage] for patch in patches])) for stage in STAGES}
        rows.append(StageRow(name, len(patches[-1].points), medians))
    return rows


def thread_scaling(scenes: Sequence[str], rounds: int) -> dict[str, dict[int, Timing]]:
    """Measure each scene with one thread and with all that this process may use, in turns."""
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
