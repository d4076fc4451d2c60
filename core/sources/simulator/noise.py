"""From clean images to measurements: the errors of depth cameras, as large as a `SensorModel` says.

Random numbers come from banks made once from the seed; where a frame starts to read in them is a hash of seed, frame
and row. So any frame can be made at any time, always with the same bits, and costs a few milliseconds.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
from numpy import int64

from ...model.arrays import Float32Array, Uint8Array, Uint16Array
from ...model.frames import DepthCamera, Rig
from .objects import compiled
from .render import CLEAN_UNIT_M, EDGE_FLAG, REFLECTIVE_FLAG
from .scene import CleanState
from .sensors import SensorModel

#: Where the amplitudes of a `SensorModel` hold, metres, and the image width at which its lengths do, pixels.
_NAMED_AT_M: Final = 0.3
_NAMED_WIDTH_PX: Final = 640
#: Shares of the time-of-flight noise that grow with the distance and with 1 / cosine of incidence.
TOF_DISTANCE_SHARE: Final = 0.5
_TOF_INCIDENCE_SHARE: Final = 0.35
#: Cosine of incidence below which a time-of-flight camera begins to lose pixels; period of its drift, frames.
_GRAZING_COSINE: Final = 0.35
_DRIFT_FRAMES: Final = 151.0
STEREO_BASELINE_M: Final = 0.018
#: Size of the holes of a stereo camera, as the lengths of a `SensorModel`.
_HOLE_PX: Final = 4.8

_BANK: Final = 1 << 20
_FIELD: Final = 1024

#: What a random number is for, a part of its hash. `int64`, because numba compiles a kernel again for each literal.
_TOF_WHITE, _TOF_UNIFORM, _STEREO_MOVING, _STEREO_HOLES = int64(0), int64(1), int64(2), int64(3)
_COLOUR, _TOF_MOVING, _STEREO_WHITE = int64(4), int64(6), int64(7)  # 5 is the second colour camera


class _Random(NamedTuple):
    """Random numbers of one frame: banks, and what says where each image row begins to read in them."""

    seed: int
    frame: int
    gaussian: Float32Array
    uniform: Float32Array


class _SharedNoise(NamedTuple):
    """Noise that neighbouring pixels share, in fields as of `_smooth_field`."""

    fixed_sigma: float
    moving_sigma: float
    fixed: Float32Array  # stays from frame to frame
    moving: Float32Array  # is displaced in each frame


class _TofErrors(NamedTuple):
    """Errors of a time-of-flight camera. The tables are indexed by 255 * cosine of incidence and contain ``level``."""

    level: float  # factor on all errors
    unit_m: float
    scale: float
    prints_reflect: bool
    flying_share: float  # of the pixels at a depth step: they mix both sides
    bias_m: Float32Array  # (H, W)
    white_sigma_m: Float32Array  # table
    shared_sigma_m: Float32Array  # table
    dropout: Float32Array  # table: share of pixels without depth
    shared: _SharedNoise


class _StereoErrors(NamedTuple):
    """Errors of a stereo camera, which are those of its disparity."""

    level: float  # factor on all errors
    unit_m: float
    focal_baseline: float  # disparity * depth, pixels * metres
    subpixel_steps: float  # disparities that the matcher tells apart, per pixel; 0: all
    white_sigma_px: float
    shared: _SharedNoise
    holes: Float32Array  # as of `_smooth_field`
    hole_from: float  # no match where the field exceeds this
    saturated_from: float  # 65535 instead of 0 where it exceeds this


@compiled
def _hash(random: _Random, stream: int64, row: int | int64) -> int:
    """Mix four numbers into 62 random bits (splitmix64's finaliser, after each number)."""
    state = np.uint64(0x9E3779B97F4A7C15)
    for value in (random.seed, random.frame, stream, row):
        state = (state ^ np.uint64(value)) + np.uint64(0x9E3779B97F4A7C15)
        state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        state = state ^ (state >> np.uint64(31))
    return int(state >> np.uint64(2))


@compiled
def _row_start(random: _Random, stream: int64, v: int, length: int) -> int:
    """Return where in a bank the ``length`` random numbers of image row ``v`` begin."""
    return _hash(random, stream, v) % (_BANK - length)


@compiled
def _displacement(field: Float32Array, random: _Random, stream: int64) -> tuple[int, int]:
    """Return by how many rows and columns a frame displaces a field."""
    wrap = field.shape[0] - 1
    return _hash(random, stream, int64(0)) & wrap, _hash(random, stream, int64(1)) & wrap


@compiled
def _shared_rows(noise: _SharedNoise, v: int, moved: tuple[int, int]) -> tuple[Float32Array, Float32Array]:
    """Return the fixed and the moving field along an image row."""
    wrap = noise.moving.shape[0] - 1
    return noise.fixed[v & wrap], noise.moving[(v + moved[0]) & wrap, moved[1] :]


@compiled
def _across_edge(depth: Uint16Array, v: int, u: int, z: float) -> float:
    """Return the depth around a pixel that differs most from its own ``z``, metres: the other side of a step."""
    height, width = depth.shape
    other = z
    for dv in range(-1, 2):
        for du in range(-1, 2):
            j, i = min(max(v + dv, 0), height - 1), min(max(u + du, 0), width - 1)
            beside = depth[j, i] * CLEAN_UNIT_M
            if beside > 0.0 and abs(beside - z) > abs(other - z):
                other = beside
    return float(other)


@compiled
def _measure_tof(
    random: _Random, images: CleanState, errors: _TofErrors, drift_m: float, row: Any, out: Uint16Array
) -> None:
    """Fill in the counts of a time-of-flight camera.

    It measures ``scale z + level (bias + drift) + growth(z) (white_sigma white + shared_sigma shared)``. ``row`` is
    scratch for the pixels of one image row: the depth that is measured, and what scales its noise.
    """
    behind = images.behind
    height, width = behind.shape
    moved = _displacement(errors.shared.moving, random, _TOF_MOVING)
    fixed_sigma, moving_sigma = errors.shared.fixed_sigma, errors.shared.moving_sigma
    prints_hide = errors.level > 0.0 and errors.prints_reflect
    z, growth, white_sigma_m, shared_sigma_m = row
    for v in range(height):
        # Twice the width: a second uniform number per pixel says how a flying pixel mixes both sides.
        white = random.gaussian[_row_start(random, _TOF_WHITE, v, 2 * width) :]
        uniform = random.uniform[_row_start(random, _TOF_UNIFORM, v, 2 * width) :]
        fixed, moving = _shared_rows(errors.shared, v, moved)
        bias_m, counts = errors.bias_m[v], out[v]
        # Loops with branches and tables beside loops without, which the compiler vectorises.
        for u in range(width):
            z[u] = behind[v, u] * CLEAN_UNIT_M
            growth[u] = 1.0 - TOF_DISTANCE_SHARE + TOF_DISTANCE_SHARE * z[u] / _NAMED_AT_M
        for u in range(width):
            cosine, flags = images.cosine[v, u], images.flags[v, u]
            if prints_hide and flags & REFLECTIVE_FLAG:  # what is behind them
                z[u] = images.membrane[v, u] * CLEAN_UNIT_M
                cosine, growth[u] = np.uint8(255), 1.0
            elif flags & EDGE_FLAG and uniform[u] > 1.0 - errors.flying_share:
                z[u] += uniform[u + width] * (_across_edge(behind, v, u, z[u]) - z[u])
            white_sigma_m[u], shared_sigma_m[u] = errors.white_sigma_m[cosine], errors.shared_sigma_m[cosine]
        for u in range(width):
            shared = fixed_sigma * fixed[u] + moving_sigma * moving[u]
            noise = white_sigma_m[u] * growth[u] * white[u] + shared_sigma_m[u] * growth[u] * shared
            measured = z[u] * errors.scale + errors.level * (bias_m[u] + drift_m) + noise
            counts[u] = min(max(np.int32(measured / errors.unit_m + 0.5), np.int32(1)), np.int32(65534))
        for u in range(width):
            if behind[v, u] == 0 or uniform[u] < errors.dropout[images.cosine[v, u]]:
                counts[u] = 0


@compiled
def _measure_stereo(random: _Random, clean: Uint16Array, errors: _StereoErrors, out: Uint16Array) -> None:
    """Fill in the counts of a stereo camera, whose errors are those of the disparity ``focal_baseline / z``."""
    height, width = clean.shape
    wrap = errors.holes.shape[0] - 1
    moved = _displacement(errors.shared.moving, random, _STEREO_MOVING)
    down, right = _displacement(errors.holes, random, _STEREO_HOLES)
    noise, noisy = errors.shared, errors.level > 0.0
    for v in range(height):
        white = random.gaussian[_row_start(random, _STEREO_WHITE, v, width) :]
        fixed, moving = _shared_rows(noise, v, moved)
        holes = errors.holes[(v + down) & wrap, right:]
        for u in range(width):  # without branches, which the compiler vectorises
            disparity = errors.focal_baseline / (clean[v, u] * CLEAN_UNIT_M)
            # What lies left of the right imager's view has no match.
            hidden = u < disparity
            shared = noise.fixed_sigma * fixed[u] + noise.moving_sigma * moving[u]
            if noisy:
                disparity += errors.level * (shared + errors.white_sigma_px * white[u])
                if errors.subpixel_steps > 0.0:
                    disparity = np.int32(disparity * errors.subpixel_steps + 0.5) / errors.subpixel_steps
            counts = min(np.int32(errors.focal_baseline / (disparity * errors.unit_m) + 0.5), np.int32(65534))
            lost = 65535 if (not hidden) & (holes[u] > errors.saturated_from) else 0
            unmatched = noisy & (hidden | (holes[u] > errors.hole_from))
            out[v, u] = 0 if clean[v, u] == 0 else lost if unmatched else counts


@compiled
def _add_grain(random: _Random, stream: int64, clean: Uint8Array, bank: npt.NDArray[np.int8], out: Uint8Array) -> None:
    """Add the noise of a colour camera to the bytes of an image (H, 3 W)."""
    height, width = clean.shape
    for v in range(height):
        grain = bank[_row_start(random, stream, v, width) :]
        for u in range(width):  # 16 bits hold every sum, and numba would compute it with 64
            level = np.int16(np.int16(clean[v, u]) + np.int16(grain[u]))
            out[v, u] = np.uint8(min(max(level, np.int16(0)), np.int16(255)))


class NoiseModel:
    """The measurement errors of one rig with one seed."""

    def __init__(self, rig: Rig, seed: int, level: float, sensor: SensorModel) -> None:
        level = 0.0 if sensor.exact else level
        self._seed, self.sensor = seed, sensor
        # The order in which the generator is asked is part of what a seed means.
        rng = np.random.default_rng([seed, 2])
        self._gaussian = rng.standard_normal(_BANK, dtype=np.float32)
        self._uniform = rng.random(_BANK, dtype=np.float32)
        self._grain = np.clip(np.round(sensor.colour_levels * level * self._gaussian), -127, 127).astype(np.int8)
        self._stereo = _stereo_errors(rng, rig.tactile, level, sensor)
        bias_m = _bias(rng, sensor, rig.proximity.intrinsics.shape)
        self._drift_phase = rng.uniform(0.0, 2 * np.pi)
        self._tof = _tof_errors(rng, rig.proximity, level, sensor, bias_m)

    def proximity_depth(self, frame: int, state: CleanState) -> Uint16Array:
        """Return the time-of-flight measurement behind the membrane in raw counts."""
        out = np.empty_like(state.behind)
        drift_m = self.sensor.tof_drift_m * np.sin(2 * np.pi * frame / _DRIFT_FRAMES + self._drift_phase)
        width = out.shape[1]
        row = (*np.empty((2, width)), *np.empty((2, width), np.float32))
        _measure_tof(self._random(frame), state, self._tof, drift_m, row, out)
        return out

    def tactile_depth(self, frame: int, clean: Uint16Array) -> Uint16Array:
        """Return the stereo measurement of the membrane in raw counts; 0 and 65535 where there is no match."""
        out = np.empty_like(clean)
        _measure_stereo(self._random(frame), clean, self._stereo, out)
        return out

    def colour(self, frame: int, stream: int, clean: Uint8Array) -> Uint8Array:
        """Add the grain of a colour camera; ``stream``, 0 or 1, tells the cameras apart."""
        out = np.empty_like(clean)
        rows = (clean.shape[0], -1)
        random = self._random(frame)
        _add_grain(random, _COLOUR + stream, clean.reshape(rows), self._grain, out.reshape(rows))
        return out

    def _random(self, frame: int) -> _Random:
        return _Random(self._seed, frame, self._gaussian, self._uniform)


def _stereo_errors(rng: np.random.Generator, camera: DepthCamera, level: float, sensor: SensorModel) -> _StereoErrors:
    width = camera.intrinsics.width
    pixels = width / _NAMED_WIDTH_PX
    fixed_sigma, moving_sigma = (sensor.stereo_correlated_px * part for part in _parts(sensor.stereo_fixed_share))
    fixed, moving = (_smooth_field(rng, sensor.stereo_length_px * pixels, width) for _ in range(2))
    shared = _SharedNoise(fixed_sigma, moving_sigma, fixed, moving)
    holes = _smooth_field(rng, _HOLE_PX * pixels, width)
    hole_from, saturated_from = (
        float(np.quantile(holes[:, :_FIELD], 1 - min(share * level, 0.5)))
        for share in (sensor.stereo_hole_share, sensor.stereo_saturated_share)
    )
    return _StereoErrors(
        level=level,
        unit_m=camera.depth_unit_m,
        focal_baseline=camera.intrinsics.fx * STEREO_BASELINE_M,
        subpixel_steps=sensor.stereo_subpixel_steps,
        white_sigma_px=sensor.stereo_white_px,
        shared=shared,
        holes=holes,
        hole_from=hole_from,
        saturated_from=saturated_from,
    )


def _tof_errors(
    rng: np.random.Generator, camera: DepthCamera, level: float, sensor: SensorModel, bias_m: Float32Array
) -> _TofErrors:
    width = camera.intrinsics.width
    fixed = moving = np.zeros((1, width), dtype=np.float32)
    if sensor.tof_correlated_m > 0.0:
        length_px = sensor.tof_correlated_px * width / _NAMED_WIDTH_PX
        fixed, moving = _smooth_field(rng, length_px, width), _smooth_field(rng, length_px, width)
    cosine = np.linspace(0.0, 1.0, 256)
    growth = np.minimum(1.0 / np.maximum(cosine, 0.05), 6.0)
    growth = 1.0 - _TOF_INCIDENCE_SHARE + _TOF_INCIDENCE_SHARE * growth
    grazing = np.clip((_GRAZING_COSINE - cosine) / _GRAZING_COSINE, 0.0, 1.0)
    dropout = sensor.tof_dropout_share + sensor.tof_grazing_dropout_share * grazing
    return _TofErrors(
        level=level,
        unit_m=camera.depth_unit_m,
        scale=1.0 + level * (sensor.tof_scale - 1.0),
        prints_reflect=sensor.prints_reflect,
        flying_share=min(sensor.tof_flying_share * level, 1.0),
        bias_m=bias_m,
        white_sigma_m=(level * sensor.tof_white_m * growth).astype(np.float32),
        shared_sigma_m=(level * sensor.tof_correlated_m * growth).astype(np.float32),
        dropout=(level * dropout).astype(np.float32),
        shared=_SharedNoise(*_parts(sensor.tof_correlated_fixed_share), fixed, moving),
    )


def _smooth_field(rng: np.random.Generator, sigma_px: float, width: int) -> Float32Array:
    """Return white noise through a Gaussian window, of variance 1, that wraps around, (2^n, 2^n + width)."""
    margin = int(4 * sigma_px) + 1
    white = np.pad(rng.standard_normal((_FIELD, _FIELD), dtype=np.float32), margin, mode="wrap")
    field = cv2.GaussianBlur(white, (0, 0), sigma_px)[margin:-margin, margin:-margin]
    return np.pad((field - field.mean()) / field.std(), ((0, 0), (0, width)), mode="wrap")


def _parts(fixed_share: float) -> tuple[float, float]:
    """Return the standard deviations of the fixed and the changing part of noise of variance 1."""
    return fixed_share**0.5, (1.0 - fixed_share) ** 0.5


def _bias(rng: np.random.Generator, sensor: SensorModel, shape: tuple[int, int]) -> Float32Array:
    """Return offset, slope and a bias that varies over about a quarter of the image."""
    height, width = shape
    coarse = rng.standard_normal((5, 6)).astype(np.float32)
    bias = sensor.tof_offset_m + sensor.tof_slow_bias_m * cv2.resize(
        coarse, (width, height), interpolation=cv2.INTER_CUBIC
    )
    if sensor.tof_slope_m:
        v, u = np.mgrid[:height, :width]
        turn = np.radians(sensor.tof_slope_deg)
        right, down = (u - (width - 1) / 2) / width, (v - (height - 1) / 2) / width
        bias = bias + sensor.tof_slope_m * (np.cos(turn) * right + np.sin(turn) * down)
    return np.ascontiguousarray(bias, dtype=np.float32)
