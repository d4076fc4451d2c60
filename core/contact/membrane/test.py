"""The membrane test: contact is where a membrane in equilibrium of tension and pressure touches the object.

Its steps are in `steps`; `equilibrium` explains the physics, `frame_bias` the bias between the cameras.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from ...model.frames import SensorFrame
from ...model.patch import NO_CANDIDATES, Candidates, Found, Provenance
from ..contact_test import HARMLESS_SHARE, MASK_REASON, PIXEL_FIELDS, BiasLimits, ContactTest, DropReason, Steps
from ..dents import Dents
from .section import LARGEST_BIAS_M, NEAR_GAP_M, MembraneSection

if TYPE_CHECKING:
    from ...model.arrays import BoolArray
    from ...preset import Preset
    from .equilibrium import Cells, Equilibrium
    from .steps import Measured


class MembraneTest(ContactTest):
    """Contact where a membrane in equilibrium touches the object."""

    name = "membrane"
    sections = {"membrane": MembraneSection}
    steps = {
        "fusion": (*PIXEL_FIELDS, "noise", "membrane.bias"),
        "equilibrium": ("membrane.trust_m", "membrane.shape_px"),
        "edge": ("membrane.gap_m",),
        "clusters": ("membrane.min_area_mm2",),
        "points": (),
    }
    summary = "the equilibrium of tension and pressure tells where the membrane leaves the object, also in noise."
    note = "By the membrane's equilibrium. Tolerance and Outliers are ignored."
    smallest_field = "membrane.min_area_mm2"
    looser_words = "raise the largest gap"
    drop_reasons = {
        Provenance.MASKED: MASK_REASON,
        Provenance.RIM: DropReason("the membrane's equilibrium", "measure the rig's bias (F6)", "measure_noise"),
        Provenance.SMALL_CLUSTER: DropReason("the limit on small contacts", "lower the smallest contact"),
    }
    frames_field = "membrane.frames"
    unmasked_note = (
        "uses the membrane test without the mask, so parts of the membrane that reflect infrared, such as prints, "
        "pass as contact; set mask.hue, mask.saturation and mask.value to their colour."
    )
    homography_note = (
        "judges gaps of a millimetre, which a homography resolves on one plane only; choose the rigid "
        "alignment, or the tolerance test."
    )
    moves_points = True

    _measured: Measured | None
    _cells: Cells | None
    _found: Equilibrium  # For the bias of the frame
    _solution: Equilibrium  # With missed parts
    _touching: BoolArray
    _large: BoolArray
    _contact: Candidates

    def find(self, frame: SensorFrame, preset: Preset, due: Steps) -> Found:
        from . import steps
        from .equilibrium import settle

        pixels, section = self.pixels, preset.membrane
        if due("fusion"):
            self._measured = steps.measure(frame, preset, pixels)
        measured = self._measured
        if due("equilibrium"):
            self._cells = None if measured is None else steps.measured_cells(measured, frame, section, pixels)
            if measured is not None and self._cells is not None:
                trust_m = measured.known.length_m(section.trust_m)
                self._found = settle(self._cells, measured.bias.bias_m, trust_m)
        if measured is None or (cells := self._cells) is None:
            return Found(NO_CANDIDATES, lambda: steps.classify(frame, preset, pixels), ("no candidates",))
        if due("edge"):
            self._solution = self._found
            if pixels.untouched is not None:  # else no dent is known
                dents = Dents(pixels, frame, pixels.untouched)
                is_dented = partial(steps.is_dented, measured, dents, preset.noise, pixels.rig)
                self._solution = steps.with_missed_parts(self._found, cells, measured, section, is_dented)
            self._touching = steps.within_edge(cells, self._solution, section.gap_m, measured)
        if due("clusters"):
            self._large = steps.large_contacts(self._touching, measured.differences, section.min_area_mm2, pixels.rig)
        if due("points"):
            self._contact = steps.surface_points(self._large, measured, pixels)
        touching, large, contact, solution = self._touching, self._large, self._contact, self._solution
        return Found(
            contact,
            lambda: steps.provenance(frame, preset, pixels, measured, cells, solution, touching, large, contact),
            membrane=steps.facts(measured, cells, solution, self._found, section.gap_m, contact, pixels.rig),
        )

    @classmethod
    def accepted_share(cls, preset: Preset, distance_m: float) -> float:
        """Return the gap that counts as near the object over the distance."""
        return float(f"{NEAR_GAP_M / distance_m:.2g}") if distance_m > 0 else 0.0

    @classmethod
    def bias_limits(cls, preset: Preset, distance_m: float) -> BiasLimits:
        """Return what the test corrects in firm contact, or what still leaves contact without a correction."""
        if preset.membrane.bias:
            return BiasLimits(LARGEST_BIAS_M, LARGEST_BIAS_M)
        return BiasLimits(HARMLESS_SHARE * NEAR_GAP_M, NEAR_GAP_M)
