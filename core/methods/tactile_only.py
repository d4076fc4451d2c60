"""Contact from the tactile camera alone: the most deformed part of the membrane."""

from __future__ import annotations

from functools import partial
from typing import Literal

import numpy as np

from ..model.arrays import BoolArray, Uint16Array
from ..model.clouds import valid_depth
from ..model.frames import Rig, SensorFrame
from ..preset import Preset
from .membrane_view import MembraneView
from .method import ContactMethod, MethodKind, MethodPatch

Rule = Literal["share", "threshold"]


class TactileOnly(ContactMethod):
    """The most deformed points of the membrane.

    Parameters
    ----------
    preset : Preset
        Gives the pose that transforms tactile points to the proximity frame.
    rig : Rig
    untouched : SensorFrame
        The untouched membrane.
    share : float
        With ``rule="share"``: the share of the deformed points that is contact, the most deformed
        first; the paper uses 0.6.
    threshold_m : float
        With ``rule="threshold"``: the deformation above which a point is contact.
    noise_m : float
        Deformation below which a point counts as untouched.

    References
    ----------
    Yin et al., "Proximity and Visuotactile Point Cloud Fusion for Contact Patches in Extreme
    Deformation", the tactile-only baseline.
    """

    def __init__(
        self,
        preset: Preset,
        rig: Rig,
        untouched: SensorFrame,
        rule: Rule = "share",
        share: float = 0.6,
        threshold_m: float = 0.005,
        noise_m: float = 0.0015,
    ) -> None:
        untouched.check_against(rig)
        self.name = "tactile-only" if rule == "share" else "tactile-threshold"
        self._rig, self._rule, self._share = rig, rule, share
        self._threshold_m, self._noise_m = threshold_m, noise_m
        self._factor = rig.tactile.depth_unit_m * preset.alignment.depth_scale
        self._view = MembraneView(preset.alignment, rig)
        counts = untouched.tactile_depth
        self._untouched_m = np.where(valid_depth(counts), counts * self._factor, np.nan)

    def find(self, frame: SensorFrame) -> MethodPatch:
        """Return the most deformed points."""
        frame.check_against(self._rig)
        counts = frame.tactile_depth
        contact = self.contact(counts)
        return MethodPatch(self._view.points(contact, counts), lambda: self._view.pick(contact, counts))

    def contact(self, counts: Uint16Array) -> BoolArray:
        """Return which tactile pixels are contact, bool, shape (Ht, Wt)."""
        with np.errstate(invalid="ignore"):
            deformation_m = np.where(valid_depth(counts), self._untouched_m - counts * self._factor, np.nan)
            deformed = deformation_m > self._noise_m
            if not deformed.any():
                return deformed
            least_m = self._threshold_m
            if self._rule == "share":
                least_m = float(np.quantile(deformation_m[deformed], 1.0 - self._share))
            return deformed & (deformation_m >= least_m)


def _make(rule: Rule, preset: Preset, rig: Rig, untouched: SensorFrame | None) -> ContactMethod:
    assert untouched is not None  # `make_method` has checked
    return TactileOnly(preset, rig, untouched, rule)


SHARE = MethodKind(
    "tactile-only",
    "Tactile camera: the 60 % of the deformed membrane that moved most",
    (86, 180, 233),
    partial(_make, "share"),
    needs_untouched=True,
    rank=11,
)
THRESHOLD = MethodKind(
    "tactile-threshold",
    "Tactile camera: parts that moved by more than 5 mm",
    (105, 60, 90),
    partial(_make, "threshold"),
    needs_untouched=True,
    dark_rgb=(240, 228, 66),  # plum is hard to see on a dark background, yellow on a light one
    rank=12,
)
