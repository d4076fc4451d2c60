"""The membrane's depth in proximity pixels, from the tactile camera's depth image."""

from __future__ import annotations

import numpy as np

from ..contact.alignment import tactile_pose
from ..model.alignment import AlignmentSection
from ..model.arrays import BoolArray, Float32Array, Float64Array, IndexArray, Uint16Array
from ..model.clouds import deproject, nearest_pixels, ray_table, valid_depth
from ..model.frames import Rig

_STEPS = 12
_SETTLED_M = 2e-4
#: Limit of the last step, metres. Noise makes steps below it alternate between neighbouring pixels.
_WAVERING_M = 1e-3
#: Where searches start, as quantiles of the measured depths: a ray that misses the membrane at the
#: one may meet it at the next.
_STARTS = (0.5, 0.01, 0.99)


class MembraneView:
    """Maps tactile measurements to proximity pixels by the membrane's own depth.

    For each proximity ray the point is sought whose expected tactile depth is the measured one,
    ``z <- z + (measured - expected)``, which converges where the membrane's slope along the tactile
    image row is below the cameras' angle to it, so everywhere but at steep folds.
    """

    def __init__(self, section: AlignmentSection, rig: Rig) -> None:
        self._T_p_t = tactile_pose(section, rig)
        T_t_p = np.linalg.inv(self._T_p_t)
        self._rig = rig
        rays = ray_table(rig.proximity.intrinsics).reshape(-1, 2).astype(np.float64)
        self._directions = np.concatenate([rays, np.ones((len(rays), 1))], axis=1) @ T_t_p[:3, :3].T
        self._origin = T_t_p[:3, 3]
        self._factor = rig.tactile.depth_unit_m * section.depth_scale
        self._offset = section.depth_offset_m

    def depth_m(self, tactile_depth: Uint16Array) -> Float64Array:
        """Return the membrane's depth in the proximity frame, metres.

        Parameters
        ----------
        tactile_depth : uint16, shape (Ht, Wt)
            Raw counts.

        Returns
        -------
        float64, shape (H, W)
            nan where the tactile camera does not see it.
        """
        z = np.full(len(self._directions), np.nan)
        seen = tactile_depth[valid_depth(tactile_depth)]
        starts = np.quantile(seen, _STARTS) * self._factor + self._offset if len(seen) else ()
        for start in starts:
            still = np.flatnonzero(np.isnan(z))
            z[still] = self._search(tactile_depth, still, float(start))
        return z.reshape(self._rig.proximity.intrinsics.shape)

    def pick(self, mask: BoolArray, tactile_depth: Uint16Array) -> BoolArray:
        """Return a tactile mask (Ht, Wt) mapped to proximity pixels (H, W) by the membrane's depth."""
        z = self.depth_m(tactile_depth).reshape(-1)
        picked = np.zeros(z.shape, bool)
        known = np.flatnonzero(np.isfinite(z))
        row, column, inside = self._pixels(z[known], known)
        picked[known] = inside & mask[row, column]
        return picked.reshape(self._rig.proximity.intrinsics.shape)

    def points(self, mask: BoolArray, tactile_depth: Uint16Array) -> Float32Array:
        """Return the measured points of a tactile mask (Ht, Wt) in the proximity frame, metres, shape (N, 3)."""
        pixels = np.flatnonzero(mask & valid_depth(tactile_depth))
        camera = self._rig.tactile.model_copy(update={"depth_unit_m": self._factor})
        points = deproject(tactile_depth, camera, pixels).astype(np.float64)
        points *= 1.0 + self._offset / np.maximum(points[:, 2:], 1e-9)
        return np.asarray(points @ self._T_p_t[:3, :3].T + self._T_p_t[:3, 3], np.float32)

    def _search(self, tactile_depth: Uint16Array, which: IndexArray, start_m: float) -> Float64Array:
        """Return the depth at which rays meet the membrane; nan if the search does not converge."""
        found = np.full(len(which), np.nan)
        open_, z = np.arange(len(which)), np.full(len(which), start_m)
        for step in range(_STEPS):
            rays = which[open_]
            row, column, inside = self._pixels(z, rays)
            counts = np.where(inside, tactile_depth[row, column], 0)
            measured = counts * self._factor + self._offset
            miss = measured - (self._directions[rays, 2] * z + self._origin[2])
            seen = valid_depth(counts)
            z = z + miss
            settled = seen & (np.abs(miss) <= (_SETTLED_M if step < _STEPS - 1 else _WAVERING_M))
            found[open_[settled]] = z[settled]
            go_on = seen & ~settled
            open_, z = open_[go_on], z[go_on]
        return found

    def _pixels(self, z: Float64Array, which: IndexArray) -> tuple[IndexArray, IndexArray, BoolArray]:
        """Return row, column and visibility in the tactile image of the points at depth z on some rays."""
        return nearest_pixels(self._directions[which] * z[:, None] + self._origin, self._rig.tactile.intrinsics)
