"""The loops that average pixels over cells and measure the object's surface there, compiled."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np

from ...model.arrays import BoolArray, Float32Array, Uint16Array
from .compiling import inline, kernel
from .lenses import project
from .membrane import bulge_at, derivatives, divide_by_shares
from .simd import LANES
from .tolerance import AlignmentTables

#: Upper limit of a slope: the depths of a steeper cell belong to both sides of an edge.
_MAX_SLOPE: Final = 2.0
_MIN_RUN_M: Final = 1e-5  # Over a shorter distance no slope is measured
_MIN_AREA: Final = 1e-3  # Points that spread along one direction only tell no plane
#: The search for the membrane's depth along a ray ends without a result, or when a step is smaller than this, metres.
_MAX_STEPS, _LAST_STEP_M = 5, np.float32(0.0005)
_SATURATED: Final = 65535
_ZERO, _HALF, _ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)
#: Smallest share of a cell that stands for all of it.
_MIN_SEEN: Final = np.float32(0.25)
_MIN_FACING, _MIN_TURN = np.float32(0.25), 0.25


class Differences(NamedTuple):
    """Both depths in a rectangle of the proximity image; images are (H, W)."""

    corner: tuple[int, int]  # Row and column at which the rectangle begins
    difference_m: Float32Array  # Proximity less tactile depth, less ``bias_m``; 0 where it is too large
    counts: Uint16Array  # Raw proximity depth
    unit_m: np.float32  # Metres of a count
    usable: BoolArray  # Has both depths, less than the largest difference between them, and not the mask's colour
    excluded: BoolArray  # Outside the region, or on the membrane outside the range
    unseen: BoolArray  # Without one of both depths
    bias_m: float  # The bias that was subtracted from the proximity depth before it was aligned
    on_prints_m: Float32Array  # (N,): The differences of some pixels with the mask's colour

    def depth_m(self, counts: Uint16Array) -> Float32Array:
        """Return raw proximity depth in metres, less ``bias_m``."""
        depth = counts * self.unit_m
        depth -= np.float32(self.bias_m)
        return depth

    @property
    def place(self) -> tuple[slice, slice]:
        """Rows and columns of the rectangle."""
        (top, left), (height, width) = self.corner, self.usable.shape
        return slice(top, top + height), slice(left, left + width)

    def cut(self, rows: slice, columns: slice) -> Differences:
        """Return a part of the rectangle."""
        images = ("difference_m", "counts", "usable", "excluded", "unseen")
        corner = self.corner[0] + rows.start, self.corner[1] + columns.start
        return self._replace(corner=corner, **{name: getattr(self, name)[rows, columns].copy() for name in images})


class MembraneImage(NamedTuple):
    """The tactile depth image, and how it is aligned."""

    counts: Uint16Array  # flat
    alignment: AlignmentTables


@kernel
def average_cells(
    window: Any, near_m: Any, side: Any, step: Any, table: Any, frame: Any, out: Any, first: Any, last: Any
) -> None:
    """Write means over cells of ``side`` by ``side`` pixels of `Differences`, rows ``first`` to ``last - 1``.

    One pixel of ``step`` x ``step`` is read, in all rows and columns, so a pattern without depth does not hide a cell;
    that number divides ``side``, or ``step`` is 1. The last cells may reach beyond the images. The seen pixels of a
    cell stand for all, if they are a quarter of it: depth that is missing here and there hides no cell.

    Parameters
    ----------
    window : Differences
    near_m : tuple of float
        Centre and limit: only differences nearer than the limit to the centre take part.
    table : float32, shape (h, w, 2)
        Rays of the whole image.
    frame : int
        Cells around the images of ``out`` that are left as they are.
    out : float32, shapes three times (H, W), and (H, W, 4)
        By cell: mean difference; excluded share; share without one of both depths; mean x, y and z, metres, times the
        share of the seen pixels that take part, and that share.
    """
    means, left_out, holes, points = out
    (top, left), differences, counts, unit_m, usable, excluded, unseen, bias, _ = window
    bias_m, centre_m, limit_m = np.float32(bias), np.float32(near_m[0]), np.float32(near_m[1])
    width, pixels, stride = usable.shape[1], np.float32((side // step) ** 2), step * step
    for row in range(first, last):
        to = row + frame
        means[to, frame : means.shape[1] - frame], left_out[to, frame : means.shape[1] - frame] = _ZERO, _ZERO
        points[to, frame : means.shape[1] - frame], holes[to, frame : means.shape[1] - frame] = _ZERO, _ZERO
        for v in range(side * row, min(side * row + side, usable.shape[0])):
            column, in_cell = frame, 0
            for u in range((v * step + v // step) % stride, width, stride):
                if excluded[v, u]:
                    left_out[to, column] += _ONE
                if unseen[v, u]:
                    holes[to, column] += _ONE
                if usable[v, u] and abs(differences[v, u] - centre_m) < limit_m:
                    z = np.float32(counts[v, u]) * unit_m - bias_m
                    means[to, column] += differences[v, u]
                    points[to, column, 0] += table[top + v, left + u, 0] * z
                    points[to, column, 1] += table[top + v, left + u, 1] * z
                    points[to, column, 2] += z
                    points[to, column, 3] += _ONE
                in_cell += stride
                if in_cell == side:
                    column += 1
                    in_cell = 0
        for column in range(frame, means.shape[1] - frame):
            means[to, column] /= max(points[to, column, 3], _ONE)
            left_out[to, column] /= pixels
            holes[to, column] /= pixels
            seen = max(_ONE - holes[to, column], _MIN_SEEN) * pixels
            for part in range(4):
                points[to, column, part] /= seen


@inline
def _slope_of(rise: Any, way: Any) -> Any:
    """Return the slope of a surface, at most `_MAX_SLOPE`; 0 over less than `_MIN_RUN_M`."""
    return min(max(rise / way, -_MAX_SLOPE), _MAX_SLOPE) if way > _MIN_RUN_M else 0.0


@kernel
def measure_cells(points: Any, min_shares: Any, flat_m: Any, curved: Any, sides: Any, facing: Any) -> None:
    """Measure a smooth surface by cell: its curvature, the sides of cells, and how they face the camera.

    Parameters
    ----------
    points : float32, shape (H, W, 4)
        Points, running to the right and down, times their shares, and these; divided by them in place. Metres.
    min_shares : tuple of float32
        Smallest share for the curvature, and for the slope. Without a slope, and at the border, a cell has sides of
        1 mm and faces the camera.
    flat_m : tuple of float
        Width and height of a cell that faces the camera at a depth of 1 m.
    curved, sides, facing : float32, shapes (H, W), (2, H, W) and (H, W)
        Written: twice the mean curvature, 1/m, nan where it is not known; length of a cell along the surface, to the
        right and down, metres; share of a depth difference along the ray that is along the surface normal.
    """
    divide_by_shares(points)
    height, width = facing.shape
    curved[:], sides[:], facing[:] = np.float32(np.nan), np.float32(1e-3), _ONE
    for v in range(1, height - 1):
        for u in range(1, width - 1):
            if points[v, u, 3] >= min_shares[0]:
                curved[v, u] = bulge_at(points, v, u)
            if points[v, u, 3] < min_shares[1]:
                continue
            x_u, _, _, _, _ = derivatives(points, 0, v, u)
            _, y_v, _, _, _ = derivatives(points, 1, v, u)
            z_u, z_v, _, _, _ = derivatives(points, 2, v, u)
            # at the end of a window the mean of its points moves by less than a cell, but along the surface
            right, down = _slope_of(z_u, x_u), _slope_of(z_v, y_v)
            z = points[v, u, 2]
            ray_x, ray_y = points[v, u, 0] / z, points[v, u, 1] / z
            # from x = ray_x z and y = ray_y z, where ray_x grows along the row only and ray_y down the column only
            x_u = flat_m[0] * z / max(1 - right * ray_x, _MIN_TURN)
            y_v = flat_m[1] * z / max(1 - down * ray_y, _MIN_TURN)
            z_u, z_v = right * x_u, down * y_v
            y_u, x_v = ray_y * z_u, ray_x * z_v
            sides[0, v, u] = np.sqrt(x_u * x_u + y_u * y_u + z_u * z_u)
            sides[1, v, u] = np.sqrt(x_v * x_v + y_v * y_v + z_v * z_v)
            nx, ny, nz = y_u * z_v - z_u * y_v, z_u * x_v - x_u * z_v, x_u * y_v - y_u * x_v
            along = abs(nx * ray_x + ny * ray_y + nz) / np.sqrt(nx * nx + ny * ny + nz * nz)
            facing[v, u] = min(max(np.float32(along), _MIN_FACING), _ONE)


@inline
def _membrane_depth(pixel: Any, z: Any, membrane: Any) -> Any:
    """Return the membrane's depth along the ray of a proximity pixel, and whether it is seen; ``z`` is a guess, m."""
    counts, alignment = membrane
    size, planes = alignment.size, alignment.planes
    count = max(size.width * size.height, LANES)
    for _ in range(_MAX_STEPS):
        if alignment.rigid:
            x = planes[pixel] * z + alignment.translation_m[0]
            y = planes[count + pixel] * z + alignment.translation_m[1]
            expected = planes[2 * count + pixel] * z + alignment.translation_m[2]
            if expected <= _ZERO:
                return z, False
            u, v = project(x, y, expected, alignment.lens, alignment.camera)
            column, row = np.floor(u + _HALF), np.floor(v + _HALF)
            if not (0 <= column < size.tactile_width and 0 <= row < size.tactile_height):
                return z, False
            partner = np.int64(row) * size.tactile_width + np.int64(column)
        else:
            partner, expected = np.int64(alignment.table[pixel]), z
        seen = counts[partner] if partner >= 0 else np.uint16(0)
        if not 0 < seen < _SATURATED:
            return z, False
        step = np.float32(seen) * alignment.tactile_unit_m + alignment.tactile_offset_m - expected
        z += step
        if abs(step) < _LAST_STEP_M:
            return z, True
    return z, False


@kernel
def extrapolate(values: Any, known: Any, reach: Any, queue: Any) -> None:
    """Fill nan: a known cell within ``reach`` cells of a value takes the first that reaches it; all other nan become 0.

    ``values`` (H, W) are nan at the border; ``queue`` is scratch, int32, flat, H * W elements.
    """
    height, width = values.shape
    count = 0
    for v in range(1, height - 1):
        for u in range(1, width - 1):
            if np.isnan(values[v, u]):
                continue
            sides = values[v, u - 1] + values[v, u + 1] + values[v - 1, u] + values[v + 1, u]
            if np.isnan(sides):
                queue[count] = v * width + u
                count += 1
    first = 0
    for _ in range(reach):
        last = count
        for i in range(first, last):
            v, u = queue[i] // width, queue[i] % width
            for row in range(v - 1, v + 2):
                for column in range(u - 1, u + 2):
                    if known[row, column] and np.isnan(values[row, column]):
                        values[row, column] = values[v, u]
                        queue[count] = row * width + column
                        count += 1
        first = last
    for v in range(height):
        for u in range(width):
            values[v, u] = _ZERO if np.isnan(values[v, u]) else values[v, u]


@inline
def _mean_point(points: Any, v: Any, u: Any) -> Any:
    """Return the mean x, y and z of a cell that has some, metres; ``points`` (H, W, 4) are those of `average_cells`."""
    share = np.float64(points[v, u, 3])
    return points[v, u, 0] / share, points[v, u, 1] / share, points[v, u, 2] / share


@inline
def _tangent_plane(points: Any, v: Any, u: Any, reach: Any) -> Any:
    """Fit z = a x + b y + c to a cell and those around it, from -reach to reach in steps of 2; return a, b and c.

    ``points`` (H, W, 4) are those of `average_cells`. Near cells count more, by Epanechnikov's parabola.
    """
    x0, y0, z0 = _mean_point(points, v, u)
    outside = 1.0 / (reach + 1) ** 2
    w, wx, wy, wz, xx, xy, yy, xz, yz = np.float64(points[v, u, 3]), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for row in range(v - reach, v + reach + 1, 2):
        for column in range(u - reach, u + reach + 1, 2):
            near = 1.0 - ((row - v) ** 2 + (column - u) ** 2) * outside
            weight = points[row, column, 3] * near
            if weight <= 0.0 or (row == v and column == u):  # the cell itself counts already
                continue
            x, y, z = _mean_point(points, row, column)
            x, y, z = x - x0, y - y0, z - z0
            w, wx, wy, wz = w + weight, wx + weight * x, wy + weight * y, wz + weight * z
            xx, xy, yy = xx + weight * x * x, xy + weight * x * y, yy + weight * y * y
            xz, yz = xz + weight * x * z, yz + weight * y * z
    x, y, z = wx / w, wy / w, wz / w
    xx, xy, yy, xz, yz = xx - wx * x, xy - wx * y, yy - wy * y, xz - wx * z, yz - wy * z
    area = xx * yy - xy * xy
    a = b = 0.0
    if area > _MIN_AREA * (xx + yy) ** 2:
        a, b = (xz * yy - yz * xy) / area, (yz * xx - xz * xy) / area
        steep = max(np.sqrt(a * a + b * b) / _MAX_SLOPE, 1.0)
        a, b = a / steep, b / steep
    return a, b, z0 + z - a * (x0 + x) - b * (y0 + y)


@kernel
def continue_beside(
    known: Any, excluded: Any, points: Any, surface: Any, rays: Any, side: Any, membrane: Any, near_m: Any, reach: Any,
    out: Any,
) -> None:  # fmt: skip
    """Continue the object along its tangent planes, up to ``reach`` cells beyond its border, and measure its gap there.

    The membrane's depth along the ray of such a cell is looked up in the tactile image, starting from the depth of the
    nearest cell of the object. Where the membrane is steep or hidden, that does not converge: there is no measured gap.

    Parameters
    ----------
    known : bool, shape (H, W)
        Cells of the object; there must be none within ``reach`` cells of the border.
    excluded, points : float32, shape (H, W) and (H, W, 4)
        Those of `average_cells`. Cells with an excluded share of a half or more are left out.
    surface : tuple of float32, shapes (2, H, W) and (H, W)
        Sides and facing of `measure_cells`, which are continued.
    rays, membrane : RayWindow, MembraneImage
        The window begins with the first cell, perhaps outside the image.
    side : int
        Of a cell, pixels.
    near_m : tuple of float
        Centre and limit: a difference farther than the limit from the centre is no membrane, but a wrong depth.
    reach : int
        Also of the window over which tangent planes are fitted.
    out : tuple
        Three images, (H, W): which cells are of the object, then also those beside it; and beside the object the depth
        of the tangent plane minus that of the membrane, metres, and 1 where the membrane is seen, 0 elsewhere. Three
        buffers: twice int32, H * W elements, and float32, (3, H * W).
    """
    sides, facing = surface
    linked, differences, weights, sources, queue, planes = out
    height, width = known.shape
    count = 0
    sources[:] = -1
    for v in range(1, height - 1):
        for u in range(1, width - 1):
            if not known[v, u] or points[v, u, 3] == _ZERO:
                continue
            if not (known[v, u - 1] and known[v, u + 1] and known[v - 1, u] and known[v + 1, u]):
                place = v * width + u
                queue[count], sources[place] = place, place
                planes[0, place], planes[1, place], planes[2, place] = _tangent_plane(points, v, u, reach)
                count += 1
    # ring by ring outwards: each cell continues the border cell from which it was reached first
    first, border = 0, count
    for _ in range(reach):
        last = count
        for i in range(first, last):
            v, u = queue[i] // width, queue[i] % width
            for row in range(max(v - 1, 1), min(v + 2, height - 1)):
                for column in range(max(u - 1, 1), min(u + 2, width - 1)):
                    place = row * width + column
                    if not known[row, column] and excluded[row, column] < _HALF and sources[place] < 0:
                        sources[place], queue[count] = sources[queue[i]], place
                        count += 1
        first = last
    table, top, left = rays
    image_height, image_width = table.shape[0], table.shape[1]
    for i in range(border, count):
        v, u = queue[i] // width, queue[i] % width
        pixel_v, pixel_u = top + v * side + side // 2, left + u * side + side // 2
        if not (0 <= pixel_v < image_height and 0 <= pixel_u < image_width):
            continue
        source = sources[queue[i]]
        from_v, from_u = source // width, source % width
        ray_x, ray_y = table[pixel_v, pixel_u, 0], table[pixel_v, pixel_u, 1]
        turn = 1 - planes[0, source] * ray_x - planes[1, source] * ray_y
        plane = planes[2, source] / max(turn, _MIN_TURN)
        _, _, depth = _mean_point(points, from_v, from_u)
        found, seen = _membrane_depth(pixel_v * image_width + pixel_u, np.float32(depth), membrane)
        difference = np.float32(plane - found)
        # a plane along the ray is no surface
        seen = seen and turn > _MIN_TURN and abs(difference - near_m[0]) < near_m[1]
        linked[v, u], weights[v, u] = True, np.float32(seen)
        differences[v, u] = difference if seen else _ZERO
        sides[0, v, u], sides[1, v, u] = sides[0, from_v, from_u], sides[1, from_v, from_u]
        facing[v, u] = facing[from_v, from_u]
