"""Random frames of the tolerance test, and how near each pixel's verdict is to a threshold.

A verdict may differ from the float64 reference only if the float64 value lies within `BOUND_ULPS` float32 units in
the last place (ulps) of a threshold: the tolerance, a range limit, or the border between two pixels of the image that
is looked up. Any other difference is a bug.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.lab.reference import Reference, reference_patch
from tactune.core.model.arrays import AnyArray, Float64Array, Uint16Array
from tactune.core.model.frames import ColorCamera, DepthCamera, Matrix4, Rig, SensorFrame, rigid_transform
from tactune.core.model.intrinsics import Distortion, Intrinsics
from tactune.core.preset import Preset

#: A verdict involves about ten roundings after the tables, each of half an ulp of the largest number involved: the
#: depth for the tolerance, the image width for a looked-up pixel.
BOUND_ULPS = 16.0

_SIZE = (96, 72)


def random_case(random: np.random.Generator, *, adversarial: bool) -> tuple[Preset, Rig, SensorFrame]:
    """Return a rig, a preset and a frame. Adversarial: the tolerance equals the relative difference of one pixel."""
    rig = Rig(
        proximity=DepthCamera(intrinsics=_lens(random), depth_unit_m=float(random.choice((0.00025, 0.001, 1e-4)))),
        tactile=DepthCamera(intrinsics=_lens(random), depth_unit_m=float(random.choice((0.0001, 0.001, 5e-5)))),
        proximity_color=_color_camera(random),
        T_proximity_tactile=_pose(random, 0.04),
    )
    width, height = _SIZE
    v, u = np.mgrid[:height, :width]
    surface = 0.25 + 0.05 * np.sin(u * random.uniform(0.02, 0.2)) * np.cos(v * random.uniform(0.02, 0.2))
    behind = surface + np.where(random.random(surface.shape) < 0.5, 0.0, random.uniform(0.0, 0.02, surface.shape))
    noise = float(random.choice((0.0, 0.001, 0.01)))
    frame = SensorFrame(
        sequence=0,
        proximity_depth=_counts(behind + random.normal(0, noise, surface.shape), rig.proximity.depth_unit_m, random),
        tactile_depth=_counts(surface + random.normal(0, noise, surface.shape), rig.tactile.depth_unit_m, random),
        proximity_color=random.integers(0, 256, (height, width, 3), dtype=np.uint8),
    )
    preset = Preset(contact_test="tolerance").with_values(
        {
            "alignment.model": str(random.choice(("rigid", "homography"))),
            "alignment.depth_scale": float(random.uniform(0.95, 1.05)),
            "alignment.depth_offset_m": float(random.uniform(-0.01, 0.01)),
            "tolerance.t": float(10 ** random.uniform(-3, -0.7)),
            "outliers.enabled": False,
            "range.enabled": bool(random.random() < 0.3),
            "range.limits_m": (0.22, 0.29),
            "mask.enabled": bool(random.random() < 0.5),
            "mask.hue": (30, 120),
        }
    )
    if adversarial:
        preset = preset.with_value("tolerance.t", _difference_of_a_pixel(preset, rig, frame, random))
    return preset, rig, frame


def differing_ulps(preset: Preset, rig: Rig, frame: SensorFrame) -> Float64Array:
    """Return the float32 ulps from the nearest threshold of each pixel whose verdict differs from the reference."""
    found = ContactPipeline(preset, rig).process(frame).provenance
    expected = reference_patch(preset, rig, frame, np.float64).provenance
    where = np.flatnonzero(found != expected)
    return np.zeros(0) if len(where) == 0 else ulps_to_thresholds(preset, rig, frame)[where]


def ulps_to_thresholds(preset: Preset, rig: Rig, frame: SensorFrame) -> Float64Array:
    """Return each pixel's distance to the nearest threshold that decides about it, float32 ulps, flat."""
    depth, expected, measured, uv = _depths(preset, rig, frame)
    with np.errstate(all="ignore"):
        margin = np.abs(np.abs(expected - measured) - preset.tolerance.t * np.abs(expected))
        ulps = margin / np.spacing(np.maximum(np.abs(expected), np.abs(measured)).astype(np.float32))
        ulps = np.fmin(ulps, _ulps_to_next_pixel(uv, rig.tactile.intrinsics))
        ulps = np.fmin(ulps, np.abs(expected) / np.spacing(np.float32(1.0)))
    if rig.proximity_color is not None:
        T_c_d = np.asarray(rig.proximity_color.T_color_depth)
        rays = rig.proximity.intrinsics.rays().astype(np.float64).reshape(-1, 2)
        points = np.concatenate([rays * depth[:, None], depth[:, None]], axis=1) @ T_c_d[:3, :3].T + T_c_d[:3, 3]
        with np.errstate(all="ignore"):
            color_uv = rig.proximity_color.intrinsics.project(points)
            ulps = np.fmin(ulps, _ulps_to_next_pixel(color_uv, rig.proximity_color.intrinsics))
    if preset.range.enabled:
        for limit in preset.range.limits_m:
            ulps = np.fmin(ulps, np.abs(depth - limit) / np.spacing(np.float32(limit)))
    return np.where(np.isnan(ulps), np.inf, ulps)


def _ulps_to_next_pixel(uv: Float64Array, camera: Intrinsics) -> Float64Array:
    """Return the distance of pixel coordinates (N, 2) from the border between two pixels, in ulps of the width."""
    border = np.abs(uv - 0.5 - np.rint(uv - 0.5)).min(axis=1)
    return np.asarray(border / np.spacing(np.float32(max(camera.shape))))


def _depths(preset: Preset, rig: Rig, frame: SensorFrame) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray]:
    """Return each pixel's proximity depth, the expected and the measured tactile depth (metres), and tactile pixel."""
    depth = frame.proximity_depth * rig.proximity.depth_unit_m
    expected, u, v, _ = Reference(preset, rig).seen_by_tactile(depth.ravel(), np.arange(depth.size))
    uv = np.stack([u, v], axis=1)
    counts = _look_up(frame.tactile_depth, uv)
    measured = counts * (rig.tactile.depth_unit_m * preset.alignment.depth_scale) + preset.alignment.depth_offset_m
    return depth.ravel(), expected, measured, uv


def _look_up(image: Uint16Array, uv: Float64Array) -> Uint16Array:
    height, width = image.shape
    with np.errstate(invalid="ignore"):
        column, row = (np.nan_to_num(np.floor(uv + 0.5), posinf=0, neginf=0)).astype(np.int64).T
    return np.asarray(image[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)])


def _difference_of_a_pixel(preset: Preset, rig: Rig, frame: SensorFrame, random: np.random.Generator) -> float:
    """Return the relative difference of a random pixel: as a tolerance, it puts that pixel exactly on the threshold."""
    _, expected, measured, _ = _depths(preset, rig, frame)
    with np.errstate(all="ignore"):
        relative = np.abs(expected - measured) / np.abs(expected)
    usable = relative[np.isfinite(relative) & (relative <= 1.0)]
    return float(random.choice(usable)) if len(usable) else preset.tolerance.t


def _color_camera(random: np.random.Generator) -> ColorCamera | None:
    """Return a separate colour camera or None, with equal probability."""
    if random.random() < 0.5:
        return None
    return ColorCamera(intrinsics=_lens(random), T_color_depth=_pose(random, 0.015))


def _lens(random: np.random.Generator) -> Intrinsics:
    """Return a lens of a random model whose distortion is invertible in the whole image."""
    width, height = _SIZE
    while True:
        model = random.choice(list(Distortion))
        coefficients = tuple(float(value) for value in random.normal(0, (0.05, 0.02, 0.001, 0.001, 0.01)))
        lens = Intrinsics(
            width=width, height=height, fx=float(random.uniform(55, 90)), fy=float(random.uniform(55, 90)),
            cx=width / 2 + float(random.normal(0, 2)), cy=height / 2 + float(random.normal(0, 2)),
            distortion=model, coefficients=(0.0,) * 5 if model is Distortion.NONE else coefficients,
        )  # fmt: skip
        with np.errstate(all="ignore"):
            if np.abs(lens.rays()).max() < 3:
                return lens


def _pose(random: np.random.Generator, spread_m: float) -> Matrix4:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(random.normal(0, 0.05, 3)).as_matrix()
    matrix[:3, 3] = random.normal(0, (spread_m, 0.01, 0.01))
    return rigid_transform(matrix)


def _counts(depth_m: Float64Array, unit_m: float, random: np.random.Generator) -> Uint16Array:
    """Return raw counts, 2 % of them replaced by 0, 1, 65534 or 65535."""
    counts = np.clip(np.rint(depth_m / unit_m), 0, 65535).astype(np.uint16)
    odd = random.random(counts.shape) < 0.02
    counts[odd] = random.choice(np.array([0, 1, 65534, 65535], np.uint16), int(odd.sum()))
    return counts
