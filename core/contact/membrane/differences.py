"""Where both depths of a frame are near each other: the first stage of the membrane contact test."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...model.arrays import BoolArray, Float32Array, Uint8Array
from ...model.frames import Rig, SensorFrame
from ...model.provenance import Provenance
from ...preset import Preset
from ..alignment import AlignmentModel
from ..candidates import PixelTests, depth_images
from ..kernels import membrane as kernels
from ..kernels.chain import TILE_ROWS
from ..kernels.simd import LANES
from ..kernels.threads import by_rows
from .steps import print_bias_m, surroundings, window_reach

#: So few tiles are not worth waking other threads for.
_TILES_ALONE = 300


@dataclass(frozen=True, eq=False)
class Differences:
    """Both depths in the rectangle that holds all usable pixels and the windows about them; images are (H, W).

    Attributes
    ----------
    place : tuple of slice
        Rows and columns of the rectangle.
    difference_m : float32
        Proximity less tactile depth; 0 where it is too large.
    depth_m : float32
        Proximity depth.
    usable : bool
        Both depths, less than the largest difference between them, and not of the bare membrane's colour.
    excluded : bool
        Outside the region or range.
    print_bias_m : float
        The bias between both sensors that prints of that colour tell.
    """

    place: tuple[slice, slice]
    difference_m: Float32Array
    depth_m: Float32Array
    usable: BoolArray
    excluded: BoolArray
    print_bias_m: float

    @property
    def corner(self) -> tuple[int, int]:
        """Row and column at which the rectangle begins."""
        return self.place[0].start, self.place[1].start

    def cut(self, part: tuple[slice, slice]) -> Differences:
        """Return the same for a part of the rectangle."""
        (top, left), (rows, columns) = self.corner, part
        return Differences(
            (slice(top + rows.start, top + rows.stop), slice(left + columns.start, left + columns.stop)),
            np.ascontiguousarray(self.difference_m[part]),
            np.ascontiguousarray(self.depth_m[part]),
            np.ascontiguousarray(self.usable[part]),
            np.ascontiguousarray(self.excluded[part]),
            self.print_bias_m,
        )


class DifferenceFinder(PixelTests):
    """Finds where both depths are near each other, looking only at tiles where they can be."""

    def __init__(self, preset: Preset, rig: Rig, alignment: AlignmentModel) -> None:
        super().__init__(preset, rig, alignment)
        self._exact = self.test.limits._replace(tolerance=np.float32(0))
        # with an infinite tolerance, CONTACT in `classify` means that there are both depths
        self.test = self.test._replace(limits=self._exact._replace(tolerance=np.float32(np.inf)))
        section = preset.membrane
        self._most_m = np.float32(section.difference_m)
        self._margin = window_reach(max(section.window_px, section.smooth_px)) + 1
        self._depth_unit_m = np.float32(rig.proximity.depth_unit_m)

    def find(self, frame: SensorFrame) -> Differences | None:
        """Return the differences; None where no pixel is usable."""
        tiles, possible = self.coarse.tiles(depth_images(frame), self._exact, float(self._most_m))
        if possible == 0:
            return None
        (top, bottom), (left, right) = self._rectangle(tiles)
        difference, state = self._look(frame, tiles, (left, top, right, bottom), in_parallel=possible > _TILES_ALONE)
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
        part = kernels.Rectangle(left, top, right, self._most_m)
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
