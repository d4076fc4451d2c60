"""Compare the noise of a simulated sensor with that of real cameras, by one statistic.

    .venv/bin/python scripts/measure_noise_statistics.py [--data ../shared/data] [--sensor l515-d405] [--frames 4]

The statistic: over the smoothest region of a frame, the residual of a quadratic surface in inverse depth. Its standard
deviation is brought to 0.3 m and normal incidence by the laws of the noise model, or to pixels of disparity; its
autocorrelation is taken along rows and columns. Real regions also hold shape that is not quadratic, so the real
figures are upper bounds. The L515 is measured on the frame of ``real_pair``; for the D405, whose frames are not there,
the figures of ``real_noise.json`` are used: those behind a membrane decide, those of a desk are shown beside. The
simulated L515 looks through the untouched membrane at the wall, and the simulated D405 at the membrane.

Exits with 1 unless amplitudes agree within a factor of 1.5, and correlations within a third or 0.1.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import statistics
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tactune.core.model.arrays import Float64Array
from tactune.core.model.intrinsics import Intrinsics
from tactune.core.sources.simulator.scenes import Variant
from tactune.core.sources.simulator.sensors import SENSORS, SensorModel
from tactune.core.sources.simulator.source import SimulatorSource

DATA = Path(os.environ.get("TACTUNE_TEST_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
#: Lags of the autocorrelation in pixels of an image 640 pixels wide; the last one is only shown.
LAGS = (1, 2, 4, 8, 16)
#: Regions in pixels of an image 640 pixels wide: of the L515's frame and of the D405's.
L515_REGION, D405_REGION = (130, 100), (160, 120)
NAMED_AT_M = 0.3
RANGE_FACTOR, CORRELATION_SHARE, CORRELATION_ROOM = 1.5, 1 / 3, 0.1


@dataclass(frozen=True)
class Noise:
    """Amplitude, in millimetres at 0.3 m or in pixels of disparity, and autocorrelation at `LAGS`."""

    what: str
    amplitude: float
    correlation: Sequence[float]


def residual_m(depth_m: Float64Array) -> Float64Array:
    """Return the depth less a quadratic surface in inverse depth; NaN where there is no depth, or an outlier."""
    v, u = np.indices(depth_m.shape) / max(depth_m.shape) - 0.5
    terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1).reshape(-1, 6)
    depth, used = depth_m.ravel(), depth_m.ravel() > 0.0
    for _ in range(3):
        fit = np.linalg.lstsq(terms[used], 1.0 / depth[used], rcond=None)[0]
        residual = np.where(depth > 0.0, depth - 1.0 / (terms @ fit), np.nan)
        used = np.abs(residual) < 4.0 * np.nanstd(residual[used]) + 1e-9
    return np.where(used, residual, np.nan).reshape(depth_m.shape)


def smoothest(depth_m: Float64Array, size: tuple[int, int], stride: int) -> tuple[slice, slice]:
    """Return the region of that width and height with the smallest residual and depth nearly everywhere."""
    width, height = size
    best, found = math.inf, None
    for top in range(0, depth_m.shape[0] - height + 1, stride):
        for left in range(0, depth_m.shape[1] - width + 1, stride):
            region = slice(top, top + height), slice(left, left + width)
            if (depth_m[region] > 0.0).mean() > 0.97:
                spread = float(np.nanstd(residual_m(depth_m[region][::3, ::3])))
                best, found = min((best, found), (spread, region), key=lambda pair: pair[0])
    if found is None:
        sys.exit(f"no region of {width} x {height} pixels has depth in 97 % of its pixels")
    return found


def autocorrelation(residual: Float64Array, lags: Iterable[int]) -> list[float]:
    """Return the mean of the autocorrelations along rows and along columns."""
    centred = residual - np.nanmean(residual)
    variance = float(np.nanmean(centred**2))

    def product(lag: int) -> float:
        along = np.nanmean(centred[:, lag:] * centred[:, :-lag]), np.nanmean(centred[lag:] * centred[:-lag])
        return float(np.mean(along)) / variance

    return [product(lag) for lag in lags]


def growth(depth_m: Float64Array, region: tuple[slice, slice], lens: Intrinsics, sensor: SensorModel) -> float:
    """Return how many times larger the model's time-of-flight noise is in a region than at 0.3 m, facing it."""
    v, u = np.indices(depth_m.shape)
    points = np.stack([(u - lens.cx) / lens.fx * depth_m, (v - lens.cy) / lens.fy * depth_m, depth_m], axis=-1)[region]
    points = points[points[:, :, 2] > 0.0]
    centre = points.mean(axis=0)
    normal = np.linalg.svd(points - centre, full_matrices=False)[2][2]
    cosine = abs(normal @ centre) / float(np.linalg.norm(centre))
    turned, far = sensor.tof_incidence_share, sensor.tof_distance_share
    return float((1.0 - turned + turned / cosine) * (1.0 - far + far * centre[2] / NAMED_AT_M))


def real_l515(folder: Path, sensor: SensorModel) -> Noise:
    """Measure the one frame of the real L515."""
    rig = json.loads((folder / "real_pair" / "rig.json").read_text(encoding="utf-8"))["proximity"]
    counts = cv2.imread(str(folder / "real_pair" / "proximity_depth.png"), cv2.IMREAD_UNCHANGED)
    if counts is None:
        sys.exit(f"{folder / 'real_pair'} has no readable proximity_depth.png")
    depth = counts.astype(np.float64) * rig["depth_unit_m"]
    lens = Intrinsics(**{key: rig[key] for key in ("width", "height", "fx", "fy", "cx", "cy")})
    scale = lens.width // 640
    region = smoothest(depth, (L515_REGION[0] * scale, L515_REGION[1] * scale), 20)
    residual = residual_m(depth[region])
    spread_mm, times = 1e3 * float(np.nanstd(residual)), growth(depth, region, lens, sensor)
    where = f"real L515, {spread_mm:.2f} mm at {np.median(depth[region]):.2f} m"
    return Noise(where, spread_mm / times, autocorrelation(residual, [lag * scale for lag in LAGS]))


def real_d405(folder: Path, words: str) -> Noise:
    """Return the medians of the real D405's figures over the frames whose description contains the words."""
    frames: list[dict[str, Any]] = json.loads((folder / "real_noise.json").read_text(encoding="utf-8"))["frames"]
    chosen = [f for f in frames if "D405" in f["camera"] and words in f["camera"] and f["width_px"] == 640]
    correlations = zip(*(f["autocorrelation_at_1_2_4_8_16_32_px"][: len(LAGS)] for f in chosen), strict=True)
    amplitude = statistics.median(f["disparity_std_px"] for f in chosen)
    return Noise(f"real D405, {words}, {len(chosen)} frames", amplitude, [statistics.median(c) for c in correlations])


def simulated(sensor: SensorModel, frames: int) -> tuple[Noise, Noise]:
    """Measure both simulated cameras on the untouched membrane, one seed a frame."""
    tof: list[tuple[float, list[float]]] = []
    stereo: list[tuple[float, list[float]]] = []
    for seed in range(frames):
        with SimulatorSource("cup", seed, variant=Variant(press="none"), sensor=sensor.name) as source:
            frame, rig = source.read(0), source.rig
        depth = np.asarray(frame.proximity_depth * rig.proximity.depth_unit_m, dtype=np.float64)
        region = smoothest(depth, L515_REGION, 20)
        residual = residual_m(depth[region])
        times = growth(depth, region, rig.proximity.intrinsics, sensor)
        tof.append((1e3 * float(np.nanstd(residual)) / times, autocorrelation(residual, LAGS)))

        counts = np.where(frame.tactile_depth == 65535, 0, frame.tactile_depth)
        depth = np.asarray(counts * rig.tactile.depth_unit_m, dtype=np.float64)
        region = smoothest(depth, D405_REGION, 20)
        residual, middle_m = residual_m(depth[region]), float(np.median(depth[region]))
        pixels = rig.tactile.intrinsics.fx * sensor.stereo_baseline_m / middle_m**2
        stereo.append((float(np.nanstd(residual)) * pixels, autocorrelation(residual, LAGS)))
    return _mean("simulated L515", tof), _mean("simulated D405", stereo)


def _mean(what: str, measured: list[tuple[float, list[float]]]) -> Noise:
    amplitudes, correlations = zip(*measured, strict=True)
    return Noise(f"{what}, {len(measured)} frames", float(np.mean(amplitudes)), np.mean(correlations, axis=0).tolist())


def show(noise: Noise, unit: str) -> None:
    """Print one row."""
    correlation = "  ".join(f"{value:5.2f}" for value in noise.correlation)
    print(f"  {noise.what:44s} {noise.amplitude:6.3f} {unit}   {correlation}")


def agree(real: Noise, made: Noise) -> bool:
    """Whether amplitude and correlations, up to the last lag but one, agree."""
    factor = max(real.amplitude / made.amplitude, made.amplitude / real.amplitude)
    pairs = list(zip(real.correlation, made.correlation, strict=True))[:-1]
    near = [abs(a - b) <= max(CORRELATION_SHARE * abs(a), CORRELATION_ROOM) for a, b in pairs]
    return factor <= RANGE_FACTOR and all(near)


def main() -> int:
    """Print the figures side by side; return 1 where they disagree."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--data", type=Path, default=DATA, help="folder with real_pair and real_noise.json")
    parser.add_argument("--sensor", default="l515-d405", choices=list(SENSORS))
    parser.add_argument("--frames", type=int, default=4)
    options = parser.parse_args()
    if not (options.data / "real_noise.json").exists():
        sys.exit(f"{options.data} has no real_noise.json; give its folder with --data")
    sensor = SENSORS[options.sensor]
    tof, stereo = simulated(sensor, options.frames)
    near = real_l515(options.data, sensor)
    membrane, desk = real_d405(options.data, "behind"), real_d405(options.data, "desk")
    print(f"sensor {sensor.name}; autocorrelation at {', '.join(map(str, LAGS))} px of an image 640 px wide")
    for noise in (near, tof):
        show(noise, "mm at 0.3 m  ")
    for noise in (membrane, desk, stereo):
        show(noise, "px disparity ")
    good = {"L515": agree(near, tof), "D405": agree(membrane, stereo)}
    print("; ".join(f"{camera} {'agrees' if fine else 'DISAGREES'}" for camera, fine in good.items()))
    return 0 if all(good.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
