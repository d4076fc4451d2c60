"""Fusion that tells much smaller gaps apart than one tolerance on single pixels can."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from ..alignment import make_alignment
from ..clouds import deproject, ray_table
from ..errors import TactuneError
from ..frames import Rig, SensorFrame
from ..fusion import depth_limits, region_bounds
from ..masking import colors_at, in_hsv_range
from ..preset import Preset
from ..rig_check import check_rig
from .calibrated_steps import contact_bias_m, drop_small, facing, local_mean, print_bias_m, retreat
from .method import ContactMethod, MethodPatch, failed

Float32Array = npt.NDArray[np.float32]
BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class CalibratedSettings:
    """How calibrated fusion decides. Chosen on the simulator's cube, cup and octopus, seeds 0 to 2.

    Attributes
    ----------
    difference_m : float
        Pixels whose depths differ by more take no part: backdrop, flying pixels.
    window_px : float
        Sigma of the window over which differences are averaged, pixels; 0 for none. Time of flight is noisy from
        pixel to pixel, so its mean is many times as exact as a pixel.
    least_share : float
        Share of the window that must take part; 0 to 1.
    bias_m : float
        The largest bias between the sensors that contact may tell, metres; 0 corrects none at all, neither by prints.
    slope : bool
        Take gaps along the surface's normal instead of along the optical axis.
    gap_m : float
        Mean gaps up to this are near, metres.
    retreat : float
        Share of the extrapolated way from where the gap is ``gap_m`` to where it is 0 that is taken away; 0 for none.
    core : float
        The share of the way to the middle of a near region beyond which nothing is taken away.
    most_px : float
        The longest way taken away, pixels.
    least_area_mm2 : float
        Smaller contacts are dropped.
    smooth_px : float
        Sigma of the window over which points are averaged, pixels; 0 for none.
    tactile_weight : float
        Share of the tactile depth in the points; the rest is the proximity depth's.
    """

    difference_m: float = 0.005
    window_px: float = 2.5
    least_share: float = 0.4
    bias_m: float = 0.0012
    slope: bool = True
    gap_m: float = 0.0018
    retreat: float = 0.9
    core: float = 0.6
    most_px: float = 16.0
    least_area_mm2: float = 25.0
    smooth_px: float = 2.0
    tactile_weight: float = 0.5

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            most = 1.0 if field.name in ("least_share", "core", "tactile_weight") else np.inf
            if not 0.0 <= value <= most or np.isinf(value):
                raise TactuneError(
                    f"fusion-calibrated: {field.name} is {value:g}, but it must be from 0"
                    + (" to 1" if most == 1.0 else "")
                )


class CalibratedFusion(ContactMethod):
    """Contact from local means of the difference of both depths, and from how the gap grows beside it.

    Works from one frame alone, with the preset's pose, depth correction, mask, region and range; neither its
    tolerance nor its outlier section has a say.

    Parameters
    ----------
    preset : Preset
    rig : Rig
    settings : CalibratedSettings, optional

    Raises
    ------
    RigMismatchError
        As `ContactPipeline` does.
    """

    name = "fusion-calibrated"

    def __init__(self, preset: Preset, rig: Rig, settings: CalibratedSettings | None = None) -> None:
        check_rig(preset, rig)
        self._rig, self._mask, self.settings = rig, preset.mask, settings or CalibratedSettings()
        rigid = preset.with_values({"alignment.model": "rigid"})
        self._alignment = make_alignment(rigid.alignment, rig)
        self._region = region_bounds(preset.region, rig.proximity.intrinsics.shape)
        self._near_m, self._far_m = (float(limit) for limit in depth_limits(preset.range, preset.tolerance)[:2])
        self._rays = ray_table(rig.proximity.intrinsics)

    def find(self, frame: SensorFrame) -> MethodPatch:
        """Return the pixels in contact, their points on the surface that both cameras have measured."""
        frame.check_against(self._rig)
        shape = frame.proximity_depth.shape
        difference, usable, bias_m = self._differences(frame)
        if not usable.any():
            return failed(shape, "")
        cut = self._surroundings(usable)
        depth = frame.proximity_depth[cut] * np.float32(self._rig.proximity.depth_unit_m)
        contact = self._contact(difference[cut], usable[cut], depth, bias_m, cut)
        contact, depth = self._surface(contact, usable[cut], depth, difference[cut])
        z = depth[contact][:, None]
        points = np.concatenate([self._rays[cut][contact] * z, z], axis=1)

        def mask() -> BoolArray:
            whole = np.zeros(shape, bool)
            whole[cut] = contact
            return whole

        return MethodPatch(points, mask)

    def _differences(self, frame: SensorFrame) -> tuple[Float32Array, BoolArray, float]:
        """Return proximity less tactile depth, which pixels to use, and the bias that prints tell."""
        aligned = self._alignment.align(frame.proximity_depth, frame.tactile_depth, self._region)
        difference = aligned.expected_m - aligned.measured_m
        usable = np.abs(difference) < self.settings.difference_m
        pixels = np.flatnonzero(usable)
        points = deproject(frame.proximity_depth, self._rig.proximity, pixels)
        kept = (points[:, 2] >= self._near_m) & (points[:, 2] <= self._far_m)
        bias_m = 0.0
        if self._mask.enabled:
            colors, seen = colors_at(points, pixels, frame.proximity_color, self._rig)
            printed = in_hsv_range(colors, self._mask)
            kept &= seen & ~printed
            if self.settings.bias_m > 0:
                bias_m = print_bias_m(difference.reshape(-1)[pixels[printed & seen]])
        usable.reshape(-1)[pixels] = kept
        return difference, usable, bias_m

    def _surroundings(self, usable: BoolArray) -> tuple[slice, slice]:
        """Return the rectangle that holds all usable pixels and the windows about them."""
        margin = int(np.ceil(2 * max(self.settings.window_px, self.settings.smooth_px))) + 1
        return (_reach(usable.any(axis=1), margin), _reach(usable.any(axis=0), margin))

    def _contact(
        self, difference: Float32Array, usable: BoolArray, depth: Float32Array, bias_m: float, cut: tuple[slice, slice]
    ) -> BoolArray:
        s, camera = self.settings, self._rig.proximity.intrinsics
        gap, share = local_mean(np.where(usable, difference - np.float32(bias_m), np.float32(0)), usable, s.window_px)
        known = share > s.least_share
        if s.bias_m > 0:
            # half of it: with little contact the most frequent gap is not that of contact
            gap -= np.float32(contact_bias_m(gap[known], s.bias_m) / 2)
        if s.slope:
            smooth, _ = local_mean(depth, usable, max(s.window_px, 1.0))
            gap *= facing(smooth, self._rays[cut], (camera.fx, camera.fy))
        near = known & (gap < s.gap_m)
        if s.retreat > 0:
            near = retreat(near, known, gap, s.gap_m, s.retreat, s.core, s.most_px)
        return drop_small(near, depth, 1.0 / (camera.fx * camera.fy), s.least_area_mm2)

    def _surface(
        self, contact: BoolArray, usable: BoolArray, depth: Float32Array, difference: Float32Array
    ) -> tuple[BoolArray, Float32Array]:
        """Return the contact that has a depth, and the depth, fused from both sensors and smoothed."""
        measured = contact & usable
        fused = np.where(measured, depth - np.float32(self.settings.tactile_weight) * difference, np.float32(0))
        smooth, share = local_mean(fused, measured, self.settings.smooth_px)
        return contact & (share > 0.05), smooth


def _reach(used: npt.ArrayLike, margin: int) -> slice:
    places = np.flatnonzero(used)
    return slice(max(int(places[0]) - margin, 0), int(places[-1]) + 1 + margin)
