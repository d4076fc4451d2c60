"""From clean images to measurements: the errors of depth cameras, as large as a `SensorModel` says.

Random numbers come from banks made once from the seed; where a frame starts to read in them is a
hash of seed, frame and row. So any frame can be made at any time, always with the same bits, and
costs a few milliseconds.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
import numpy.typing as npt
from numpy import int64

from ...model.arrays import Float32Array, Uint8Array, Uint16Array
from ...model.frames import Rig
from .objects import compiled
from .render import CLEAN_UNIT_M, EDGE_FLAG, REFLECTIVE_FLAG
from .sensors import DEFAULT_SENSOR, SENSORS, SensorModel

#: Where the amplitudes of a `SensorModel` hold, metres.
_NAMED_AT_M: Final = 0.3
#: Image width at which the lengths of a `SensorModel` hold, pixels.
_NAMED_WIDTH_PX: Final = 640
#: Cosine of incidence below which a time-of-flight camera begins to lose pixels.
_GRAZING_COSINE: Final = 0.35

_BANK: Final = 1 << 20
_FIELD: Final = 1024


@compiled
def _hash(seed: int, frame: int, stream: int | int64, row: int | int64) -> int:
    """Mix four numbers into 62 random bits (splitmix64's finaliser, after each number).

    Callers wrap literals in ``int64``: numba would compile this function again for each literal.
    """
    state = np.uint64(0x9E3779B97F4A7C15)
    for value in (seed, frame, stream, row):
        state = (state ^ np.uint64(value)) + np.uint64(0x9E3779B97F4A7C15)
        state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        state = state ^ (state >> np.uint64(31))
    return int(state >> np.uint64(2))


@compiled
def _time_of_flight(
    seed: int,
    frame: int,
    level: float,
    unit_m: float,
    scale: float,
    drift_m: float,
    flying: float,
    near: float,
    behind: Uint16Array,
    membrane: Uint16Array,
    cosine: Uint8Array,
    flags: Uint8Array,
    bias_m: Float32Array,
    sigma_m: Float32Array,
    shared_m: Float32Array,
    fixed_share: float,
    moving_share: float,
    fixed: Float32Array,
    moving: Float32Array,
    dropout: Float32Array,
    gaussian: Float32Array,
    uniform: Float32Array,
    out: Uint16Array,
) -> None:
    height, width = behind.shape
    room = gaussian.size - 2 * width
    wrap = moving.shape[0] - 1
    mv, mu = _hash(seed, frame, int64(6), int64(0)) & wrap, _hash(seed, frame, int64(6), int64(1)) & wrap
    for v in range(height):
        g = gaussian[_hash(seed, frame, int64(0), v) % room :]
        r = uniform[_hash(seed, frame, int64(1), v) % room :]
        for u in range(width):
            count = behind[v, u]
            if count == 0 or (level > 0.0 and r[u] < dropout[cosine[v, u]]):
                out[v, u] = 0
                continue
            z = count * CLEAN_UNIT_M
            facing, growth = cosine[v, u], near + (1.0 - near) * z / _NAMED_AT_M
            if level > 0.0 and flags[v, u] & REFLECTIVE_FLAG:
                z = membrane[v, u] * CLEAN_UNIT_M
                facing, growth = np.uint8(255), 1.0
            elif level > 0.0 and flags[v, u] & EDGE_FLAG and r[u] > 1.0 - flying:
                other = z
                for dv in range(-1, 2):
                    for du in range(-1, 2):
                        j, i = min(max(v + dv, 0), height - 1), min(max(u + du, 0), width - 1)
                        beside = behind[j, i] * CLEAN_UNIT_M
                        if beside > 0.0 and abs(beside - z) > abs(other - z):
                            other = beside
                z += r[u + width] * (other - z)
            shared = fixed_share * fixed[v & wrap, u & wrap]
            shared += moving_share * moving[(v + mv) & wrap, (u + mu) & wrap]
            noise = sigma_m[facing] * growth * g[u] + shared_m[facing] * growth * shared
            z = z * scale + level * (bias_m[v, u] + drift_m) + noise
            out[v, u] = min(max(int(z / unit_m + 0.5), 1), 65534)


@compiled
def _stereo(
    seed: int,
    frame: int,
    level: float,
    unit_m: float,
    focal_baseline: float,
    clean: Uint16Array,
    steps: float,
    white_px: float,
    fixed_px: float,
    moving_px: float,
    fixed: Float32Array,
    moving: Float32Array,
    holes: Float32Array,
    hole_from: float,
    saturated_from: float,
    gaussian: Float32Array,
    out: Uint16Array,
) -> None:
    height, width = clean.shape
    room = gaussian.size - width
    wrap = moving.shape[0] - 1
    mv, mu = _hash(seed, frame, int64(2), int64(0)) & wrap, _hash(seed, frame, int64(2), int64(1)) & wrap
    hv, hu = _hash(seed, frame, int64(3), int64(0)) & wrap, _hash(seed, frame, int64(3), int64(1)) & wrap
    for v in range(height):
        g = gaussian[_hash(seed, frame, int64(7), v) % room :]
        for u in range(width):
            count = clean[v, u]
            out[v, u] = 0
            if count == 0:
                continue
            disparity = focal_baseline / (count * CLEAN_UNIT_M)
            if level > 0.0:
                # What lies left of the right imager's view has no match.
                hole = holes[(v + hv) & wrap, (u + hu) & wrap]
                if u < disparity or hole > hole_from:
                    out[v, u] = 65535 if u >= disparity and hole > saturated_from else 0
                    continue
                noise = fixed_px * fixed[v & wrap, u & wrap]
                noise += moving_px * moving[(v + mv) & wrap, (u + mu) & wrap]
                disparity += level * (noise + white_px * g[u])
                if steps > 0.0:
                    disparity = int(disparity * steps + 0.5) / steps
            out[v, u] = min(int(focal_baseline / (disparity * unit_m) + 0.5), 65534)


@compiled
def _grain(
    seed: int,
    frame: int,
    stream: int,
    clean: Uint8Array,
    bank: npt.NDArray[np.int8],
    out: Uint8Array,
) -> None:
    height, width = clean.shape
    room = bank.size - width
    for v in range(height):
        grain = bank[_hash(seed, frame, stream, v) % room :]
        for u in range(width):  # 16 bits hold every sum; wider numbers would take twice as long
            level = np.int16(clean[v, u]) + np.int16(grain[u])
            out[v, u] = np.uint8(min(max(level, np.int16(0)), np.int16(255)))


class NoiseModel:
    """The measurement errors of one rig with one seed.

    Parameters
    ----------
    rig : Rig
    seed : int
        From 0; frames of different seeds are independent.
    level : float
        Factor on all errors of the sensor. 0: exact to the quantisation.
    sensor : SensorModel, optional
        The errors; `DEFAULT_SENSOR` by default.
    """

    def __init__(self, rig: Rig, seed: int, level: float, sensor: SensorModel | None = None) -> None:
        sensor = sensor or SENSORS[DEFAULT_SENSOR]
        level = 0.0 if sensor.exact else level
        self._rig, self._seed, self._level, self.sensor = rig, seed, level, sensor
        rng = np.random.default_rng([seed, 2])
        self._gaussian = rng.standard_normal(_BANK, dtype=np.float32)
        self._uniform = rng.random(_BANK, dtype=np.float32)
        self._grain_bank = np.clip(np.round(sensor.colour_levels * level * self._gaussian), -127, 127).astype(np.int8)
        length_px = sensor.stereo_length_px * rig.tactile.intrinsics.width / _NAMED_WIDTH_PX
        self._fixed, self._moving = _smooth_field(rng, length_px), _smooth_field(rng, length_px)
        self._holes = _smooth_field(rng, sensor.stereo_hole_px * rig.tactile.intrinsics.width / _NAMED_WIDTH_PX)
        self._bias = _bias(rng, sensor, rig.proximity.intrinsics.shape)
        self._phase = rng.uniform(0.0, 2 * np.pi)
        self._tof_fixed = self._tof_moving = np.zeros((1, 1), dtype=np.float32)
        if sensor.tof_correlated_m > 0.0:
            length_px = sensor.tof_correlated_px * rig.proximity.intrinsics.width / _NAMED_WIDTH_PX
            self._tof_fixed, self._tof_moving = _smooth_field(rng, length_px), _smooth_field(rng, length_px)
        cosine = np.linspace(0.0, 1.0, 256)
        growth = np.minimum(1.0 / np.maximum(cosine, 0.05), 6.0)
        growth = 1.0 - sensor.tof_incidence_share + sensor.tof_incidence_share * growth
        self._sigma = (level * sensor.tof_white_m * growth).astype(np.float32)
        self._shared = (level * sensor.tof_correlated_m * growth).astype(np.float32)
        grazing = np.clip((_GRAZING_COSINE - cosine) / _GRAZING_COSINE, 0.0, 1.0)
        dropout = sensor.tof_dropout_share + sensor.tof_grazing_dropout_share * grazing
        self._dropout = (level * dropout).astype(np.float32)
        self._hole_from = float(np.quantile(self._holes, 1 - min(sensor.stereo_hole_share * level, 0.5)))
        self._saturated_from = float(np.quantile(self._holes, 1 - min(sensor.stereo_saturated_share * level, 0.5)))

    def proximity_depth(
        self,
        frame: int,
        behind: Uint16Array,
        membrane: Uint16Array,
        cosine: Uint8Array,
        flags: Uint8Array,
    ) -> Uint16Array:
        """Return the time-of-flight measurement behind the membrane in raw counts."""
        out = np.empty_like(behind)
        sensor = self.sensor
        drift = sensor.tof_drift_m * np.sin(2 * np.pi * frame / sensor.tof_drift_frames + self._phase)
        scale, flying = 1.0 + self._level * (sensor.tof_scale - 1.0), min(sensor.tof_flying_share * self._level, 1.0)
        _time_of_flight(
            self._seed, frame, self._level, self._rig.proximity.depth_unit_m, scale, drift, flying,
            1.0 - sensor.tof_distance_share, behind, membrane, cosine, flags, self._bias, self._sigma, self._shared,
            *_parts(sensor.tof_correlated_fixed_share), self._tof_fixed, self._tof_moving, self._dropout,
            self._gaussian, self._uniform, out,
        )  # fmt: skip
        return out

    def tactile_depth(self, frame: int, clean: Uint16Array) -> Uint16Array:
        """Return the stereo measurement of the membrane in raw counts; 0 and 65535 where there is no match."""
        out = np.empty_like(clean)
        tactile, sensor = self._rig.tactile, self.sensor
        fixed, moving = _parts(sensor.stereo_fixed_share)
        _stereo(
            self._seed, frame, self._level, tactile.depth_unit_m, tactile.intrinsics.fx * sensor.stereo_baseline_m,
            clean, sensor.stereo_subpixel_steps, sensor.stereo_white_px, sensor.stereo_correlated_px * fixed,
            sensor.stereo_correlated_px * moving, self._fixed, self._moving, self._holes, self._hole_from,
            self._saturated_from, self._gaussian, out,
        )  # fmt: skip
        return out

    def colour(self, frame: int, stream: int, clean: Uint8Array) -> Uint8Array:
        """Add the grain of a colour camera; ``stream`` tells the cameras apart."""
        out = np.empty_like(clean)
        rows = (clean.shape[0], -1)
        _grain(self._seed, frame, 4 + stream, clean.reshape(rows), self._grain_bank, out.reshape(rows))
        return out


def _smooth_field(rng: np.random.Generator, sigma_px: float) -> Float32Array:
    """White noise through a Gaussian window, wrapped at its ends, of variance 1."""
    margin = int(4 * sigma_px) + 1
    white = np.pad(rng.standard_normal((_FIELD, _FIELD), dtype=np.float32), margin, mode="wrap")
    field = cv2.GaussianBlur(white, (0, 0), sigma_px)[margin:-margin, margin:-margin]
    return np.ascontiguousarray((field - field.mean()) / field.std(), dtype=np.float32)


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
