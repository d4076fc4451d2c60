"""What a contact test knows of each proximity pixel: both aligned depths, region, range, and the colour mask.

The mask covers parts of the membrane that reflect infrared, such as prints; they are no contact.
"""

from __future__ import annotations

from functools import lru_cache, partial
from typing import TYPE_CHECKING, Final

import numpy as np

from ..model.arrays import BoolArray, Float32Array, IndexArray, Uint8Array
from ..model.clouds import ray_table, valid_depth
from ..model.frames import Rig, SensorFrame
from ..model.intrinsics import Intrinsics
from ..model.patch import NO_CANDIDATES, AlignedDepth, Candidates, Provenance
from ..model.sections import RegionSection
from .alignment import AlignmentModel
from .kernels import tolerance as kernels
from .kernels.coarse import CoarseTest
from .kernels.colors import color_lookup, hsv_limits
from .kernels.lenses import lens_parameters
from .kernels.simd import LANES
from .kernels.threads import ROWS, in_parallel
from .kernels.tolerance import ColorLookup
from .masking import Light
from .outliers.grid import Grid

if TYPE_CHECKING:
    from ..preset import Preset

#: Below this number of image tiles, one thread is faster than several.
MAX_TILES_ALONE: Final = 300
_NO_LIMITS = np.empty(0, np.int64)


def colors_at(points: Float32Array, pixels: IndexArray, image: Uint8Array, rig: Rig) -> tuple[Uint8Array, BoolArray]:
    """Return the colours of points (N, 3) with flat depth pixels ``pixels``, and which the colour camera sees."""
    if rig.proximity_color is None:
        return image.reshape(-1, 3)[pixels], np.ones(len(pixels), bool)
    T_c_d = np.asarray(rig.proximity_color.T_color_depth, dtype=np.float32)
    rotation, translation = np.ascontiguousarray(T_c_d[:3, :3]), np.ascontiguousarray(T_c_d[:3, 3])
    colors, seen = np.zeros((len(points), 3), np.uint8), np.empty(len(points), bool)
    color_lookup(
        points, rotation, translation, *lens_parameters(rig.proximity_color.intrinsics), image, colors, seen
    )  # fmt: skip
    return colors, seen


def color_lookup_of(rig: Rig) -> ColorLookup:
    """Return where the colour of a proximity point is looked up."""
    if rig.proximity_color is None:
        lens = rig.proximity.intrinsics
        return ColorLookup(False, np.zeros(12, np.float32), 0, np.zeros(9, np.float32), lens.width, lens.height)
    T_c_d = np.asarray(rig.proximity_color.T_color_depth, dtype=np.float32)
    transform = np.concatenate([T_c_d[:3, :3].ravel(), T_c_d[:3, 3]])
    camera = rig.proximity_color.intrinsics
    return ColorLookup(True, transform, *lens_parameters(camera), camera.width, camera.height)


class Workspace:
    """What is kept when the preset changes: buffers for every pixel, and the cache of the outlier removal."""

    def __init__(self, rig: Rig) -> None:
        height, width = rig.proximity.intrinsics.shape
        self.pixels = np.empty(height * width, np.intp)
        self.points = np.empty((height * width, 3), np.float32)
        self.counts = np.empty(height, np.int64)
        self.grid = Grid(rig.proximity.intrinsics)

    def collect(self, places: list[slice]) -> Candidates:
        """Copy out the pixels and points that were written to these places."""
        if all(place.start == place.stop for place in places):
            return NO_CANDIDATES
        pixels, points = (np.concatenate([array[place] for place in places]) for array in (self.pixels, self.points))
        return Candidates(pixels, points)


class Pixels:
    """The proximity pixels as a preset's alignment, region, range and mask let a contact test see them."""

    def __init__(
        self,
        preset: Preset,
        rig: Rig,
        alignment: AlignmentModel,
        workspace: Workspace,
        untouched: SensorFrame | None = None,
    ) -> None:
        self.rig, self.alignment, self.workspace, self.untouched = rig, alignment, workspace, untouched
        self.coarse = CoarseTest(alignment.tables)  # Rules out image tiles in which the depths are far from each other
        near, far = preset.range.limits_m if preset.range.enabled else (0.0, np.inf)
        self.limits = kernels.DepthLimits(np.float32(near), np.float32(far), np.float32(0))  # With the tolerance 0
        self.region = region_bounds(preset.region, rig.proximity.intrinsics.shape)
        self._rays = _ray_planes(rig.proximity.intrinsics)
        self._lookup = color_lookup_of(rig)
        self._hsv = hsv_limits(preset.mask) if preset.mask.enabled else _NO_LIMITS
        self._aligned: tuple[SensorFrame | None, AlignedDepth | None] = None, None  # the newest, for all who read it
        self.light: Light | None = None
        if untouched is not None and preset.mask.enabled and rig.has_proximity:
            self.light = Light(untouched.proximity_color, preset.mask)

    def aligned(self, frame: SensorFrame) -> AlignedDepth:
        """Return both depths for every pixel of the region; nan elsewhere."""
        last, aligned = self._aligned
        if aligned is None or last is not frame:
            aligned = self.alignment.align(frame.proximity_depth, frame.tactile_depth, self.region)
            self._aligned = frame, aligned
        return aligned

    def test(self, tolerance: float = np.inf) -> kernels.PixelTest:
        """Return the test of single pixels, for kernels; with the default any two depths agree."""
        limits = self.limits._replace(tolerance=np.float32(tolerance))
        return kernels.PixelTest(self.alignment.tables, self.region, limits, self._rays)

    def mask_colors(self, frame: SensorFrame) -> Uint8Array:
        """Return a frame's proximity colours as the mask compares them: in the light of the untouched frame."""
        return frame.proximity_color if self.light is None else self.light.as_before(frame.proximity_color)

    def color_test(self, frame: SensorFrame) -> kernels.ColorTest:
        return kernels.ColorTest(self._lookup, kernels.flat(self.mask_colors(frame), 3 * LANES), self._hsv)

    def tactile_pixels(self, pixels: IndexArray, frame: SensorFrame) -> IndexArray:
        """Return the flat tactile pixel of each flat proximity pixel that has depth."""
        rig = self.rig
        if not rig.has_proximity:  # both images are the same
            return pixels
        depth_m = frame.proximity_depth.reshape(-1)[pixels] * np.float32(rig.proximity.depth_unit_m)
        height, width = rig.tactile.intrinsics.shape
        u, v = self.alignment.tactile_pixels(pixels, depth_m, rig)
        column, row = (np.rint(part).clip(0, size - 1).astype(np.intp) for part, size in ((u, width), (v, height)))
        return np.asarray(row * width + column)

    def candidates(
        self, frame: SensorFrame, tolerance: float, within: tuple[int, int, int, int] | None = None
    ) -> Candidates:
        """Return the pixels whose depths agree within a tolerance and whose colour is not the mask's.

        ``within`` limits them to a rectangle: left, top, right, bottom.
        """
        height, width = frame.proximity_depth.shape
        images, test, workspace = depth_images(frame), self.test(tolerance), self.workspace
        if within is not None:
            ends = zip((max, max, min, min), self.region, within, strict=True)
            test = test._replace(region=kernels.Region(*(closer(own, other) for closer, own, other in ends)))
        tiles, possible = self.coarse.tiles(images, test.limits) if within is None else self.coarse.every_tile
        if possible == 0:
            return NO_CANDIDATES
        color = self.color_test(frame)
        alone = possible <= MAX_TILES_ALONE or within is not None
        rows = height if alone else ROWS  # all rows at once: on one thread
        out = kernels.CandidateArrays(workspace.pixels, workspace.points.reshape(-1), workspace.counts)
        in_parallel(partial(kernels.find_candidates, images, test, color, tiles, out), height, rows)
        return workspace.collect([slice(v * width, v * width + int(out.counts[v])) for v in range(0, height, rows)])

    def agreeing(self, frame: SensorFrame, tolerance: float) -> IndexArray:
        """Return the flat pixels whose depths agree within a tolerance, whatever their colour; for any thread."""
        count, height = frame.proximity_depth.size, frame.proximity_depth.shape[0]
        out = kernels.CandidateArrays(np.empty(count, np.intp), np.empty(3 * count, np.float32), np.empty(1, np.int64))
        color = kernels.ColorTest(self._lookup, kernels.flat(frame.proximity_color, 3 * LANES), _NO_LIMITS)
        tiles, _ = self.coarse.every_tile
        kernels.find_candidates(depth_images(frame), self.test(tolerance), color, tiles, out, 0, height)
        return np.asarray(out.pixels[: int(out.counts[0])])

    def classify(self, frame: SensorFrame) -> Uint8Array:
        """Return each pixel's verdict of depth, region and range; the others have CONTACT."""
        counts, aligned, (left, top, right, bottom) = frame.proximity_depth, self.aligned(frame), self.region
        depth_m = counts * np.float32(self.rig.proximity.depth_unit_m)
        verdicts = np.full(counts.shape, Provenance.CONTACT, np.uint8)
        verdicts[np.isnan(aligned.expected_m - aligned.measured_m)] = Provenance.NO_TACTILE_DEPTH
        verdicts[(depth_m < self.limits.nearest_m) | (depth_m > self.limits.farthest_m)] = Provenance.OUTSIDE_RANGE
        outside = np.ones(counts.shape, np.bool_)
        outside[top:bottom, left:right] = False
        verdicts[outside] = Provenance.OUTSIDE_REGION
        verdicts[~valid_depth(counts)] = Provenance.NO_PROXIMITY_DEPTH
        return verdicts


def depth_images(frame: SensorFrame) -> kernels.DepthImages:
    """Return the depth images of a frame, flat, for the kernels."""
    return kernels.DepthImages(kernels.flat(frame.proximity_depth), kernels.flat(frame.tactile_depth))


def region_bounds(section: RegionSection, shape: tuple[int, int]) -> kernels.Region:
    """Return the region in pixels, clipped to the image."""
    height, width = shape
    if not section.enabled:
        return kernels.Region(0, 0, width, height)
    left, top, region_width, region_height = section.rectangle
    return kernels.Region(left, top, min(left + region_width, width), min(top + region_height, height))


@lru_cache(maxsize=8)
def _ray_planes(intrinsics: Intrinsics) -> Float32Array:
    """Return `ray_table` for the kernels: all x / z, then all y / z, flat."""
    return kernels.planes_of(ray_table(intrinsics))
