"""The steps of the membrane test: differences and bias, equilibrium, edge, groups, points."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from ...model.arrays import BoolArray, Float32Array, Uint8Array
from ...model.clouds import ray_table
from ...model.frames import Rig, SensorFrame
from ...model.patch import Boundary, Candidates, Lazy, MembraneFacts, Provenance
from ...model.rig_noise import RigNoise
from ..alignment import make_alignment
from ..dents import Dents
from ..kernels import membrane as kernels
from ..kernels.cells import Differences, MembraneImage
from ..kernels.simd import LANES
from ..kernels.threads import ROWS, in_parallel
from ..kernels.tolerance import TILE_ROWS, flat
from ..outliers.clusters import in_large_cluster
from ..pixels import MAX_TILES_ALONE, Pixels, Workspace, depth_images
from .equilibrium import (
    CELL_PX,
    FAR_M,
    INNER,
    Cells,
    Equilibrium,
    cells_of,
    measured_curvature_per_m,
    settle,
    surroundings,
    to_pixels,
    usable_curvature_per_m,
)
from .frame_bias import COARSE_CELL_PX, SOME, FrameBias, RigBias, frame_bias, rig_bias
from .section import LARGEST_BIAS_M, NEAR_GAP_M, USUAL_GAP_M, MembraneSection

if TYPE_CHECKING:
    from ...preset import Preset

#: Largest difference that takes part in the search for the bias, and in the equilibrium, metres.
_WIDE_M: Final = LARGEST_BIAS_M + 0.015
_NEAR_M: Final = 0.008
#: Differences are aligned again for a bias that is larger, metres: it displaces the tactile pixel by a quarter pixel.
_ALIGN_ANEW_M: Final = 0.001
#: A measured gap is certainly larger than the largest gap if it exceeds it by this number of standard deviations of the
#: noise, and by the errors of the model, metres.
_CERTAIN, _MODEL_ERROR_M = 3.0, 0.0003
#: A part of contact is missed if the bias may be larger by this number of standard deviations, limited, metres, if less
#: than this share of the part was found, and if it is larger than this, m^2: smaller ones hover as often as they touch.
#: Where nothing else touches it must be larger than the next. Beside firm contact of the last area the bias is too
#: certain.
_MISSED_SIGMAS, _MAX_SIGMA_M, _FOUND_SHARE = 2.0, 0.0005, 0.2
_MISSED_M2, _ALONE_M2, _LARGE_M2 = 48e-6, 100e-6, 0.002
#: Error of the boundary as a multiple of how far the bias's error moves it; where all of it borders on cells without
#: depth, and at least, metres. A cell has no depth where this share has none; and the residual of cells in contact as a
#: multiple of a pixel's noise.
_PER_STRIP, _UNSEEN_ERROR_M, _BOUNDARY_FLOOR_M, _MAX_UNSEEN, _USUAL_RESIDUAL = 1.1, 0.007, 0.0007, 0.9, 0.85
#: Contact at less than this share of the inflation, averaged over a window of this sigma, cells, hardly presses.
_HARDLY, _HOLLOW_CELLS = 0.4, 3.0
#: A cell and its four neighbours.
_CROSS: Final = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], np.uint8)
#: Sigma of the Gaussian window over which the depth of the points is averaged, pixels, and its reach.
POINT_WINDOW_PX: Final = 2.0
_POINT_REACH_PX: Final = 4
#: Share of a point's window that must be in contact.
_MIN_SHARE: Final = np.float32(0.05)


@dataclass(frozen=True, eq=False)
class Measured:
    """What the first step measures in a frame."""

    differences: Differences
    known: RigBias  # What is known of the rig
    bias: FrameBias  # That of the frame, beyond the bias of its differences
    #: Twice the mean curvature of the free membrane as measured (nan if it cannot be), and as used.
    curvature_per_m: float
    free_per_m: float


def differences_at(
    frame: SensorFrame, pixels: Pixels, section: MembraneSection, known: RigBias, frame_bias_m: float = 0.0
) -> Differences | None:
    """Return the differences of both depths less the rig's and the frame's bias; None if none is usable.

    Only image tiles in which both depths can be near each other are compared.
    """
    bias_m = (known.mean_m if section.bias else 0.0) + frame_bias_m
    largest_m = float(np.float32(_WIDE_M if section.bias else _NEAR_M))
    any_depth = pixels.limits._replace(nearest_m=np.float32(0), farthest_m=np.float32(np.inf))
    tiles, possible = pixels.coarse.tiles(depth_images(frame), any_depth, largest_m + abs(bias_m))
    if possible == 0:
        return None
    width, height, *_ = pixels.alignment.size
    top, bottom = _used(tiles, 1, TILE_ROWS, height)
    left, right = _used(tiles, 0, LANES, width)
    rows = ROWS if possible > MAX_TILES_ALONE else bottom - top
    difference, state = look(frame, pixels, tiles, (left, top, right, bottom), bias_m, largest_m, rows)
    found = Differences(
        (top, left),
        difference,
        frame.proximity_depth[top:bottom, left:right].copy(),
        np.float32(pixels.rig.proximity.depth_unit_m),
        state == kernels.USABLE,
        state == kernels.EXCLUDED,
        state == kernels.UNSEEN,
        bias_m,
        difference[SOME][state[SOME] == kernels.MASKED],
    )
    return found if found.usable.any() else None


def _used(tiles: BoolArray, axis: int, step: int, size: int) -> tuple[int, int]:
    """Return first and last (exclusive) row or column of the possible tiles, with a margin of cells.

    It begins at multiples of all cells and tiles, so what lies elsewhere in the image does not shift the cells.
    """
    places = np.flatnonzero(tiles.any(axis=axis))
    first = max(int(places[0]) * step - 2 * CELL_PX, 0)
    grid = math.lcm(step, CELL_PX, COARSE_CELL_PX)
    return first // grid * grid, min((int(places[-1]) + 1) * step + 2 * CELL_PX, size)


def look(
    frame: SensorFrame, pixels: Pixels, tiles: BoolArray, rectangle: tuple[int, int, int, int],
    bias_m: float, largest_m: float, rows: int,
) -> tuple[Float32Array, Uint8Array]:  # fmt: skip
    """Return differences and states in a rectangle: left, top, right and bottom; ``rows`` at a time on each thread."""
    left, top, right, bottom = rectangle
    shape = bottom - top, right - left
    difference, state = np.empty(shape, np.float32), np.empty(shape, np.uint8)
    images, test, color = depth_images(frame), pixels.test(), pixels.color_test(frame)
    find = partial(
        kernels.find_differences, images, test, color, tiles, (left, top, right), np.float32(bias_m),
        np.float32(largest_m), difference.reshape(-1), state.reshape(-1),
    )  # fmt: skip
    in_parallel(find, bottom - top, rows)
    return difference, state


def measure(frame: SensorFrame, preset: Preset, pixels: Pixels) -> Measured | None:
    """Return the curvature of the free membrane and the frame's bias, beside the differences near that bias, if any."""
    rig, section, known = pixels.rig, preset.membrane, rig_bias(preset.noise, pixels.rig)
    if (found := differences_at(frame, pixels, section, known)) is None:
        return None
    curvature_per_m = measured_curvature_per_m(frame, preset.alignment, rig)
    free_per_m = usable_curvature_per_m(curvature_per_m)
    bias = FrameBias(known=False, sigma_m=math.hypot(known.mean_m, known.sigma_m))  # unless it is corrected
    near: Differences | None = found
    if section.bias:
        membrane = MembraneImage(flat(frame.tactile_depth), pixels.alignment.tables)
        bias, near = frame_bias(found, membrane, known, free_per_m, rig)
        if abs(bias.bias_m) > _ALIGN_ANEW_M:
            again = differences_at(frame, pixels, section, known, bias.bias_m)
            firm, bias, near = bias.firm_m2 > 0, replace(bias, bias_m=0.0, firm_m2=0.0), again
            if again is not None and firm:
                refined, its_near = frame_bias(again, membrane, known, free_per_m, rig)
                if refined.firm_m2 > 0:
                    bias, near = refined, its_near
    return None if near is None else Measured(near, known, bias, curvature_per_m, free_per_m)


def measured_cells(measured: Measured, frame: SensorFrame, section: MembraneSection, pixels: Pixels) -> Cells | None:
    """Average the differences near the bias and the object's shape over cells; None for too small an image."""
    near_m, image = (measured.bias.bias_m, _NEAR_M), MembraneImage(flat(frame.tactile_depth), pixels.alignment.tables)
    return cells_of(measured.differences, image, CELL_PX, section.shape_px, measured.free_per_m, near_m, pixels.rig)


def with_missed_parts(
    solution: Equilibrium, cells: Cells, measured: Measured, section: MembraneSection,
    is_dented: Callable[[BoolArray], bool],
) -> Equilibrium:  # fmt: skip
    """Return the solution with the dented parts of contact that only the largest likely bias shows.

    Parts that are found keep their edge: a larger bias would move it outwards.
    """
    import cv2

    bias, gap_m = measured.bias, section.gap_m
    if not section.bias or bias.firm_m2 > _LARGE_M2 or not (measured.known.measured or bias.seen):
        return solution
    largest_m = bias.bias_m + _MISSED_SIGMAS * min(bias.sigma_m, _MAX_SIGMA_M)
    largest = settle(cells, largest_m, measured.known.length_m(section.trust_m), solution)
    _, part = cv2.connectedComponents((largest.gap_m <= gap_m).view(np.uint8))
    areas_m2, found = cells.area_m2, solution.gap_m <= gap_m
    area_m2, found_m2 = (np.bincount(part.ravel(), each.ravel()) for each in (areas_m2, areas_m2 * found))
    smallest_m2 = _MISSED_M2 if found_m2.max() >= _FOUND_SHARE * _MISSED_M2 else _ALONE_M2
    missed = (found_m2 < _FOUND_SHARE * area_m2) & (area_m2 > smallest_m2)
    missed[0] = False
    for number in np.flatnonzero(missed):
        missed[number] = is_dented(part == number)
    if not missed.any():
        return solution
    here = cv2.dilate(missed[part].view(np.uint8), np.ones((3, 3), np.uint8)) > 0
    names = (field.name for field in fields(Equilibrium))
    return Equilibrium(*(np.where(here, getattr(largest, name), getattr(solution, name)) for name in names))


def is_dented(measured: Measured, dents: Dents, noise: RigNoise | None, rig: Rig, cells: BoolArray) -> bool:
    """Return whether the untouched frame speaks for a touch in some cells (H, W), with their frame."""
    differences, known = measured.differences, measured.known
    v, u = CELL_PX * np.array(np.nonzero(cells[INNER])) + CELL_PX // 2
    height, width = differences.usable.shape
    inside = (v < height) & (u < width)
    v, u = v[inside], u[inside]
    v, u = v[differences.usable[v, u]], u[differences.usable[v, u]]
    top, left = differences.corner
    pixels = (top + v) * rig.proximity.intrinsics.width + left + u
    dent = dents.around(pixels, differences.depth_m(differences.counts[v, u]))
    return dent.evidence(noise, known.tactile_m4, known.pixel_sigma_m) > 0


def within_edge(cells: Cells, solution: Equilibrium, gap_m: float, measured: Measured) -> BoolArray:
    """Return the pixels whose gap in equilibrium is small, unless the measured one is certainly larger.

    Where the object ends, cells are cut by their pixels: those that do not measure a small gap do not count.
    """
    differences, known = measured.differences, measured.known
    touching = np.zeros_like(differences.usable)
    certain_m = gap_m + max(_CERTAIN * known.gap_sigma_m, _MODEL_ERROR_M)
    gap = np.where(solution.guess_m > np.float32(certain_m), FAR_M, solution.gap_m)
    box = surroundings((gap <= np.float32(gap_m))[INNER], 2)
    if box is None:
        return touching
    # between cells that are not near no pixel is: interpolate only around the near ones
    rows, columns = (slice(CELL_PX * side.start, CELL_PX * side.stop) for side in box)
    usable, difference = differences.usable[rows, columns], differences.difference_m[rows, columns]
    gap, border = to_pixels(cells, gap, usable.shape, box)
    largest = np.float32(gap_m + max(_CERTAIN * known.pixel_sigma_m, _MODEL_ERROR_M))
    near = usable & (np.abs(difference - np.float32(measured.bias.bias_m)) < largest)
    touching[rows, columns] = (gap <= np.float32(gap_m)) & (near | ~border)
    return touching & ~differences.excluded


def large_contacts(contact: BoolArray, differences: Differences, min_area_mm2: float, rig: Rig) -> BoolArray:
    """Return contact without connected groups whose usable pixels are smaller than the smallest contact."""
    camera, (top, left) = rig.proximity.intrinsics, differences.corner
    found, width = np.flatnonzero(contact), contact.shape[1]
    pixels = found + (found // width) * (camera.width - width) + (top * camera.width + left)
    depth = differences.depth_m(differences.counts.reshape(-1)[found]) * differences.usable.reshape(-1)[found]
    large = in_large_cluster(depth, pixels, camera, min_area_mm2)
    kept = np.zeros_like(contact)
    kept.reshape(-1)[found[large]] = True
    return kept


def surface_points(contact: BoolArray, measured: Measured, pixels: Pixels) -> Candidates:
    """Return contact pixels that have a depth, with smoothed points weighted from both cameras' depths."""
    import cv2  # here and below: importing the pipeline must not wait for it

    differences, workspace, tactile_weight = measured.differences, pixels.workspace, measured.known.tactile_weight
    part = surroundings(contact, _POINT_REACH_PX)
    if part is None:
        return workspace.collect([])
    size = (2 * _POINT_REACH_PX + 1,) * 2
    weight = (contact[part] & differences.usable[part]).view(np.uint8).astype(np.float32)
    depth = differences.depth_m(differences.counts[part]) - np.float32(tactile_weight) * differences.difference_m[part]
    depth -= np.float32((1 - tactile_weight) * measured.bias.bias_m)
    share = np.asarray(cv2.GaussianBlur(weight, size, POINT_WINDOW_PX))
    depth = cv2.GaussianBlur(depth * weight, size, POINT_WINDOW_PX) / np.maximum(share, np.float32(1e-6))
    (top, left), (rows, columns) = differences.corner, part
    window = kernels.RayWindow(ray_table(pixels.rig.proximity.intrinsics), top + rows.start, left + columns.start)
    count = kernels.collect_points(
        np.ascontiguousarray(contact[part]), depth, share, _MIN_SHARE, window, workspace.pixels, workspace.points
    )
    return workspace.collect([slice(0, count)])


def facts(
    measured: Measured, cells: Cells, solution: Equilibrium, found: Equilibrium,
    gap_m: float, contact: Candidates, rig: Rig,
) -> MembraneFacts:  # fmt: skip
    """Return what was measured besides contact, for messages; ``found`` is the solution without missed parts."""
    differences, bias, shape = measured.differences, measured.bias, rig.proximity.intrinsics.shape

    def gap_image() -> Float32Array:
        gap = np.full(shape, np.nan, np.float32)
        within = to_pixels(cells, solution.gap_m, differences.usable.shape)[0]
        gap[differences.place] = np.where(within < FAR_M, within, np.float32(np.nan))
        return gap

    def differences_of_contact() -> Float32Array:
        rows, here = contact.pixels // shape[1], differences.usable.shape[1]
        top, left = differences.corner
        place = contact.pixels - rows * (shape[1] - here) - (top * here + left)
        usable = np.where(differences.usable, differences.difference_m, np.float32(np.nan)).reshape(-1)[place]
        return np.asarray(usable - np.float32(bias.bias_m))

    return MembraneFacts(
        bias_m=differences.bias_m + bias.bias_m,
        firm_m2=bias.firm_m2,
        bias_known=bias.known,
        bias_seen=bias.seen,
        bias_sigma_m=bias.sigma_m,
        bias_change_m=bias.change_m,
        missed_parts=solution is not found,
        curvature_per_m=measured.curvature_per_m,
        used_curvature_per_m=measured.free_per_m,
        gap_m=Lazy(gap_image),
        difference_m=Lazy(differences_of_contact),
        tactile_weight=measured.known.tactile_weight,
        boundary=Lazy(lambda: boundary_of(cells, solution, gap_m, measured)),
    )


def boundary_of(cells: Cells, solution: Equilibrium, gap_m: float, measured: Measured) -> Boundary:
    """Return what is known of the boundary of contact, by terms that fit the errors in ``tactune lab faults``.

    An error of the bias moves it to where the gap is larger by as much; a hollow that hardly presses may be spanned. A
    limit on the gap above the usual one moves it outwards.
    """
    import cv2

    areas, known = cells.sides_m[0] * cells.sides_m[1], measured.known
    touching = solution.gap_m <= gap_m
    inside, seen = (cv2.erode(each.view(np.uint8), _CROSS) > 0 for each in (touching, cells.unseen <= _MAX_UNSEEN))
    border = touching & ~inside
    count = int(np.count_nonzero(border))
    if count == 0:
        return Boundary(math.nan, 0.0, 1.0)
    nearly = (solution.gap_m <= gap_m + measured.bias.sigma_m) & ~touching
    pressed = np.where(touching, cells.push_per_m - np.float32(_HARDLY * measured.free_per_m), np.float32(0))
    hovering = touching & (solution.gap_m > USUAL_GAP_M)
    hollow = touching & (cv2.GaussianBlur(pressed, (0, 0), _HOLLOW_CELLS) < 0)
    uncertain_m2 = float(areas[nearly].sum() + 2 * areas[hollow].sum())
    length_m = count * math.sqrt(float(np.median(areas[border])))
    strip_m, hovering_m = uncertain_m2 / length_m, float(areas[hovering].sum()) / length_m
    unseen = int(np.count_nonzero(border & ~seen)) / count
    noise = float(np.std(solution.residual_m[touching & (cells.share > 0)])) / (_USUAL_RESIDUAL * known.pixel_sigma_m)
    error_m = math.hypot(_PER_STRIP * strip_m, _UNSEEN_ERROR_M * unseen, _BOUNDARY_FLOOR_M) * max(noise, 1.0) ** 1.5
    return Boundary(error_m + hovering_m, unseen, noise)


def classify(frame: SensorFrame, preset: Preset, pixels: Pixels) -> Uint8Array:
    """Return each pixel's verdict of depth, region, range and colour; OUTSIDE_TOLERANCE where contact is possible."""
    verdicts = pixels.classify(frame)
    every_tile = np.ones(pixels.coarse.shape, np.bool_)  # not the pipeline's own, which other threads may be using
    known = rig_bias(preset.noise, pixels.rig)
    _, state = look(frame, pixels, every_tile, (0, 0, *verdicts.shape[::-1]), known.mean_m, _WIDE_M, ROWS)
    verdicts[verdicts == Provenance.CONTACT] = Provenance.OUTSIDE_TOLERANCE
    verdicts[state == kernels.MASKED] = Provenance.MASKED
    return verdicts


def provenance(
    frame: SensorFrame, preset: Preset, pixels: Pixels, measured: Measured, cells: Cells, solution: Equilibrium,
    touching: BoolArray, large: BoolArray, contact: Candidates,
) -> Uint8Array:  # fmt: skip
    """Return each pixel's verdict."""
    verdicts, differences = classify(frame, preset, pixels), measured.differences
    part, usable = verdicts[differences.place], differences.usable
    guess = np.where(cells.known, solution.guess_m, np.float32(1))
    near = to_pixels(cells, guess.astype(np.float32), usable.shape)[0] < NEAR_GAP_M
    part[usable & near] = Provenance.RIM
    part[usable & touching] = Provenance.SMALL_CLUSTER
    part[usable & large] = Provenance.OUTLIER
    verdicts.reshape(-1)[contact.pixels] = Provenance.CONTACT
    return verdicts


def firm_contact_bias(preset: Preset, rig: Rig) -> Callable[[SensorFrame], tuple[float, float] | None]:
    """Return a function that measures the bias in a frame where an object is pressed firmly into the membrane.

    It returns the bias, proximity less tactile depth after the alignment's depth correction, in metres, and the area of
    contact that proves it, in square metres; None without such contact.
    """
    plain = preset.with_values({"contact_test": "membrane", "membrane.bias": True}).model_copy(update={"noise": None})
    pixels = Pixels(plain, rig, make_alignment(plain.alignment, rig), Workspace(rig))

    def bias_of(frame: SensorFrame) -> tuple[float, float] | None:
        measured = measure(frame, plain, pixels)
        if measured is None or measured.bias.firm_m2 == 0:
            return None
        return measured.differences.bias_m + measured.bias.bias_m, measured.bias.firm_m2

    return bias_of
