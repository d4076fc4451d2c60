"""From clean images to measurements: the errors of real depth cameras.

Random numbers come from banks made once from the seed; where a frame starts to read in them is a
hash of seed, frame and row. So any frame can be made at any time, always with the same bits, and
costs a few milliseconds.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from ...model.arrays import Float32Array, Uint8Array, Uint16Array
from ...model.frames import Rig
from .objects import compiled
from .render import CLEAN_UNIT_M, EDGE_FLAG, REFLECTIVE_FLAG

#: Time of flight: axial noise at normal incidence and 0.3 m, and its growth with 1 / cosine, metres.
_TOF_SIGMA_M: Final = (0.00065, 0.00035)
#: Time of flight: a constant and a low-frequency bias over the image, and a slow drift, metres.
_TOF_OFFSET_M: Final = 0.0004
_TOF_BIAS_M: Final = 0.0006
_TOF_DRIFT_M: Final = 0.0003
_DRIFT_PERIOD_FRAMES: Final = 151.0
#: Share of pixels at a step of depth that mix both sides.
_FLYING_SHARE: Final = 0.6
#: Stereo: disparity noise fixed to the scene and changing, and the step of interpolation, pixels.
_STEREO_FIXED_PX: Final = 0.03
_STEREO_SIGMA_PX: Final = 0.03
_SUBPIXEL_STEPS: Final = 32.0
_STEREO_BASELINE_M: Final = 0.018
#: Half-width of the matching window in pixels, as the sigma of a Gaussian.
_WINDOW_SIGMA_PX: Final = 2.4
#: Share of pixels in holes, of the matcher and of those that report 65535.
_HOLE_SHARE: Final = 0.006
_SATURATED_SHARE: Final = 0.001
#: Noise of the colour cameras, 8-bit levels.
_COLOUR_SIGMA: Final = 2.2

_BANK: Final = 1 << 20
_FIELD: Final = 1024


@compiled
def _hash(seed: int, frame: int, stream: int, row: int) -> int:
    """Mix four numbers into 62 random bits (splitmix64's finaliser, after each number)."""
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
    drift_m: float,
    behind: Uint16Array,
    membrane: Uint16Array,
    cosine: Uint8Array,
    flags: Uint8Array,
    bias_m: Float32Array,
    sigma_m: Float32Array,
    dropout: Float32Array,
    gaussian: Float32Array,
    uniform: Float32Array,
    out: Uint16Array,
) -> None:
    height, width = behind.shape
    room = gaussian.size - 2 * width
    for v in range(height):
        g = gaussian[_hash(seed, frame, 0, v) % room :]
        r = uniform[_hash(seed, frame, 1, v) % room :]
        for u in range(width):
            count = behind[v, u]
            if count == 0 or (level > 0.0 and r[u] < dropout[cosine[v, u]]):
                out[v, u] = 0
                continue
            z = count * CLEAN_UNIT_M
            sigma = sigma_m[cosine[v, u]] * (0.5 + z / 0.6)
            if level > 0.0 and flags[v, u] & REFLECTIVE_FLAG:
                z = membrane[v, u] * CLEAN_UNIT_M
                sigma = sigma_m[255]
            elif level > 0.0 and flags[v, u] & EDGE_FLAG and r[u] > 1.0 - min(_FLYING_SHARE * level, 1.0):
                other = z
                for dv in range(-1, 2):
                    for du in range(-1, 2):
                        j, i = min(max(v + dv, 0), height - 1), min(max(u + du, 0), width - 1)
                        beside = behind[j, i] * CLEAN_UNIT_M
                        if beside > 0.0 and abs(beside - z) > abs(other - z):
                            other = beside
                z += r[u + width] * (other - z)
            z += level * (bias_m[v, u] + drift_m) + sigma * g[u]
            out[v, u] = min(max(int(z / unit_m + 0.5), 1), 65534)


@compiled
def _stereo(
    seed: int,
    frame: int,
    level: float,
    unit_m: float,
    focal_baseline: float,
    clean: Uint16Array,
    fixed: Float32Array,
    moving: Float32Array,
    holes: Float32Array,
    hole_from: float,
    saturated_from: float,
    out: Uint16Array,
) -> None:
    height, width = clean.shape
    wrap = moving.shape[0] - 1
    mv, mu = _hash(seed, frame, 2, 0) & wrap, _hash(seed, frame, 2, 1) & wrap
    hv, hu = _hash(seed, frame, 3, 0) & wrap, _hash(seed, frame, 3, 1) & wrap
    for v in range(height):
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
                noise = _STEREO_FIXED_PX * fixed[v & wrap, u & wrap]
                noise += _STEREO_SIGMA_PX * moving[(v + mv) & wrap, (u + mu) & wrap]
                disparity = int((disparity + level * noise) * _SUBPIXEL_STEPS + 0.5) / _SUBPIXEL_STEPS
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
        start = _hash(seed, frame, stream, v) % room
        for u in range(width):
            out[v, u] = min(max(int(clean[v, u]) + int(bank[start + u]), 0), 255)


class NoiseModel:
    """The measurement errors of one rig with one seed.

    Parameters
    ----------
    rig : Rig
    seed : int
        From 0; frames of different seeds are independent.
    level : float
        1: as the data sheets give it. 0: exact to the quantisation. 2: twice the errors.
    """

    def __init__(self, rig: Rig, seed: int, level: float) -> None:
        self._rig, self._seed, self._level = rig, seed, level
        rng = np.random.default_rng([seed, 2])
        self._gaussian = rng.standard_normal(_BANK, dtype=np.float32)
        self._uniform = rng.random(_BANK, dtype=np.float32)
        self._grain_bank = np.clip(np.round(_COLOUR_SIGMA * level * self._gaussian), -127, 127).astype(np.int8)
        self._fixed, self._moving = _smooth_field(rng, _WINDOW_SIGMA_PX), _smooth_field(rng, _WINDOW_SIGMA_PX)
        self._holes = _smooth_field(rng, 2 * _WINDOW_SIGMA_PX)
        self._bias = _slow_bias(rng, rig.proximity.intrinsics.shape)
        self._phase = rng.uniform(0.0, 2 * np.pi)
        cosine = np.linspace(0.0, 1.0, 256)
        growth = np.minimum(1.0 / np.maximum(cosine, 0.05), 6.0)
        self._sigma = (level * (_TOF_SIGMA_M[0] + _TOF_SIGMA_M[1] * growth)).astype(np.float32)
        grazing = np.clip((0.35 - cosine) / 0.35, 0.0, 1.0)
        self._dropout = (level * (0.0025 + 0.5 * grazing)).astype(np.float32)
        self._hole_from = float(np.quantile(self._holes, 1 - min(_HOLE_SHARE * level, 0.5)))
        self._saturated_from = float(np.quantile(self._holes, 1 - min(_SATURATED_SHARE * level, 0.5)))

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
        drift = _TOF_DRIFT_M * np.sin(2 * np.pi * frame / _DRIFT_PERIOD_FRAMES + self._phase)
        _time_of_flight(
            self._seed, frame, self._level, self._rig.proximity.depth_unit_m, drift, behind, membrane, cosine, flags,
            self._bias, self._sigma, self._dropout, self._gaussian, self._uniform, out,
        )  # fmt: skip
        return out

    def tactile_depth(self, frame: int, clean: Uint16Array) -> Uint16Array:
        """Return the stereo measurement of the membrane in raw counts; 0 and 65535 where there is no match."""
        out = np.empty_like(clean)
        tactile = self._rig.tactile
        _stereo(
            self._seed, frame, self._level, tactile.depth_unit_m, tactile.intrinsics.fx * _STEREO_BASELINE_M, clean,
            self._fixed, self._moving, self._holes, self._hole_from, self._saturated_from, out,
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


def _slow_bias(rng: np.random.Generator, shape: tuple[int, int]) -> Float32Array:
    """A bias that varies over about a quarter of the image."""
    coarse = rng.standard_normal((5, 6)).astype(np.float32)
    bias = cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC)
    return np.ascontiguousarray(_TOF_OFFSET_M + _TOF_BIAS_M * bias, dtype=np.float32)
