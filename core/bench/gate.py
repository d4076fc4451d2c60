"""The speed requirements, as ratios of medians measured side by side in one run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ..sources.base import Progress
from .engines.reference import candidate_points
from .measure import OURS, THEIRS, bandwidth_bytes_per_s, import_seconds, time_in_turns
from .registry import Job, find_engine
from .run import compare_engines, reference_mask
from .scenes import BenchScene, make_scene, synthetic_scene

_WHOLE = ("cup-medium", "octopus-high", "noisy-51k")
_IMPORT_SHARE = round(1 / 3, 2)
_POINT_BYTES, _COLOR_BYTES, _VERDICT_BYTES = 12, 3, 1


@dataclass(frozen=True)
class Check:
    """One line of the gate: a measured number and its limit."""

    words: str
    measured: float
    wanted: float
    at_least: bool = True

    @property
    def holds(self) -> bool:
        """Whether the measured number is within the limit."""
        return self.measured >= self.wanted if self.at_least else self.measured <= self.wanted

    def __str__(self) -> str:
        sign = ">=" if self.at_least else "<="
        return (
            f"{'ok   ' if self.holds else 'SHORT'} {self.words}: {self.measured:.2f} (must be {sign} {self.wanted:g})"
        )


def run_gate(rounds: int = 15, progress: Progress = lambda share, words: None) -> list[Check]:
    """Measure everything that the gate requires.

    Parameters
    ----------
    rounds : int
        Turns of each engine.

    Returns
    -------
    list of Check
    """
    checks: list[Check] = []
    steps = (whole_pipeline, _outlier_removal, _empty_scene, _bandwidth, _cold_start)
    for done, step in enumerate(steps):
        progress(done / len(steps), step.__name__.strip("_").replace("_", " "))
        checks += step(rounds)
    progress(1.0, "done")
    return checks


def whole_pipeline(rounds: int, scenes: Sequence[str] = _WHOLE) -> list[Check]:
    """Compare speed and result of the whole pipeline with the baseline's on these scenes."""
    checks = []
    for row in compare_engines(scenes, [Job.PIPELINE], rounds=rounds, only=["tactune"]):
        if row.engine == "tactune":
            checks.append(Check(f"whole pipeline on {row.scene}, times the baseline's speed", row.ratio, 10))
            checks.append(Check(f"pixels unlike the float64 reference on {row.scene}", row.differing_px, 0, False))
    return checks


def _outlier_removal(rounds: int) -> list[Check]:
    checks = []
    for points in (50_000, 300_000):
        for k, wanted in ((20, 6.0), (50, 4.0)):
            scene = synthetic_scene(points, noise_m=0.001)
            scene = replace(scene, name=f"{points} points", preset=scene.preset.with_value("outliers.k", k))
            ratio, differing = _ratio(scene, "reference-outliers", "tactune-outliers", rounds)
            words = f"outlier removal, {points:,} points, k = {k}"
            checks.append(Check(f"{words}, times Open3D's speed", ratio, wanted))
            checks.append(Check(f"{words}, points unlike Open3D's inliers", differing, 0, False))
    return checks


def _empty_scene(rounds: int) -> list[Check]:
    rows = {
        row.engine: row
        for row in compare_engines(["empty"], [Job.PIPELINE], rounds=2 * rounds, only=["tactune", "copy-depths"])
    }
    mine, copy = rows["tactune"], rows["copy-depths"]
    return [
        Check("empty scene, times the baseline's speed", mine.ratio, 6),
        Check("empty scene, time over copying both depth images",
              mine.timing.median_ms / copy.timing.median_ms, 3, False),
    ]  # fmt: skip


def _bandwidth(rounds: int) -> list[Check]:
    bandwidth = bandwidth_bytes_per_s()
    checks = []
    for name in _WHOLE:
        scene = make_scene(name)
        timing = time_in_turns({"mine": find_engine("tactune-per-pixel").make(scene)}, rounds)["mine"]
        contacts = int(reference_mask(scene, outliers=False).sum())
        must_bytes = least_bytes(scene, len(candidate_points(scene)[0]), contacts)
        limit_ms = 1e3 * must_bytes / bandwidth
        words = (
            f"without outlier removal on {name}, time over the limit ({must_bytes / 1e6:.2f} MB at "
            f"{bandwidth / 1e9:.1f} GB/s: {limit_ms:.3f} ms)"
        )
        checks.append(Check(words, timing.median_ms / limit_ms, 4, False))
    return checks


def _cold_start(rounds: int) -> list[Check]:
    ours, theirs = import_seconds((OURS, THEIRS), max(3, rounds // 3))
    words = f"import of the pipeline ({ours:.2f} s), time over import open3d ({theirs:.2f} s)"
    return [Check(words, ours / theirs, _IMPORT_SHARE, False)]


def _ratio(scene: BenchScene, baseline: str, mine: str, rounds: int) -> tuple[float, int]:
    runners = {name: find_engine(name).make(scene) for name in (baseline, mine)}
    timings = time_in_turns(runners, rounds)
    theirs, ours = (runners[name]().mask for name in (baseline, mine))
    return timings[baseline].median_ms / timings[mine].median_ms, int((theirs != ours).sum())


def least_bytes(scene: BenchScene, candidates: int, contacts: int) -> int:
    """Return the least memory traffic of the per-pixel chain, bytes.

    Each input and each result counts once: both depth images, a verdict per pixel, a colour for each of the
    ``candidates`` after the tolerance test, and a point for each of the ``contacts`` in the end. Tables do not count.
    """
    frame = scene.frame
    must = frame.proximity_depth.nbytes + frame.tactile_depth.nbytes + frame.proximity_depth.size * _VERDICT_BYTES
    return must + contacts * _POINT_BYTES + scene.preset.mask.enabled * candidates * _COLOR_BYTES
