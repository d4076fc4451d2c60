"""Rivals that use one camera and a frame of the untouched membrane."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from ..contact.alignment import tactile_pose
from ..contact.pipeline import ContactPipeline
from ..model.alignment import AlignmentSection
from ..model.arrays import BoolArray, Float32Array, Float64Array, IndexArray, Uint16Array
from ..model.clouds import deproject, nearest_pixels, ray_table, valid_depth
from ..model.frames import Rig, SensorFrame, Shot
from ..model.patch import AlignedDepth, ContactPatch, Lazy, PressureFacts, Provenance
from ..preset import Preset

#: Finds the contact patch of a frame; raises a `TactuneError` that says why where it cannot.
Find = Callable[[SensorFrame], ContactPatch]

#: proximity-only: minimum distance of a contact point in front of the untouched membrane; it excludes noise at the rim.
_MARGIN_M: Final = 0.002
#: tactile-only: share of the deformed points that is contact, as in the paper; below this deformation none is.
_SHARE, _UNTOUCHED_M = 0.6, 0.0015


# Rivals that use one camera: contact is what differs from the untouched membrane (the baselines of Yin et al.)


def proximity_only(preset: Preset, rig: Rig, untouched: SensorFrame) -> Find:
    """Proximity camera: points nearer than the untouched membrane."""
    untouched.check_against(rig)
    nearer_than_m = MembraneView(preset.alignment, rig).depth_m(untouched.tactile_depth) - _MARGIN_M

    def find(frame: SensorFrame) -> ContactPatch:
        frame.check_against(rig)
        counts = frame.proximity_depth
        with np.errstate(invalid="ignore"):
            mask = valid_depth(counts) & (counts * rig.proximity.depth_unit_m < nearer_than_m)
        return rival_patch(frame, rig, deproject(counts, rig.proximity, np.flatnonzero(mask)), lambda: mask)

    return find


def tactile_only(preset: Preset, rig: Rig, untouched: SensorFrame) -> Find:
    """Tactile camera: the 60 % of the deformed membrane that moved most."""
    untouched.check_against(rig)
    factor = rig.tactile.depth_unit_m * preset.alignment.depth_scale
    view = MembraneView(preset.alignment, rig)
    untouched_m = np.where(valid_depth(untouched.tactile_depth), untouched.tactile_depth * factor, np.nan)

    def in_contact(counts: Uint16Array) -> BoolArray:
        with np.errstate(invalid="ignore"):
            deformation_m = np.where(valid_depth(counts), untouched_m - counts * factor, np.nan)
            deformed = deformation_m > _UNTOUCHED_M
            if not deformed.any():
                return deformed
            least_m = float(np.quantile(deformation_m[deformed], 1.0 - _SHARE))
            return deformed & (deformation_m >= least_m)

    def find(frame: SensorFrame) -> ContactPatch:
        frame.check_against(rig)
        counts = frame.tactile_depth
        contact = in_contact(counts)
        return rival_patch(frame, rig, view.points(contact, counts), lambda: view.pick(contact, counts))

    return find


def pressure(preset: Preset, rig: Rig, untouched: SensorFrame) -> Find:
    """Tactile camera: the contact test ``pressure``, on a rig with that camera alone."""
    alone, view = Rig.of_one_camera(rig.tactile), MembraneView(preset.alignment, rig)

    def seen_alone(frame: SensorFrame) -> SensorFrame:
        frame.check_against(rig)
        return SensorFrame.of_shots(alone, frame.sequence, None, Shot(frame.tactile_depth, frame.tactile_color, 0.0))

    settings = {"contact_test": "pressure", "mask.enabled": False, "region.enabled": False}
    pipeline = ContactPipeline(preset.with_values(settings), alone, seen_alone(untouched))
    turn = tactile_pose(preset.alignment, rig)[:3, :3]

    def find(frame: SensorFrame) -> ContactPatch:
        patch, counts = pipeline.process(seen_alone(frame)), frame.tactile_depth
        found = patch.pressure
        assert found is not None
        force, spread = turn @ found.force_mm2, np.sqrt(turn**2 @ np.square(found.force_sigma_mm2))
        points = view.points(patch.mask, counts)
        turned = replace(found, force_mm2=tuple(force.tolist()), force_sigma_mm2=tuple(spread.tolist()))
        return rival_patch(frame, rig, points, lambda: view.pick(patch.mask, counts), turned)

    return find


def rival_patch(
    frame: SensorFrame,
    rig: Rig,
    points: Float32Array,
    mask: Callable[[], BoolArray],
    pressure: PressureFacts | None = None,
) -> ContactPatch:
    """Return a rival's patch, of which only points, (N, 3), and mask, (H, W), are known; their numbers may differ."""
    known, shape = Lazy(mask), rig.proximity.intrinsics.shape
    verdicts = Lazy(lambda: np.where(known.get(), Provenance.CONTACT, Provenance.OUTSIDE_TOLERANCE).astype(np.uint8))
    nothing = np.full(shape, np.nan, np.float32)
    return ContactPatch(
        frame.sequence, points, verdicts, AlignedDepth(nothing, nothing), rig, {}, made_mask=known, pressure=pressure
    )


# The membrane in proximity pixels, from the tactile depth

_STEPS = 12
_SETTLED_M = 2e-4
#: Limit of the last step, metres. Noise makes steps below it alternate between neighbouring pixels.
_WAVERING_M = 1e-3
#: Quantiles of the measured depths where searches start: a ray that misses the membrane at one may meet it at another.
_STARTS = (0.5, 0.01, 0.99)


class MembraneView:
    """Maps tactile measurements to proximity pixels: ``z <- z + (measured - expected)`` along each proximity ray."""

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
        """Return the membrane's depth in the proximity frame, (H, W); nan where the tactile camera does not see it."""
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
