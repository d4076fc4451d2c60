"""The membrane test, step by step: differences and bias, equilibrium, groups, points."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import numpy as np

from ...model.arrays import BoolArray, Float32Array, Uint8Array
from ...model.frames import Rig, SensorFrame
from ...model.patch import NO_CANDIDATES, Candidates, Found, Lazy, MembraneFacts
from ...model.provenance import Provenance
from ...preset import MembraneSection, Preset
from ...preset.membrane import LARGEST_BIAS_M, NEAR_GAP_M
from ..alignment import AlignmentModel, make_alignment
from ..finder import MAX_TILES_ALONE, ContactFinder, Steps, Workspace, depth_images
from ..kernels import membrane as kernels
from ..kernels.cells import MembraneImage
from ..kernels.chain import TILE_ROWS, flat
from ..kernels.simd import LANES
from ..kernels.threads import by_rows
from .bias import COARSE_CELL_PX, FrameBias, frame_bias, rig_bias
from .cells import CELL_PX, FAR_M, INNER, Cells, cells_of, to_pixels
from .differences import Differences, large_contacts, surface_points, surroundings
from .equilibrium import Equilibrium, settle
from .tension import measured_curvature_per_m, usable_curvature_per_m

#: Largest difference that takes part in the search for the bias, and in the equilibrium, metres.
_WIDE_M: Final = np.float32(LARGEST_BIAS_M + 0.015)
_NEAR_M: Final = 0.008
#: Differences are aligned again for a bias that is larger, metres: it displaces the tactile pixel by a quarter pixel.
_ALIGN_ANEW_M: Final = 0.001
#: A measured gap is certainly larger than the largest gap if it exceeds it by this number of standard deviations of the
#: noise, and by the errors of the model, metres.
_CERTAIN, _MODEL_ERROR_M = 3.0, 0.0003
_NOTHING: Final = np.empty(0, np.float32)
#: A membrane is not nearer to the camera, metres.
_NEAREST_M: Final = 0.1


class MembraneFinder(ContactFinder):
    """Computes the membrane test, only in image tiles where both depths can be near each other.

    Attributes
    ----------
    bias : FrameBias
        That of the last frame, beyond the bias of its differences.
    rig_bias : RigBias
        What is known of the rig.
    """

    bias: FrameBias
    _differences: Differences | None
    _measured_per_m: float
    _free_per_m: float
    _cells: Cells | None
    _solution: Equilibrium
    _touching: BoolArray
    _large: BoolArray
    _contact: Candidates

    def __init__(self, preset: Preset, rig: Rig, alignment: AlignmentModel, workspace: Workspace | None = None) -> None:
        super().__init__(preset, rig, alignment, workspace)
        self._exact = self.test.limits._replace(tolerance=np.float32(0))
        # with an infinite tolerance, CONTACT in the base class's `classify` means that there are both depths
        self.test = self.test._replace(limits=self._exact._replace(tolerance=np.float32(np.inf)))
        self._depth_unit_m = np.float32(rig.proximity.depth_unit_m)
        self.rig_bias = rig_bias(preset, rig)

    def find(self, frame: SensorFrame, preset: Preset, due: Steps) -> Found:
        """Return the contact in a frame."""
        section, rig = preset.membrane, self._rig
        if due("fusion"):
            self._differences = self.differences(frame, preset)
        if (differences := self._differences) is None:
            return Found(NO_CANDIDATES, lambda: self.classify(frame), ("no candidates",))
        if due("equilibrium"):
            near_m = self.bias.bias_m, _NEAR_M
            membrane = self.membrane_image(frame)
            self._cells = cells_of(differences, membrane, CELL_PX, section.shape_px, self._free_per_m, near_m, rig)
            if self._cells is not None:
                self._solution = settle(self._cells, self.bias.bias_m, self.rig_bias.length_m(section.trust_m))
        if (cells := self._cells) is None:
            return Found(NO_CANDIDATES, lambda: self.classify(frame), ("no candidates",))
        if due("edge"):
            self._touching = self._within_edge(cells, section.gap_m, differences)
        if due("clusters"):
            self._large = large_contacts(self._touching, differences, section, rig)
        if due("points"):
            weight = self.rig_bias.tactile_weight
            self._contact = surface_points(
                self._large, differences, self.bias.bias_m, weight, rig, self._workspace.buffers
            )
        found = cells, self._solution, self._touching, self._large, self._contact
        facts = self._facts(differences, cells)
        return Found(self._contact, lambda: full_provenance(self.classify(frame), differences, *found), membrane=facts)

    def differences(self, frame: SensorFrame, preset: Preset) -> Differences | None:
        """Return the differences of both depths, and find the bias; None if too few pixels are usable for contact."""
        section = preset.membrane
        bias_m = self.rig_bias.mean_m if section.bias else 0.0
        self.bias = FrameBias()
        found = self._differences_at(frame, bias_m, _WIDE_M if section.bias else np.float32(_NEAR_M), section)
        if found is None:
            return None
        self._measured_per_m = measured_curvature_per_m(frame, preset.alignment, self._rig)
        self._free_per_m = usable_curvature_per_m(self._measured_per_m)
        if not section.bias:
            return found
        membrane = self.membrane_image(frame)
        self.bias, near = frame_bias(found, membrane, self.rig_bias, self._free_per_m, self._rig)
        if abs(self.bias.bias_m) <= _ALIGN_ANEW_M:
            return near
        found = self._differences_at(frame, bias_m + self.bias.bias_m, _WIDE_M, section)
        firm, self.bias = self.bias.firm_m2 > 0, FrameBias(known=self.bias.known)
        if found is None:
            return None
        if firm:
            refined, near = frame_bias(found, membrane, self.rig_bias, self._free_per_m, self._rig)
            if refined.firm_m2 > 0:
                self.bias = refined
                return near
        return found

    def membrane_image(self, frame: SensorFrame) -> MembraneImage:
        """Return the tactile depth image with its alignment, for the kernels."""
        return MembraneImage(flat(frame.tactile_depth), self.alignment.tables)

    def _facts(self, differences: Differences, cells: Cells) -> MembraneFacts:
        """Return what was measured besides contact, for messages."""
        bias, solution, contact = self.bias, self._solution, self._contact
        shape = self._rig.proximity.intrinsics.shape
        return MembraneFacts(
            bias_m=differences.bias_m + bias.bias_m,
            firm_m2=bias.firm_m2,
            bias_known=bias.known,
            curvature_per_m=self._measured_per_m,
            used_curvature_per_m=self._free_per_m,
            gap_m=Lazy(lambda: gap_image(differences, cells, solution, shape)),
            difference_m=Lazy(lambda: differences_at(contact, differences, bias.bias_m, shape[1])),
            tactile_weight=self.rig_bias.tactile_weight,
        )

    def _within_edge(self, cells: Cells, gap_m: float, differences: Differences) -> BoolArray:
        """Return the pixels whose gap in equilibrium is small, unless the measured one is certainly larger.

        Where the object ends, cells are cut by their pixels: those that do not measure a small gap do not count.
        """
        touching = np.zeros_like(differences.usable)
        certain_m = gap_m + max(_CERTAIN * self.rig_bias.gap_sigma_m, _MODEL_ERROR_M)
        gap = np.where(self._solution.guess_m > np.float32(certain_m), FAR_M, self._solution.gap_m)
        box = surroundings((gap <= np.float32(gap_m))[INNER], 2)
        if box is None:
            return touching
        # between cells that are not near no pixel is: interpolate only around the near ones
        rows, columns = (slice(CELL_PX * side.start, CELL_PX * side.stop) for side in box)
        usable, difference = differences.usable[rows, columns], differences.difference_m[rows, columns]
        gap, border = to_pixels(cells, gap, usable.shape, box)
        largest = np.float32(gap_m + max(_CERTAIN * self.rig_bias.pixel_sigma_m, _MODEL_ERROR_M))
        near = usable & (np.abs(difference - np.float32(self.bias.bias_m)) < largest)
        touching[rows, columns] = (gap <= np.float32(gap_m)) & (near | ~border)
        return touching & ~differences.excluded

    def classify(self, frame: SensorFrame) -> Uint8Array:
        """Return each pixel's verdict of depth, region, range, difference and colour; usable pixels have CONTACT."""
        verdicts = super().classify(frame)
        height, width = verdicts.shape
        every_tile = np.ones(self.coarse.shape, np.bool_)  # not the pipeline's own, which other threads may be using
        _, state = self._look(frame, every_tile, (0, 0, width, height), self.rig_bias.mean_m, _WIDE_M, in_parallel=True)
        verdicts[verdicts == Provenance.CONTACT] = Provenance.OUTSIDE_TOLERANCE
        verdicts[state == kernels.MASKED] = Provenance.MASKED
        return verdicts

    def _differences_at(
        self, frame: SensorFrame, bias_m: float, largest_m: np.float32, section: MembraneSection
    ) -> Differences | None:
        """Return the differences of both depths with a bias subtracted; None if less is usable than a contact."""
        tiles, possible = self.coarse.tiles(depth_images(frame), self._exact, float(largest_m) + abs(bias_m))
        if possible == 0:
            return None
        (top, bottom), (left, right) = self._rectangle(tiles)
        rectangle = left, top, right, bottom
        parallel = possible > MAX_TILES_ALONE
        difference, state = self._look(frame, tiles, rectangle, bias_m, largest_m, in_parallel=parallel)
        usable = state == kernels.USABLE
        found = Differences(
            (slice(top, bottom), slice(left, right)),
            difference,
            frame.proximity_depth[top:bottom, left:right].copy(),
            self._depth_unit_m,
            usable,
            state == kernels.EXCLUDED,
            bias_m,
            _NOTHING if self.rig_bias.measured else difference[state == kernels.MASKED],
        )
        return None if self._too_few(found, section.min_area_mm2) else found

    def _too_few(self, differences: Differences, min_area_mm2: float) -> bool:
        """Return whether the usable pixels together are smaller than the smallest contact."""
        camera, count = self._rig.proximity.intrinsics, int(np.count_nonzero(differences.usable))
        pixels = 1e-6 * min_area_mm2 * camera.fx * camera.fy  # at a depth of 1 m
        if count * _NEAREST_M**2 > pixels:
            return False
        farthest = differences.counts[differences.usable].max(initial=0)
        return count == 0 or count * float(differences.depth_m(farthest)) ** 2 < pixels

    def _look(
        self,
        frame: SensorFrame,
        tiles: BoolArray,
        rectangle: tuple[int, int, int, int],
        bias_m: float,
        largest_m: np.float32,
        *,
        in_parallel: bool,
    ) -> tuple[Float32Array, Uint8Array]:
        """Return differences and states in a rectangle: left, top, right and bottom."""
        left, top, right, bottom = rectangle
        shape = bottom - top, right - left
        difference, state = np.empty(shape, np.float32), np.empty(shape, np.uint8)
        images, color = depth_images(frame), self.color_test(frame)
        part = kernels.Rectangle(left, top, right, np.float32(bias_m), largest_m)
        out = kernels.DifferenceImages(difference.reshape(-1), state.reshape(-1))

        def look_at_rows(first: int, last: int) -> None:
            kernels.find_differences(images, self.test, color, tiles, part, top + first, top + last, out)

        if in_parallel:
            by_rows(look_at_rows, bottom - top)
        else:
            look_at_rows(0, bottom - top)
        return difference, state

    def _rectangle(self, tiles: BoolArray) -> tuple[tuple[int, int], tuple[int, int]]:
        """Return first and last (exclusive) row and column of the possible tiles, with a margin of cells.

        It begins at multiples of all cells and tiles, so what lies elsewhere in the image does not shift the cells.
        """
        width, height, *_ = self.alignment.size
        bounds = []
        for axis, step, size in ((1, TILE_ROWS, height), (0, LANES, width)):
            used = np.flatnonzero(tiles.any(axis=axis))
            first = max(int(used[0]) * step - 2 * CELL_PX, 0)
            last = min((int(used[-1]) + 1) * step + 2 * CELL_PX, size)
            grid = math.lcm(step, CELL_PX, COARSE_CELL_PX)
            bounds.append((first // grid * grid, last))
        return bounds[0], bounds[1]


def full_provenance(
    verdicts: Uint8Array,
    differences: Differences,
    cells: Cells,
    solution: Equilibrium,
    touching: BoolArray,
    large: BoolArray,
    contact: Candidates,
) -> Uint8Array:
    """Write the verdicts of the equilibrium and later steps over those of `MembraneFinder.classify`."""
    part, usable = verdicts[differences.place], differences.usable
    guess = np.where(cells.known, solution.guess_m, np.float32(1))
    near = to_pixels(cells, guess.astype(np.float32), usable.shape)[0] < NEAR_GAP_M
    part[usable & near] = Provenance.RIM
    part[usable & touching] = Provenance.SMALL_CLUSTER
    part[usable & large] = Provenance.OUTLIER
    verdicts.reshape(-1)[contact.pixels] = Provenance.CONTACT
    return verdicts


def differences_at(contact: Candidates, differences: Differences, bias_m: float, width: int) -> Float32Array:
    """Return the difference of both depths at each contact pixel, less the bias; nan where a depth is missing."""
    rows, here = contact.pixels // width, differences.usable.shape[1]
    (top, left) = differences.corner
    place = contact.pixels - rows * (width - here) - (top * here + left)
    measured = np.where(differences.usable, differences.difference_m, np.float32(np.nan)).reshape(-1)[place]
    return np.asarray(measured - np.float32(bias_m))


def gap_image(differences: Differences, cells: Cells, solution: Equilibrium, shape: tuple[int, int]) -> Float32Array:
    """Return the gap in equilibrium at each pixel of an image of this shape; nan where it is not computed."""
    gap = np.full(shape, np.nan, np.float32)
    within = to_pixels(cells, solution.gap_m, differences.usable.shape)[0]
    gap[differences.place] = np.where(within < FAR_M, within, np.float32(np.nan))
    return gap


def firm_contact_bias(preset: Preset, rig: Rig) -> Callable[[SensorFrame], tuple[float, float] | None]:
    """Return a function that measures the bias in a frame where an object is pressed firmly into the membrane.

    It returns the bias, proximity less tactile depth after the alignment's depth correction, in metres, and the area of
    contact that proves it, in square metres; None without such contact.
    """
    plain = preset.with_values({"contact_test": "membrane", "membrane.bias": True}).model_copy(update={"noise": None})
    finder = MembraneFinder(plain, rig, make_alignment(plain.alignment, rig))

    def measure(frame: SensorFrame) -> tuple[float, float] | None:
        differences = finder.differences(frame, plain)
        if differences is None or finder.bias.firm_m2 == 0:
            return None
        return differences.bias_m + finder.bias.bias_m, finder.bias.firm_m2

    return measure
