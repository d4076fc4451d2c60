"""How far the membrane has moved since the untouched frame: a touch dents it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from ..model.arrays import Float32Array, IndexArray, Uint16Array, median
from ..model.clouds import pixel_areas_m2, valid_depth
from ..model.frames import SensorFrame
from ..model.patch import Lazy
from ..model.rig_noise import RigNoise

if TYPE_CHECKING:
    from .pixels import Pixels

#: Range of depths that are taken to be equally likely where no dent can be seen, metres.
NEAR_M: Final = 0.005
#: Most points of a contact, and rows and columns around it, that tell a dent; step between the tactile pixels that tell
#: how the rest has moved.
_MAX_POINTS, _BOX_ROWS, _STEP_PX = 400, 20, 16
GRID: Final = (slice(_STEP_PX // 2, None, _STEP_PX),) * 2
#: The dent is the mean in the box around a contact that is wider on each side by this share: it does not end there.
_BESIDE: Final = 0.25
#: Standard deviation of a dent that no averaging reduces, metres, and share of the movement elsewhere that adds to it.
_DENT_FLOOR_M, _MOVED_SHARE = 0.0003, 0.5
#: Largest evidence of the untouched frame, natural logarithm of odds.
MAX_EVIDENCE: Final = 4.0


class Dent(NamedTuple):
    """How far the membrane around a contact has moved towards the camera; metres, nan if unseen."""

    depth_m: float
    area_m2: float  # in which it is seen
    elsewhere_m: float  # how far the rest has moved
    #: How much farther what the proximity camera sees in contact has moved; large if it saw nothing.
    behind_m: float

    def evidence(self, noise: RigNoise | None, tactile_m4: float, pixel_sigma_m: float) -> float:
        """Return the logarithm of how much likelier the dent makes a touch than if none could be seen.

        By the formula of `tactune.core.contact.doubt`; 0 if the dent is not seen. The noise power of the tactile
        camera, m^4, and the standard deviation of a pixel are those of `RigBias`.
        """
        if math.isnan(self.depth_m):
            return 0.0
        frames = 2 - (0.0 if noise is None else noise.tactile.changing_share)  # the untouched is averaged
        noise_m2 = frames / (self.area_m2 / tactile_m4 + 1 / pixel_sigma_m**2)
        elsewhere_m = 0.0 if math.isnan(self.elsewhere_m) else self.elsewhere_m
        sigma_m = math.sqrt(noise_m2 + _DENT_FLOOR_M**2 + (_MOVED_SHARE * elsewhere_m) ** 2)
        sigmas = max(self.depth_m - elsewhere_m, 0.0) / sigma_m
        deeper = (1 + math.erf(sigmas / math.sqrt(2))) / 2
        depths_m = min(math.sqrt(2 * math.pi) * sigma_m * deeper, NEAR_M)  # that agree with the dent
        return min(math.log(depths_m / NEAR_M) + sigmas**2 / 2, MAX_EVIDENCE)


class Dents:
    """The membrane of one frame against the untouched one."""

    def __init__(self, pixels: Pixels, frame: SensorFrame, untouched: SensorFrame) -> None:
        self._pixels, self._frame, self._untouched = pixels, frame, untouched
        self._everywhere = Lazy(lambda: self._moved_m(GRID))

    def around(self, places: IndexArray, depth_m: Float32Array) -> Dent:
        """Return the dent around a contact of flat proximity pixels, and their depths."""
        pixels, frame, elsewhere_m = self._pixels, self._frame, self._everywhere.get().copy()
        step = max(len(places) // _MAX_POINTS, 1)
        places, depth_m = places[::step], depth_m[::step]
        where = pixels.alignment.tactile_pixels(places, depth_m, pixels.rig)
        height, width = frame.tactile_depth.shape
        u, v = np.rint(np.nan_to_num(where, nan=-1.0)).astype(np.int64)
        seen = (u >= 0) & (u < width) & (v >= 0) & (v < height)
        if not seen.any():
            return Dent(math.nan, 0.0, math.nan, math.nan)
        u, v, places = u[seen], v[seen], places[seen]
        box = rows, columns = _around(v, height), _around(u, width)
        elsewhere_m[tuple(slice(side.start // _STEP_PX, side.stop // _STEP_PX + 1) for side in box)] = np.nan
        pixel_m2 = float(pixel_areas_m2(depth_m, pixels.rig.tactile.intrinsics).mean())
        area_m2 = pixel_m2 * (rows.stop - rows.start) * (columns.stop - columns.start)
        then, now = (each.proximity_depth.reshape(-1)[places] for each in (self._untouched, frame))
        behind_m = _closer_m(then, now, np.float32(pixels.rig.proximity.depth_unit_m)) - self._moved_m((v, u))
        farther_m = median(np.nan_to_num(behind_m, nan=1.0))
        return Dent(_middle_mean(self._moved_m(box)), area_m2, _middle_mean(elsewhere_m), farther_m)

    def _moved_m(self, where: Any) -> Float32Array:
        """Return how far the membrane has moved towards the camera."""
        before, now = (each.tactile_depth[where] for each in (self._untouched, self._frame))
        return _closer_m(before, now, np.float32(self._pixels.alignment.tables.tactile_unit_m))


def _closer_m(before: Uint16Array, now: Uint16Array, unit_m: np.float32) -> Float32Array:
    """Return how far depths have moved towards the camera; nan where one is missing."""
    moved = (before.astype(np.float32) - now) * unit_m
    return np.asarray(np.where(valid_depth(before) & valid_depth(now), moved, np.float32(np.nan)))


def _around(places: IndexArray, size: int) -> slice:
    """Return a range of rows or columns around some of an image."""
    first, last = int(places.min()), int(places.max()) + 1
    beside = round(_BESIDE * (last - first))
    return slice(max(first - beside, 0), min(last + beside, size), max((last - first) // _BOX_ROWS, 1))


def _middle_mean(values: Float32Array) -> float:
    """Return the mean of the half around the median, nan left out: coarse disparities make the median itself coarse."""
    known = np.sort(values[np.isfinite(values)])
    middle = known[len(known) // 4 : len(known) - len(known) // 4]
    return float(middle.mean()) if len(middle) else math.nan
