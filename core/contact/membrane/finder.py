"""The membrane test, step by step: differences, mean gaps, edge, press, balance, groups, points."""

from __future__ import annotations

import numpy as np

from ...model.arrays import BoolArray, Float32Array, Uint8Array
from ...model.frames import Rig, SensorFrame
from ...model.patch import NO_CANDIDATES, Candidates, Found
from ...model.provenance import Provenance
from ...preset import MembraneSection, Preset
from ..alignment import AlignmentModel
from ..finder import MAX_TILES_ALONE, ContactFinder, Steps, Workspace, depth_images
from ..kernels import membrane as kernels
from ..kernels.chain import TILE_ROWS
from ..kernels.simd import LANES
from ..kernels.threads import by_rows
from .balance import balanced_contact
from .gaps import (
    Differences,
    Gaps,
    large_contacts,
    mean_gaps,
    near_pixels,
    print_bias_m,
    surface_points,
    surroundings,
    window_reach,
    within_edge,
)
from .press import Pressed, pressed_contact


class MembraneFinder(ContactFinder):
    """Computes the membrane test, only in image tiles where both depths can be near each other."""

    _differences: Differences | None
    _gaps: Gaps | None
    _within: BoolArray
    _pressed: Pressed
    _balanced: BoolArray
    _large: BoolArray
    _contact: Candidates

    def __init__(self, preset: Preset, rig: Rig, alignment: AlignmentModel, workspace: Workspace | None = None) -> None:
        super().__init__(preset, rig, alignment, workspace)
        self._exact = self.test.limits._replace(tolerance=np.float32(0))
        # with an infinite tolerance, CONTACT in the base class's `classify` means that there are both depths
        self.test = self.test._replace(limits=self._exact._replace(tolerance=np.float32(np.inf)))
        section = preset.membrane
        self._max_m = np.float32(section.difference_m)
        self._margin = window_reach(section.window_reach_px) + 1
        self._depth_unit_m = np.float32(rig.proximity.depth_unit_m)

    def find(self, frame: SensorFrame, preset: Preset, due: Steps) -> Found:
        """Return the contact in a frame."""
        section, rig = preset.membrane, self._rig
        if due("fusion"):
            self._differences = self.differences(frame)
        if (differences := self._differences) is None:
            return Found(NO_CANDIDATES, lambda: self.classify(frame), ("no candidates",))
        if due("gaps"):
            self._gaps = mean_gaps(differences, section, rig)
        if (gaps := self._gaps) is None:
            return Found(NO_CANDIDATES, lambda: early_provenance(self.classify(frame), differences), ("no candidates",))
        if due("edge"):
            self._within = within_edge(gaps, section)
        if due("press"):
            self._pressed = pressed_contact(self._within, gaps, frame, preset, rig, self.alignment)
        if due("balance"):
            self._balanced = balanced_contact(self._pressed, gaps, section, rig)
        if due("clusters"):
            self._large = large_contacts(self._balanced, gaps, section, rig)
        if due("points"):
            self._contact = surface_points(self._large, gaps, section, rig, self._workspace.buffers)
        steps = self._within, self._pressed.contact, self._balanced, self._large, self._contact
        return Found(self._contact, lambda: full_provenance(self.classify(frame), differences, gaps, section, *steps))

    def differences(self, frame: SensorFrame) -> Differences | None:
        """Return the differences of both depths; None if no pixel is usable."""
        tiles, possible = self.coarse.tiles(depth_images(frame), self._exact, float(self._max_m))
        if possible == 0:
            return None
        (top, bottom), (left, right) = self._rectangle(tiles)
        difference, state = self._look(frame, tiles, (left, top, right, bottom), in_parallel=possible > MAX_TILES_ALONE)
        everywhere = Differences(
            (slice(top, bottom), slice(left, right)),
            difference,
            frame.proximity_depth[top:bottom, left:right] * self._depth_unit_m,
            state == kernels.USABLE,
            state == kernels.EXCLUDED,
            print_bias_m(difference[state == kernels.MASKED]),
        )
        part = surroundings(everywhere.usable, self._margin)
        return None if part is None else everywhere.cut(part)

    def classify(self, frame: SensorFrame) -> Uint8Array:
        """Return each pixel's verdict of depth, region, range, difference and colour; usable pixels have CONTACT."""
        verdicts = super().classify(frame)
        height, width = verdicts.shape
        every_tile = np.ones(self.coarse.shape, np.bool_)  # not the pipeline's own, which other threads may be using
        _, state = self._look(frame, every_tile, (0, 0, width, height), in_parallel=True)
        verdicts[verdicts == Provenance.CONTACT] = Provenance.OUTSIDE_TOLERANCE
        verdicts[state == kernels.MASKED] = Provenance.MASKED
        verdicts[state == kernels.USABLE] = Provenance.CONTACT
        return verdicts

    def _look(
        self, frame: SensorFrame, tiles: BoolArray, rectangle: tuple[int, int, int, int], *, in_parallel: bool
    ) -> tuple[Float32Array, Uint8Array]:
        """Return differences and states in a rectangle: left, top, right and bottom."""
        left, top, right, bottom = rectangle
        shape = bottom - top, right - left
        difference, state = np.empty(shape, np.float32), np.empty(shape, np.uint8)
        images, color = depth_images(frame), self.color_test(frame)
        part = kernels.Rectangle(left, top, right, self._max_m)
        out = kernels.DifferenceImages(difference.reshape(-1), state.reshape(-1))

        def look_at_rows(first: int, last: int) -> None:
            kernels.find_differences(images, self.test, color, tiles, part, top + first, top + last, out)

        if in_parallel:
            by_rows(look_at_rows, bottom - top)
        else:
            look_at_rows(0, bottom - top)
        return difference, state

    def _rectangle(self, tiles: BoolArray) -> tuple[tuple[int, int], tuple[int, int]]:
        """Return first and last (exclusive) row and column of the possible tiles and the windows about them."""
        width, height, *_ = self.alignment.size
        bounds = []
        for axis, step, size in ((1, TILE_ROWS, height), (0, LANES, width)):
            used = np.flatnonzero(tiles.any(axis=axis))
            first = max(int(used[0]) * step - self._margin, 0)
            last = min((int(used[-1]) + 1) * step + self._margin, size)
            bounds.append((first // step * step, last))
        return bounds[0], bounds[1]


def early_provenance(verdicts: Uint8Array, everywhere: Differences) -> Uint8Array:
    """Write over the verdicts of `MembraneFinder.classify` that no window has enough usable pixels."""
    verdicts[everywhere.place][everywhere.usable] = Provenance.OUTLIER
    return verdicts


def full_provenance(
    verdicts: Uint8Array,
    everywhere: Differences,
    gaps: Gaps,
    section: MembraneSection,
    within: BoolArray,
    pressed: BoolArray,
    balanced: BoolArray,
    large: BoolArray,
    contact: Candidates,
) -> Uint8Array:
    """Write the verdicts of the later steps over those of `MembraneFinder.classify`."""
    early_provenance(verdicts, everywhere)
    part, usable = verdicts[gaps.differences.place], gaps.differences.usable
    part[usable & gaps.known] = Provenance.OUTSIDE_TOLERANCE
    part[usable & near_pixels(gaps, section)] = Provenance.RIM
    part[usable & within] = Provenance.NOT_PRESSED
    part[usable & pressed] = Provenance.RIM
    part[usable & balanced] = Provenance.SMALL_CLUSTER
    part[usable & large] = Provenance.OUTLIER
    verdicts.reshape(-1)[contact.pixels] = Provenance.CONTACT
    return verdicts
