"""The speed that must hold, as ratios of medians measured side by side in one run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from .cold_start import OURS, THEIRS, import_seconds
from .engines.reference import candidate_points
from .measure import bandwidth_bytes_per_s, time_in_turns
from .registry import Job, engines, find_engine
from .roofline import roofline
from .run import compare_engines, expected_mask, reference_mask
from .scenes import BenchScene, make_scene, synthetic_scene

Progress = Callable[[float, str], None]

_WHOLE = ("cup-medium", "octopus-high", "noisy-51k")
_FEW_DISAGREEING = 1e-3
_IMPORT_SHARE = round(1 / 3, 2)


@dataclass(frozen=True)
class Check:
    """One line of the gate: a measured number and what it must reach."""

    words: str
    measured: float
    wanted: float
    at_least: bool = True

    @property
    def holds(self) -> bool:
        """Whether it does."""
        return self.measured >= self.wanted if self.at_least else self.measured <= self.wanted

    def __str__(self) -> str:
        sign = ">=" if self.at_least else "<="
        return (
            f"{'ok   ' if self.holds else 'SHORT'} {self.words}: {self.measured:.2f} (must be {sign} {self.wanted:g})"
        )


def run_gate(rounds: int = 15, progress: Progress = lambda share, words: None) -> list[Check]:
    """Measure everything that the gate asks for.

    Parameters
    ----------
    rounds : int
        Turns of each engine.

    Returns
    -------
    list of Check
    """
    checks: list[Check] = []
    steps = (_whole_pipeline, _outlier_removal, _fast_variant, _empty_scene, _bandwidth, _cold_start)
    for done, step in enumerate(steps):
        progress(done / len(steps), step.__name__.strip("_").replace("_", " "))
        checks += step(rounds)
    progress(1.0, "done")
    return checks


def _whole_pipeline(rounds: int) -> list[Check]:
    checks = []
    for row in compare_engines(_WHOLE, [Job.PIPELINE], rounds=rounds, only=["tactune"]):
        if row.engine == "tactune":
            checks.append(Check(f"whole pipeline on {row.scene}, times the baseline's speed", row.ratio, 6))
            checks.append(Check(f"pixels unlike the float64 reference on {row.scene}", row.differing_px or 0, 0, False))
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


def _fast_variant(rounds: int) -> list[Check]:
    """The fastest of our engines, the exact one included, that disagrees on few enough points on every scene."""
    fast = [found.name for found in engines(Job.PIPELINE) if found.name.startswith("tactune")]
    rows = compare_engines(_WHOLE, [Job.PIPELINE], rounds=rounds, only=fast)
    best = 0.0
    words = "no variant disagrees on under 0.1 % of the points"
    for name in fast:
        mine = [row for row in rows if row.engine == name]
        counts = [int(expected_mask(make_scene(row.scene), Job.PIPELINE).sum()) for row in mine]
        if all((row.differing_px or 0) < _FEW_DISAGREEING * count for row, count in zip(mine, counts, strict=True)):
            slowest = min(row.ratio for row in mine)
            if slowest > best:
                best, words = slowest, f"fastest under 0.1 % disagreement ({name}), least ratio of the three scenes"
    return [Check(words, best, 10)]


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
        limit = roofline(scene, len(candidate_points(scene)[0]), contacts, bandwidth)
        words = (
            f"without outlier removal on {name}, time over the limit ({limit.must_bytes / 1e6:.2f} MB at "
            f"{bandwidth / 1e9:.1f} GB/s: {limit.limit_ms:.3f} ms)"
        )
        checks.append(Check(words, timing.median_ms / limit.limit_ms, 4, False))
    return checks


def _cold_start(rounds: int) -> list[Check]:
    ours, theirs = import_seconds((OURS, THEIRS), max(3, rounds // 3))
    words = f"import of the pipeline ({ours:.2f} s), time over import open3d ({theirs:.2f} s)"
    return [Check(words, ours / theirs, _IMPORT_SHARE, False)]


def _ratio(scene: BenchScene, baseline: str, mine: str, rounds: int) -> tuple[float, int]:
    runners = {name: find_engine(name).make(scene) for name in (baseline, mine)}
    timings = time_in_turns(runners, rounds)
    theirs, ours = (runners[name]().mask for name in (baseline, mine))
    assert theirs is not None
    assert ours is not None
    return timings[baseline].median_ms / timings[mine].median_ms, int((theirs != ours).sum())
