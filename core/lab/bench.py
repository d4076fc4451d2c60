"""Run time against error: three engines do the same job on the same frames, in turns, in one run.

An engine is a function from a scene to the function that is timed; everything that can be prepared is prepared. That
returns the points of the contact patch, and a function for its flat pixels, which is called when the clock has stopped,
because most consumers need the points only. The gate checks the promised speed.
"""

from __future__ import annotations

import math
import os
import platform
import random
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from importlib.metadata import PackageNotFoundError, version
from itertools import cycle
from pathlib import Path
from typing import Any, Final

import numpy as np

from ..contact.alignment import tactile_pose
from ..contact.masking import in_hsv_range
from ..contact.outliers.grid import Grid
from ..contact.outliers.statistical import statistical_inliers
from ..contact.pipeline import ContactPipeline
from ..errors import MissingExtraError
from ..model.arrays import AnyArray, BoolArray, Float64Array, IndexArray, Uint16Array
from ..model.clouds import nearest_pixels, truth_points
from ..model.frames import DepthCamera, GroundTruth, Rig, SensorFrame
from ..model.intrinsics import Intrinsics
from ..model.metrics import pixel_scores, symmetric_rmse_m
from ..preset import Preset
from ..sources.base import Progress
from ..sources.presets import load_preset
from .reference import Reference, open3d_inliers
from .table import aligned

Found = tuple[AnyArray, Callable[[], IndexArray]]
Run = Callable[[], Found]
#: Length of a turn, seconds: a fast engine runs many times in it, a slow one once.
_TURN_S: Final = 0.02
_MAX_CALLS_PER_TURN: Final = 25
_CPU_FACTS: Final = Path("/proc/cpuinfo")


# The frames that engines are measured on: simulated presses, and synthetic contacts of a given size

#: Depths of the simulated presses, metres past first touch.
_LIGHT_M, _MEDIUM_M = 0.003, 0.024

#: Engines are variants of this contact test.
_TEST: Final = {"contact_test": "tolerance"}
_CONTACT_RGB = (172, 168, 160)
_MEMBRANE_RGB = (36, 96, 190)


@dataclass(frozen=True, eq=False)
class BenchScene:
    """One frame with its rig and the preset it is processed with."""

    rig: Rig
    preset: Preset
    frame: SensorFrame


@lru_cache(maxsize=16)
def make_scene(name: str) -> BenchScene:
    return SCENES[name]()


def _simulated(scene: str, depth_m: float) -> BenchScene:
    """Return the first frame of a simulated press that is at least ``depth_m`` deep, or the deepest."""
    from ..sources.simulator.simulator_source import SimulatorSource

    source = SimulatorSource(scene=scene, sensor="datasheet")
    depths = np.array([source.facts(index).depth_m for index in range(source.length)])
    index = int(np.argmax(depths >= min(depth_m, depths.max())))
    return BenchScene(source.rig, load_preset("simulator").with_values(_TEST), source.read(index))


def synthetic_scene(points: int, noise_m: float = 0.001) -> BenchScene:
    """Return a paraboloid with about ``points`` px of contact, 25 mm in front of what else is seen."""
    from ..sources.simulator.scene import simulator_rig

    rig = simulator_rig().model_copy(update={"proximity_color": None})
    random = np.random.default_rng(0)
    camera = rig.proximity.intrinsics
    membrane = _depth_of_paraboloid(camera, np.eye(4))
    v, u = np.indices(camera.shape)
    contact = np.hypot(u - camera.cx, v - camera.cy) <= np.sqrt(points / np.pi)
    if points >= contact.size:
        contact[:] = True
    seen = np.where(contact, membrane, membrane + 0.025) + random.normal(0, noise_m, membrane.shape)
    tactile = _depth_of_paraboloid(rig.tactile.intrinsics, np.asarray(rig.T_proximity_tactile))
    tactile = tactile + random.normal(0, noise_m / 3, tactile.shape)
    color = np.where(contact[..., None], _CONTACT_RGB, _MEMBRANE_RGB).astype(np.uint8)
    frame = SensorFrame(
        sequence=0,
        proximity_depth=_counts(seen, rig.proximity.depth_unit_m),
        tactile_depth=_counts(tactile, rig.tactile.depth_unit_m),
        proximity_color=color,
        truth=GroundTruth(contact=contact, depth_m=membrane.astype(np.float32)),
    )
    values = {"rig": None, "tolerance.t": 0.03, "mask.enabled": True, "mask.hue": (100, 125)}
    preset = load_preset("simulator").with_values({**_TEST, **values, "mask.saturation": (120, 255)})
    return BenchScene(rig, preset, frame)


def _depth_of_paraboloid(camera: Intrinsics, T_p_camera: Float64Array) -> Float64Array:
    """Return the depth at which each pixel of a camera sees z = 0.25 + 0.6 (x^2 + y^2), metres."""
    rays = np.concatenate([camera.rays().astype(np.float64), np.ones((*camera.shape, 1))], axis=2)
    directions, start = rays @ T_p_camera[:3, :3].T, T_p_camera[:3, 3]
    depth = np.full(camera.shape, 0.25)
    for _ in range(8):
        points = start + directions * depth[..., None]
        miss = 0.25 + 0.6 * (points[..., 0] ** 2 + points[..., 1] ** 2) - points[..., 2]
        slope = directions[..., 2] - 1.2 * (points[..., 0] * directions[..., 0] + points[..., 1] * directions[..., 1])
        depth = depth + np.where(slope > 0.2, miss / slope, 0.0)
    return depth


def _counts(depth_m: Float64Array, unit_m: float) -> Uint16Array:
    return np.clip(np.rint(depth_m / unit_m), 1, 65534).astype(np.uint16)


#: All scenes, from no contact to full contact.
SCENES: Final[dict[str, Callable[[], BenchScene]]] = {
    "empty": lambda: synthetic_scene(0),  # nothing within 25 mm of the membrane
    "untouched": lambda: _simulated("cup", -math.inf),  # before the first touch, with reflecting prints
    "light-touch": lambda: _simulated("cup", _LIGHT_M),
    "cup-medium": lambda: _simulated("cup", _MEDIUM_M),
    "octopus-high": lambda: _simulated("octopus", math.inf),
    "noisy-51k": lambda: synthetic_scene(51_000, noise_m=0.002),
    "full-contact": lambda: synthetic_scene(640 * 480),
}


# Engines


def numpy_engine(scene: BenchScene) -> Run:
    """The baseline: the paper's pipeline with NumPy in float64, OpenCV, and Open3D's outlier removal."""
    reference = Reference(scene.preset, scene.rig, np.float64, open3d_inliers)

    def run() -> Found:
        points, pixels = reference.find(scene.frame)
        return points, lambda: pixels

    return run


def open3d_engine(scene: BenchScene) -> Run:
    """Open3D's own point-cloud calls: without a pixel grid, tolerance is a distance to the nearest tactile point."""
    import open3d as o3d

    preset, rig, frame = scene.preset, scene.rig, scene.frame
    T_p_t = tactile_pose(preset.alignment, rig)
    lens, color = rig.proximity.intrinsics, rig.proximity_color

    def cloud(counts: np.ndarray, camera: DepthCamera, factor: float) -> Any:
        lens = camera.intrinsics
        image = o3d.geometry.Image(np.where(counts == 65535, 0, counts).astype(np.uint16))
        pinhole = o3d.camera.PinholeCameraIntrinsic(lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy)
        return o3d.geometry.PointCloud.create_from_depth_image(
            image, pinhole, depth_scale=1.0 / factor, depth_trunc=100.0
        )

    def bare(points: AnyArray) -> BoolArray:
        colored = in_hsv_range(frame.proximity_color, preset.mask)
        T = np.eye(4) if color is None else np.asarray(color.T_color_depth)
        row, column, inside = nearest_pixels(
            points @ T[:3, :3].T + T[:3, 3], lens if color is None else color.intrinsics
        )
        return np.asarray(inside & colored[row, column])

    def run() -> Found:
        proximity = cloud(frame.proximity_depth, rig.proximity, rig.proximity.depth_unit_m)
        factor = rig.tactile.depth_unit_m * preset.alignment.depth_scale
        tactile = cloud(frame.tactile_depth, rig.tactile, factor).transform(T_p_t)
        distances = np.asarray(proximity.compute_point_cloud_distance(tactile))
        points = np.asarray(proximity.points)
        points = points[distances <= preset.tolerance.t * points[:, 2]]
        if preset.mask.enabled and len(points):
            points = points[~bare(points)]
        if preset.outliers.enabled and len(points):
            points = points[open3d_inliers(points, preset.outliers.k, preset.outliers.ratio)]
        row, column, _ = nearest_pixels(points, lens)
        return points, lambda: row * lens.width + column

    return run


def tactune_engine(scene: BenchScene) -> Run:
    """Tactune's pipeline, called as a robot program calls it."""
    pipeline = ContactPipeline(scene.preset, scene.rig)
    # two frame objects alternate, because the pipeline caches the results of the last frame
    frames = cycle((scene.frame, replace(scene.frame)))

    def run() -> Found:
        patch = pipeline.process(next(frames))
        return patch.points, lambda: np.flatnonzero(patch.mask)

    return run


#: The first is the baseline.
ENGINES: Final[dict[str, Callable[[BenchScene], Run]]] = {
    "numpy": numpy_engine,
    "open3d": open3d_engine,
    "tactune": tactune_engine,
}


# Measuring side by side


@dataclass(frozen=True)
class Timing:
    """Median and quartiles of one engine's run times in one run, milliseconds."""

    median_ms: float
    lower_ms: float
    upper_ms: float


def time_in_turns(
    runners: Mapping[str, Callable[[], Any]], rounds: int, progress: Callable[[float], None] = lambda share: None
) -> dict[str, Timing]:
    """Run all in turns, in a random order each round, so that a disturbance affects all alike."""
    for run in runners.values():
        run()
    taken: dict[str, list[float]] = {name: [] for name in runners}
    order = list(runners)
    shuffle = random.Random(0)  # noqa: S311  # an order, no secret
    for done in range(rounds):
        shuffle.shuffle(order)
        for name in order:
            turn: list[float] = []
            while len(turn) < _MAX_CALLS_PER_TURN and sum(turn) < _TURN_S:
                start = time.perf_counter()
                runners[name]()
                turn.append(time.perf_counter() - start)
            taken[name] += turn
        progress((done + 1) / rounds)
    quartiles = {name: np.percentile(np.array(seconds) * 1e3, (50, 25, 75)) for name, seconds in taken.items()}
    return {name: Timing(*map(float, numbers)) for name, numbers in quartiles.items()}


@dataclass(frozen=True)
class Row:
    """One engine on one scene."""

    scene: str
    engine: str
    timing: Timing
    ratio: float  # the baseline's median over this engine's, both from this run
    points: int
    differing_px: int  # from the float64 reference
    iou: float  # with the ground truth of the scene; nan without one
    rmse_mm: float


def compare_engines(
    scenes: Sequence[str], engines: Sequence[str], rounds: int, progress: Progress = lambda share, words: None
) -> list[Row]:
    """Measure engines, by name, on scenes, by name; the baseline is always one of them."""
    names = [name for name in ENGINES if name in engines or name == "numpy"]
    rows: list[Row] = []
    for done, title in enumerate(scenes):
        scene = make_scene(title)

        def tell(share: float, title: str = title, done: int = done) -> None:
            progress((done + share) / len(scenes), title)

        tell(0.0)
        runners = {name: ENGINES[name](scene) for name in names}
        found = {name: run() for name, run in runners.items()}
        timings = time_in_turns(runners, rounds, tell)
        expected = _mask(scene, Reference(scene.preset, scene.rig).find(scene.frame)[1])
        for name, (points, pixels) in found.items():
            mask, truth, iou, rmse_mm = _mask(scene, pixels()), scene.frame.truth, math.nan, math.nan
            if truth is not None:
                iou = pixel_scores(mask, truth.contact).iou
                rmse_mm = 1e3 * symmetric_rmse_m(points, truth_points(truth, scene.rig))
            ratio = timings["numpy"].median_ms / timings[name].median_ms
            differing = int(np.count_nonzero(mask != expected))
            rows.append(Row(title, name, timings[name], ratio, len(points), differing, iou, rmse_mm))
    progress(1.0, "done")
    return rows


def _mask(scene: BenchScene, pixels: IndexArray) -> BoolArray:
    mask = np.zeros(scene.frame.proximity_depth.shape, bool)
    mask.reshape(-1)[pixels] = True
    return mask


def rows_text(rows: Sequence[Row]) -> str:
    lines = [("scene", "engine", "ms", "quartiles", "ratio", "points", "differ", "IoU", "RMSE mm")]
    for row in rows:
        ms, quartiles = f"{row.timing.median_ms:.3f}", f"{row.timing.lower_ms:.2f}-{row.timing.upper_ms:.2f}"
        iou, rmse = ("-" if math.isnan(number) else f"{number:.3f}" for number in (row.iou, row.rmse_mm))
        ratio = f"{row.ratio:.1f}x"
        lines.append((row.scene, row.engine, ms, quartiles, ratio, str(row.points), str(row.differing_px), iou, rmse))
    return aligned(lines)


# The gate


@dataclass(frozen=True)
class Check:
    """One line of the gate: a measured number and its limit."""

    words: str
    measured: float
    wanted: float
    at_least: bool = True

    @property
    def holds(self) -> bool:
        return self.measured >= self.wanted if self.at_least else self.measured <= self.wanted

    def __str__(self) -> str:
        must = f"must be {'>=' if self.at_least else '<='} {self.wanted:g}"
        return f"{'ok   ' if self.holds else 'SHORT'} {self.words}: {self.measured:.2f} ({must})"


def run_gate(rounds: int = 15, progress: Progress = lambda share, words: None) -> list[Check]:
    """Measure everything that the gate requires; each engine has ``rounds`` turns."""
    checks: list[Check] = []
    steps = (whole_pipeline, _outlier_removal, _empty_scene, _bandwidth)
    for done, step in enumerate(steps):
        progress(done / len(steps), step.__name__.strip("_").replace("_", " "))
        checks += step(rounds)
    progress(1.0, "done")
    return checks


_WHOLE: Final = ("cup-medium", "octopus-high", "noisy-51k")


def whole_pipeline(rounds: int, scenes: Sequence[str] = _WHOLE) -> list[Check]:
    """Compare speed and result of the whole pipeline with the baseline's on these scenes."""
    checks = []
    for row in compare_engines(scenes, ["tactune"], rounds):
        if row.engine == "tactune":
            checks.append(Check(f"whole pipeline on {row.scene}, times the baseline's speed", row.ratio, 10))
            checks.append(Check(f"pixels unlike the float64 reference on {row.scene}", row.differing_px, 0, False))
    return checks


def _outlier_removal(rounds: int) -> list[Check]:
    checks = []
    for count in (50_000, 300_000):
        scene = synthetic_scene(count, noise_m=0.001)
        # float64 coordinates that float32 can represent, so that both get the same points
        found, pixels = _candidates(scene)
        points = found.astype(np.float32)
        lens, ratio = scene.rig.proximity.intrinsics, scene.preset.outliers.ratio
        for k, wanted in ((20, 6.0), (50, 4.0)):
            runners: dict[str, Callable[[], Any]] = {
                "open3d": partial(open3d_inliers, points.astype(np.float64), k, ratio),
                "tactune": partial(statistical_inliers, points, pixels, Grid(lens), k, ratio),
            }
            timings = time_in_turns(runners, rounds)
            words = f"outlier removal, {count:,} points, k = {k}"
            times = timings["open3d"].median_ms / timings["tactune"].median_ms
            differing = int(np.count_nonzero(runners["tactune"]() != runners["open3d"]()))
            checks.append(Check(f"{words}, times Open3D's speed", times, wanted))
            checks.append(Check(f"{words}, points unlike Open3D's inliers", differing, 0, False))
    return checks


def _candidates(scene: BenchScene) -> tuple[AnyArray, IndexArray]:
    """Return the points and pixels that outlier removal starts from."""
    return Reference(_without_outliers(scene).preset, scene.rig).find(scene.frame)


def _without_outliers(scene: BenchScene) -> BenchScene:
    values = {"outliers.enabled": False, "outliers.min_cluster_area_mm2": 0.0}
    return replace(scene, preset=scene.preset.with_values(values))


def _empty_scene(rounds: int) -> list[Check]:
    scene = make_scene("empty")
    images = scene.frame.proximity_depth, scene.frame.tactile_depth
    targets = [np.empty_like(image) for image in images]

    def copy_depths() -> None:
        for target, image in zip(targets, images, strict=True):
            np.copyto(target, image)

    runners = {"numpy": numpy_engine(scene), "tactune": tactune_engine(scene), "copy": copy_depths}
    ms = {name: timing.median_ms for name, timing in time_in_turns(runners, 2 * rounds).items()}
    return [
        Check("empty scene, times the baseline's speed", ms["numpy"] / ms["tactune"], 6),
        Check("empty scene, time over copying both depth images", ms["tactune"] / ms["copy"], 3, False),
    ]


def _bandwidth(rounds: int) -> list[Check]:
    bandwidth = bandwidth_bytes_per_s()
    checks = []
    for name in _WHOLE:
        scene = _without_outliers(make_scene(name))
        timing = time_in_turns({"mine": tactune_engine(scene)}, rounds)["mine"]
        frame, contacts = scene.frame, len(_candidates(scene)[0])
        # each input and each result once, without tables
        must_bytes = frame.proximity_depth.nbytes + frame.tactile_depth.nbytes + frame.proximity_depth.size
        must_bytes += contacts * (12 + 3 * scene.preset.mask.enabled)
        limit_ms = 1e3 * must_bytes / bandwidth
        words = (
            f"without outlier removal on {name}, time over the limit ({must_bytes / 1e6:.2f} MB at "
            f"{bandwidth / 1e9:.1f} GB/s: {limit_ms:.3f} ms)"
        )
        checks.append(Check(words, timing.median_ms / limit_ms, 4, False))
    return checks


def bandwidth_bytes_per_s() -> float:
    """Measure memory bandwidth by copying arrays far larger than any cache; counts bytes read plus bytes written."""
    workers = os.cpu_count() or 1
    parts = [np.ones((256 << 20) // workers // 8) for _ in range(workers)]
    targets = [np.zeros_like(part) for part in parts]
    best_s = np.inf
    with ThreadPoolExecutor(workers) as pool:
        for _ in range(7):
            start = time.perf_counter()
            list(pool.map(np.copyto, targets, parts))
            best_s = min(best_s, time.perf_counter() - start)
    return 2 * sum(part.nbytes for part in parts) / best_s


def machine_words() -> str:
    """Return processor, cores and the versions of the compared packages; `MissingExtraError` without Open3D."""
    packages: dict[str, str] = {}
    for name in ("numpy", "numba", "scipy", "opencv-contrib-python-headless", "open3d"):
        with suppress(PackageNotFoundError):
            packages[name] = version(name)
    if "open3d" not in packages:
        raise MissingExtraError("the benchmark needs open3d: install it with pip install 'tactune[lab]'")
    lines = _CPU_FACTS.read_text().splitlines() if _CPU_FACTS.exists() else []
    named = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "")
    processor = named or platform.processor() or platform.machine()
    return ", ".join([processor, f"{os.cpu_count() or 1} cores", *(f"{name} {it}" for name, it in packages.items())])
