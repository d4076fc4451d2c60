"""What the 3D views frame by themselves: the membrane and the patch on it, not what lies behind."""

from __future__ import annotations

import numpy as np

from ...core.contact.alignment import tactile_pose
from ...core.contact.pipeline import ContactPatch
from ...core.errors import TactuneError
from ...core.model.arrays import Float64Array
from ...core.model.clouds import ray_table, valid_depth
from ..worker.results import Result

#: Rows of the tactile image that are enough for framing.
_ROWS = 60
#: Depths farther than this many interquartile ranges outside the quartiles are not the membrane (Tukey's fences,
#: "Exploratory Data Analysis", 1977); the slack in metres keeps a flat membrane whole.
_FENCE, _SLACK_M = 1.5, 0.01
_NOTHING = np.empty((0, 3))


def membrane_and_patch(result: Result) -> Float64Array:
    """Return points on the membrane and in the patch: float64 (N, 3), metres, proximity frame; (0, 3) if unknown."""
    return np.concatenate([_membrane(result), patch_points(result.patch)])


def patch_points(patch: ContactPatch | None) -> Float64Array:
    return _NOTHING if patch is None else patch.points.astype(np.float64)


def _membrane(result: Result) -> Float64Array:
    preset, rig = result.preset, result.source.rig
    step = max(1, len(result.frame.tactile_depth) // _ROWS)
    every = np.s_[::step, ::step]
    counts = result.frame.tactile_depth[every]
    seen = valid_depth(counts)
    try:
        pose = tactile_pose(preset.alignment, rig)
    except TactuneError:
        return _NOTHING
    if not seen.any():
        return _NOTHING
    depth = counts[seen] * (rig.tactile.depth_unit_m * preset.alignment.depth_scale) + preset.alignment.depth_offset_m
    low, high = np.percentile(depth, (25, 75))
    reach = _FENCE * (high - low) + _SLACK_M
    rays = ray_table(rig.tactile.intrinsics)[every][seen]
    points = np.column_stack([rays * depth[:, None], depth])[
        np.abs(depth - (low + high) / 2) <= (high - low) / 2 + reach
    ]
    placed = points @ pose[:3, :3].T + pose[:3, 3]
    if preset.region.enabled:
        left, top, width, height = preset.region.rectangle
        u, v = rig.proximity.intrinsics.project(placed).T
        placed = placed[(u >= left) & (u < left + width) & (v >= top) & (v < top + height)]
    return np.asarray(placed, np.float64)
