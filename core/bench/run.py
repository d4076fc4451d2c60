"""The driver: run time and error of every engine on every scene."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from typing import Any, Final

import numpy as np

from ..evaluation.metrics import pixel_scores, symmetric_rmse_m, truth_cloud
from ..evaluation.table_report import aligned, number_text
from ..model.arrays import BoolArray, Float64Array
from ..model.clouds import ray_table
from ..model.files import json_fields
from ..model.provenance import Provenance
from ..sources.base import Progress, part_of
from .engines.reference import candidate_points, mask_of
from .measure import Timing, peak_bytes, time_in_turns
from .reference_pipeline import inliers, reference_patch
from .registry import Engine, Job, Outcome, Runner, engines, find_engine
from .scenes import BenchScene, make_scene


@dataclass(frozen=True)
class Row:
    """One engine on one scene.

    Attributes
    ----------
    ratio : float
        Median of the baseline divided by this engine's median, both from this run; nan without a baseline.
    differing_px : int
        Pixels whose verdict differs from the float64 reference.
    iou, rmse_mm : float
        Compared with the ground truth of the scene; nan without ground truth or with an empty cloud.
    peak_mib : float or None
        Peak rise of the process's memory during one call.
    """

    scene: str
    engine: str
    job: str
    title: str
    exact: bool
    timing: Timing
    ratio: float
    points: int
    differing_px: int
    iou: float
    rmse_mm: float
    peak_mib: float | None


def compare_engines(
    scenes: Sequence[str],
    jobs: Sequence[Job],
    *,
    rounds: int = 15,
    only: Sequence[str] = (),
    progress: Progress = lambda share, words: None,
) -> list[Row]:
    """Measure the engines of some jobs on some scenes.

    Parameters
    ----------
    scenes : sequence of str
        Names as `tactune.core.bench.scenes.scene_names` gives them.
    rounds : int
        Turns of each engine on each scene.
    only : sequence of str
        Names of the engines to measure besides the baseline; all if empty.

    Raises
    ------
    TactuneError
        No such scene or engine.
    """
    for engine in only:
        find_engine(engine)
    tasks = [(scene, job) for scene in scenes for job in jobs]
    rows: list[Row] = []
    for done, (name, job) in enumerate(tasks):
        within = part_of(progress, done, len(tasks))
        within(0.0, f"{name}: {job}")
        chosen = [
            found for found in engines(job) if not found.missing and (not only or found.baseline or found.name in only)
        ]
        if not only or any(found.name in only for found in chosen):
            rows += _compare(make_scene(name), chosen, rounds, within)
    progress(1.0, "done")
    return rows


def _compare(scene: BenchScene, chosen: list[Engine], rounds: int, progress: Progress) -> list[Row]:
    if not chosen or (chosen[0].job == Job.OUTLIERS and reference_mask(scene, outliers=False).sum() == 0):
        return []
    runners: dict[str, Runner] = {found.name: found.make(scene) for found in chosen}
    outcomes = {name: run() for name, run in runners.items()}
    peaks = {name: peak_bytes(run) for name, run in runners.items()}
    words = f"{scene.name}: {chosen[0].job}"
    timings = time_in_turns(runners, rounds, progress=lambda share: progress(share, words))
    baseline = next((timings[found.name] for found in chosen if found.baseline), None)
    return [
        _row(scene, found, timings[found.name], baseline, outcomes[found.name], peaks[found.name]) for found in chosen
    ]


def _row(
    scene: BenchScene, found: Engine, timing: Timing, baseline: Timing | None, outcome: Outcome, peak: int | None
) -> Row:
    mask, truth, iou, rmse_mm = outcome.mask, scene.frame.truth, math.nan, math.nan
    if truth is not None and found.job in {Job.PIPELINE, Job.PER_PIXEL}:
        iou = pixel_scores(mask, truth.contact).iou
        cloud = outcome.points if outcome.points is not None else _points(mask, scene)
        rmse_mm = 1e3 * symmetric_rmse_m(cloud, truth_cloud(truth, scene.rig).points)
    points = int(np.count_nonzero(mask))
    differing = int(np.count_nonzero(mask != expected_mask(scene, found.job)))
    ratio = baseline.median_ms / timing.median_ms if baseline is not None else math.nan
    return Row(
        scene.name, found.name, found.job.value, found.title, found.exact, timing, ratio, points, differing, iou,
        rmse_mm, None if peak is None else peak / 2**20,
    )  # fmt: skip


def expected_mask(scene: BenchScene, job: Job) -> BoolArray:
    """Return the mask of an exact engine for this job, from the float64 reference."""
    if job == Job.OUTLIERS:
        points, pixels = candidate_points(scene)
        section = scene.preset.outliers
        return mask_of(scene, pixels[inliers(points, section.k, section.ratio)])
    return reference_mask(scene, outliers=job == Job.PIPELINE)


_MASKS: dict[tuple[int, bool], tuple[BenchScene, BoolArray]] = {}


def reference_mask(scene: BenchScene, *, outliers: bool = True) -> BoolArray:
    """Return the contact mask of the float64 reference, with or without its last two stages. Results are cached."""
    key = (id(scene), outliers)
    if key not in _MASKS:
        values = {} if outliers else {"outliers.enabled": False, "outliers.min_cluster_area_mm2": 0.0}
        preset = scene.preset.with_values(values)
        found = reference_patch(preset, scene.rig, scene.frame, np.float64)
        _MASKS[key] = scene, found.provenance == Provenance.CONTACT
    return _MASKS[key][1]


def _points(mask: BoolArray, scene: BenchScene) -> Float64Array:
    depth = scene.frame.proximity_depth[mask].astype(np.float64)[:, None] * scene.rig.proximity.depth_unit_m
    return np.concatenate([ray_table(scene.rig.proximity.intrinsics)[mask] * depth, depth], axis=1)


def rows_as_json(rows: list[Row]) -> list[dict[str, Any]]:
    """Return the rows as JSON values; nan becomes None."""
    return [json_fields(asdict(row)) for row in rows]


_HEADING: Final = ("engine", "ms", "quartiles", "ratio", "points", "differ", "IoU", "RMSE mm", "peak MiB")


def rows_as_text(rows: list[Row]) -> str:
    """Return a table as text, one block per scene and job."""
    blocks = groupby(rows, key=lambda row: f"{row.scene}, {row.job}")
    return "\n\n".join(f"{title}\n{aligned([_HEADING, *map(_cells, block)])}" for title, block in blocks)


def _cells(row: Row) -> tuple[str, ...]:
    time = row.timing
    return (
        row.engine,
        f"{time.median_ms:.3f}",
        f"{time.lower_ms:.2f}-{time.upper_ms:.2f}",
        f"{row.ratio:.1f}x" if math.isfinite(row.ratio) else "-",
        str(row.points),
        str(row.differing_px),
        number_text(row.iou, 3),
        number_text(row.rmse_mm, 2),
        "-" if row.peak_mib is None else f"{row.peak_mib:.1f}",
    )
