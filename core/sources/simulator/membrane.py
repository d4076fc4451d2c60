"""The inflated membrane: mesh, rubber, air, and the contact problem that gives its shape.

The sheet is a mesh of constant-strain triangles of incompressible rubber (neo-Hookean, stiffening with strain as Yeoh's
model does) without bending stiffness, clamped at its rim. Air in the chamber obeys p (V + V_dead) = const, so pressing
at one place bulges the rest. A rigid object is not penetrated: signed distance >= 0 at every node, reaction >= 0, one
of the two zero. Along the object nodes slide without friction, or stick.

The equilibrium minimises the energy of rubber, air and atmosphere under that inequality, by Nesterov's accelerated
gradient with projection to the object's surface and restarts. Everything is float64 and single-threaded, so that
the same input gives the same bits.

Lengths are metres in the membrane's frame: origin in the centre of the rim's plane, x along the long side, z outward,
away from the cameras.
"""

from __future__ import annotations

from collections.abc import Callable
from contextvars import ContextVar
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, NamedTuple

import cv2
import numpy as np

from ...contact.kernels.simd import LANES, double_scratch, doubles, gather, load, store
from ...model.arrays import BoolArray, Float64Array, Int32Array
from .objects import NO_OBJECT, allocating, compiled, distance, normal, to_surface

#: A mesh with fewer columns tears in deep presses. From the second number on, a mesh is inflated from a coarser one.
#: Shipped scenes have smaller meshes, which are inflated by themselves: a test compares their bits with the solver's.
_FEWEST_COLUMNS, _REFINED_COLUMNS = 56, 224
#: What is called in this thread after each equilibrium: it shows progress, and may end the work by raising.
ON_SOLVED: Final[ContextVar[Callable[[], None]]] = ContextVar("on_solved", default=lambda: None)
#: Number of folds round the turned part of a twisted membrane, and its radius, metres.
_FOLDS: Final = 18
_FOLD_INNER_M: Final = 0.018


@dataclass(frozen=True)
class MembraneDesign:
    """Size, material and air of the membrane."""

    #: Free size of the rubber between the clamps, and height of the untouched membrane over the rim's plane.
    width_m: float = 0.355
    height_m: float = 0.205
    apex_m: float = 0.060
    #: Air in the housing below the rim's plane.
    dead_volume_m3: float = 0.0090
    #: Shear modulus times thickness, and c in W = mu/2 (I + c I^2), I = tr C - 3.
    stiffness_n_m: float = 220.0
    stiffening: float = 0.05
    #: Height of the folds of a twisted membrane, crest over mean, see `_folds`.
    fold_m: float = 0.0
    #: How far the sheet was stretched, in both directions, when it was clamped.
    prestretch: float = 1.04
    #: Difference of the stiffness between the right and the left edge, relative; factor on it in the centre.
    stiffness_slope: float = 0.0
    centre_stiffness: float = 1.0
    #: A node that touches keeps its place on the object until it comes off, instead of sliding without friction.
    sticks: bool = False
    #: Quads along width and height; both even keep the mesh mirror-symmetric.
    cells: tuple[int, int] = (118, 68)


@dataclass(frozen=True)
class Mesh:
    """The sheet as N nodes and T triangles."""

    #: (N, 3): clamped, not inflated.
    flat: Float64Array
    #: (T, 3): node numbers; the normals of the inflated sheet point outward.
    triangles: Int32Array
    #: (T, 2, 2): inverse of the unstretched edge matrix.
    inverse: Float64Array
    #: (T,): unstretched areas, square metres; shear modulus times thickness times area, N m.
    area: Float64Array
    stiffness: Float64Array
    #: (N,): height of the outer surface over the mean surface along z, the folds.
    relief_m: Float64Array
    #: (N,): False on the rim.
    free: BoolArray


def build_mesh(design: MembraneDesign) -> Mesh:
    """Divide the sheet into quads, and these by alternating diagonals into triangles."""
    nx, ny = design.cells
    xs = np.linspace(-design.width_m / 2, design.width_m / 2, nx + 1)
    ys = np.linspace(-design.height_m / 2, design.height_m / 2, ny + 1)
    grid_x, grid_y = np.meshgrid(xs, ys)
    flat = np.stack([grid_x.ravel(), grid_y.ravel(), np.zeros(grid_x.size)], axis=1)

    j, i = np.mgrid[:ny, :nx]
    a = (j * (nx + 1) + i).ravel()
    b, c, d = a + 1, a + nx + 2, a + nx + 1
    rising = ((i + j) % 2 == 0).ravel()[:, None]
    first = np.where(rising, np.stack([a, b, c], 1), np.stack([a, b, d], 1))
    second = np.where(rising, np.stack([a, c, d], 1), np.stack([b, c, d], 1))
    triangles = np.stack([first, second], 1).reshape(-1, 3).astype(np.int32)

    unstretched = flat[:, :2] / design.prestretch
    corners = unstretched[triangles]
    edges = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
    free = (np.abs(flat[:, 0]) < design.width_m / 2 - 1e-9) & (np.abs(flat[:, 1]) < design.height_m / 2 - 1e-9)
    inverse = np.asarray(np.linalg.inv(edges), dtype=np.float64)
    area = np.asarray(np.linalg.det(edges) / 2, dtype=np.float64)
    stiffness = design.stiffness_n_m * area
    middle = flat[triangles, :2].mean(axis=1)
    if design.stiffness_slope or design.centre_stiffness != 1.0:
        centred = np.exp(-((np.hypot(middle[:, 0], middle[:, 1]) / (design.height_m / 3)) ** 2))
        stiffness *= 1.0 + design.stiffness_slope * middle[:, 0] / design.width_m
        stiffness *= 1.0 + (design.centre_stiffness - 1.0) * centred
    return Mesh(flat, triangles, inverse, area, stiffness, _folds(flat, design.fold_m) * free, free)


def _folds(flat: Float64Array, height_m: float) -> Float64Array:
    """Return the height of the folds at nodes of a sheet that is twisted about its centre, (N,).

    Shear leaves tension along the diagonals only, so the folds run out from the turned part as spirals that cross every
    circle at 45 degrees. They are widest apart, and highest, a little outside of it.
    """
    radius, angle = np.hypot(flat[:, 0], flat[:, 1]), np.arctan2(flat[:, 1], flat[:, 0])
    near = np.maximum(radius, _FOLD_INNER_M) / _FOLD_INNER_M
    envelope = np.clip((radius - _FOLD_INNER_M / 2) / _FOLD_INNER_M, 0.0, 1.0) * np.exp(
        -(((radius - 2 * _FOLD_INNER_M) / (2 * _FOLD_INNER_M)) ** 2)
    )
    return np.asarray(height_m * envelope * np.cos(_FOLDS * (angle + np.log(near))), dtype=np.float64)


ATMOSPHERE_PA: Final = 101_325.0
#: Nodes closer than this to the object count as touching, metres.
TOUCH_GAP_M: Final = 1e-7
#: The descent has overshot where the residual exceeds the smallest one by this factor.
_OVERSHOT: Final = 1e3
#: Shortest step, as a share of the step that the start's stiffness allows.
_SHORTEST_SHARE: Final = 0.05
_MAX_ITERATIONS: Final = 6000
#: Projections, two in each step of the descent, in which a node that sticks may be off before it slides.
_PATIENCE: Final = 100


@dataclass(frozen=True)
class MembraneState:
    """One equilibrium of N nodes."""

    #: (N, 3): positions of the mean surface; `Membrane.surface` adds the folds.
    nodes: Float64Array
    #: (N,): force with which the object pushes each node along its normal; 0 where free. Friction comes on top.
    reaction_n: Float64Array
    #: (N,): signed distance of the surface to the object.
    gap_m: Float64Array
    pressure_pa: float  # absolute
    #: Largest unbalanced nodal force over the gauge pressure's force on a mean node.
    residual: float


class _Sheet(NamedTuple):
    """Rubber as in `Mesh` and `MembraneDesign`, in arrays of whole vectors of triangles, and the air in the chamber."""

    #: (T',) each: places of the corners' x in flattened nodes; elements of the inverse; stiffness, 0 beyond the end.
    corners: tuple[Int32Array, Int32Array, Int32Array]
    inverse: tuple[Float64Array, Float64Array, Float64Array, Float64Array]
    stiffness: Float64Array
    triangles: int  # T, without those that fill the last vector
    free: BoolArray
    stiffening: float
    gas_joule: float  # p V
    dead_volume_m3: float
    nodal_area_m2: float  # mean over the nodes


class _Object(NamedTuple):
    """A rigid object, and the height of the sheet's folds over each node, at which the sheet meets it."""

    kind: int
    pose: Float64Array
    relief_m: Float64Array


class _Grips(NamedTuple):
    """Where nodes stick to the object: point and normal there, (N, 3); NaN for nodes that slide.

    A node that was off in as many projections as its patience, (N,), slides from then on: one that sticks and comes off
    in turn would never be in balance.
    """

    point: Float64Array
    normal: Float64Array
    patience: Int32Array

    @classmethod
    def of(cls, point: Float64Array) -> _Grips:
        return cls(point, np.full_like(point, np.nan), np.full(len(point), _PATIENCE, np.int32))


class _Clearance(NamedTuple):
    """Node n was ``distance[n]`` from the object at ``place[n]``; while it stays within, no distance is needed."""

    place: Float64Array
    distance: Float64Array


@compiled
def _distance(thing: _Object, nodes: Float64Array, n: int) -> float:
    x, y, z = nodes[n, 0], nodes[n, 1], nodes[n, 2] + thing.relief_m[n]
    return float(distance(thing.kind, thing.pose, x, y, z))


@compiled
def _normal(thing: _Object, nodes: Float64Array, n: int) -> tuple[float, float, float]:
    return normal(thing.kind, thing.pose, nodes[n, 0], nodes[n, 1], nodes[n, 2] + thing.relief_m[n])


_scratch = double_scratch(10 * LANES)


@compiled
def _forces(nodes: Float64Array, sheet: _Sheet, elastic: Float64Array, swept: Float64Array) -> float:
    """Fill in the gradients of the elastic energy and of the volume over the rim's plane; return that volume."""
    elastic[:] = 0.0
    swept[:] = 0.0
    flat, pulled, moved = nodes.reshape(-1), elastic.reshape(-1), swept.reshape(-1)
    one, three, six, stiffening = doubles(1.0), doubles(3.0), doubles(6.0), doubles(2.0 * sheet.stiffening)
    xs, ys, zs = flat, flat[1:], flat[2:]
    found = _scratch()
    volume = 0.0
    for first in range(0, sheet.triangles, LANES):
        a, b, c = load(sheet.corners[0], first), load(sheet.corners[1], first), load(sheet.corners[2], first)
        az, bz, cz = gather(zs, a), gather(zs, b), gather(zs, c)
        ux, uy, uz = gather(xs, b) - gather(xs, a), gather(ys, b) - gather(ys, a), bz - az
        vx, vy, vz = gather(xs, c) - gather(xs, a), gather(ys, c) - gather(ys, a), cz - az
        i00, i01 = load(sheet.inverse[0], first), load(sheet.inverse[1], first)
        i10, i11 = load(sheet.inverse[2], first), load(sheet.inverse[3], first)
        # Columns of the deformation gradient F.
        px, py, pz = ux * i00 + vx * i10, uy * i00 + vy * i10, uz * i00 + vz * i10
        qx, qy, qz = ux * i01 + vx * i11, uy * i01 + vy * i11, uz * i01 + vz * i11
        c00, c01, c11 = px * px + py * py + pz * pz, px * qx + py * qy + pz * qz, qx * qx + qy * qy + qz * qz
        det = c00 * c11 - c01 * c01
        # First Piola-Kirchhoff stress (1 + 2 c I) mu (F - F C^-1 / det C) of
        # W = mu/2 (I + c I^2), I = tr C + 1/det C - 3.
        scale = one / (det * det)
        s00, s01, s11 = one - c11 * scale, c01 * scale, one - c00 * scale
        weight = load(sheet.stiffness, first) * (one + stiffening * (c00 + c11 + one / det - three))
        fx, fy, fz = px * s00 + qx * s01, py * s00 + qy * s01, pz * s00 + qz * s01
        gx, gy, gz = px * s01 + qx * s11, py * s01 + qy * s11, pz * s01 + qz * s11
        store(found, 0 * LANES, weight * (fx * i00 + gx * i01))
        store(found, 1 * LANES, weight * (fy * i00 + gy * i01))
        store(found, 2 * LANES, weight * (fz * i00 + gz * i01))
        store(found, 3 * LANES, weight * (fx * i10 + gx * i11))
        store(found, 4 * LANES, weight * (fy * i10 + gy * i11))
        store(found, 5 * LANES, weight * (fz * i10 + gz * i11))
        nz = (ux * vy - uy * vx) / six
        store(found, 6 * LANES, (uy * vz - uz * vy) / six)
        store(found, 7 * LANES, (uz * vx - ux * vz) / six)
        store(found, 8 * LANES, nz)
        store(found, 9 * LANES, nz * (az + bz + cz))
        for n in range(min(LANES, sheet.triangles - first)):
            # unsigned, or each access would test for a negative index
            at, bt = np.uint32(sheet.corners[0][first + n]), np.uint32(sheet.corners[1][first + n])
            ct = np.uint32(sheet.corners[2][first + n])
            for k in range(3):
                of_b, of_c, area = found[k * LANES + n], found[(3 + k) * LANES + n], found[(6 + k) * LANES + n]
                pulled[bt + k] += of_b
                pulled[ct + k] += of_c
                pulled[at + k] -= of_b + of_c
                moved[at + k] += area
                moved[bt + k] += area
                moved[ct + k] += area
            volume += found[9 * LANES + n]
    return float(volume)


@compiled
def _gradient(nodes: Float64Array, sheet: _Sheet, swept: Float64Array, out: Float64Array) -> float:
    """Fill in the gradient of the total energy (minus the nodal forces); return the gauge pressure."""
    volume = _forces(nodes, sheet, out, swept)
    gauge = sheet.gas_joule / (volume + sheet.dead_volume_m3) - ATMOSPHERE_PA
    for n in range(nodes.shape[0]):
        for k in range(3):
            out[n, k] = out[n, k] - gauge * swept[n, k] if sheet.free[n] else 0.0
    return float(gauge)


@compiled
def _copy_node(source: Float64Array, n: int, target: Float64Array) -> None:
    """Copy row ``n``; ``target[n] = source[n]`` would create an array."""
    target[n, 0], target[n, 1], target[n, 2] = source[n, 0], source[n, 1], source[n, 2]


@compiled
def _stick(nodes: Float64Array, n: int, grips: _Grips) -> bool:
    """Put a node back to where it sticks, unless it moves out of the object; return whether it sticks."""
    if np.isnan(grips.point[n, 0]):
        return False
    away = 0.0
    for k in range(3):
        away += (nodes[n, k] - grips.point[n, k]) * grips.normal[n, k]
    if away <= 0.0:
        _copy_node(grips.point, n, nodes)
        return True
    grips.patience[n] -= 1
    if grips.patience[n] == 0:
        grips.point[n, 0] = np.nan
    return False


@compiled
def _project(
    nodes: Float64Array, base: Float64Array, free: BoolArray, thing: _Object, grips: _Grips, clear: _Clearance
) -> None:
    """Move penetrating nodes out to the surface, along the normals at ``base``, or back to where they stick.

    With the step's own start as base a node rests only where its force is along the true normal, even where the
    distance is a bound and its inner level sets are not parallel to the surface.
    """
    place = clear.place
    for n in range(nodes.shape[0]):
        if not free[n]:
            continue
        if _stick(nodes, n, grips):
            clear.distance[n] = 0.0
            continue
        x, y, z = nodes[n, 0] - place[n, 0], nodes[n, 1] - place[n, 1], nodes[n, 2] - place[n, 2]
        if x * x + y * y + z * z < clear.distance[n] * clear.distance[n]:
            continue
        depth = _distance(thing, nodes, n)
        if depth >= 0.0:
            _copy_node(nodes, n, place)
            clear.distance[n] = depth
            continue
        clear.distance[n] = 0.0
        nx, ny, nz = _normal(thing, base, n)
        for _ in range(8):
            nodes[n, 0] -= depth * nx
            nodes[n, 1] -= depth * ny
            nodes[n, 2] -= depth * nz
            depth = _distance(thing, nodes, n)
            if depth > -1e-12:
                break


@compiled
def _balance(
    nodes: Float64Array,
    gradient: Float64Array,
    thing: _Object,
    grips: _Grips,
    reaction: Float64Array,
    gap: Float64Array,
) -> float:
    """Split each node's out-of-balance force into reaction and residual; return the largest residual."""
    worst = 0.0
    for n in range(nodes.shape[0]):
        gx, gy, gz = gradient[n, 0], gradient[n, 1], gradient[n, 2]
        reaction[n] = 0.0
        gap[n] = _distance(thing, nodes, n)
        if gap[n] <= TOUCH_GAP_M:
            nx, ny, nz = _normal(thing, nodes, n)
            push = gx * nx + gy * ny + gz * nz
            if push > 0.0:
                reaction[n] = push
                gx, gy, gz = gx - push * nx, gy - push * ny, gz - push * nz
                held = grips.point[n]
                if nodes[n, 0] == held[0] and nodes[n, 1] == held[1] and nodes[n, 2] == held[2]:
                    gx, gy, gz = 0.0, 0.0, 0.0  # friction carries the rest
        worst = max(worst, gx * gx + gy * gy + gz * gz)
    return float(np.sqrt(worst))


@compiled
def _accelerate(nodes: Float64Array, fresh: Float64Array, ahead: Float64Array, momentum: float) -> float:
    """Move ``nodes`` to ``fresh`` and ``ahead`` beyond it; return the next momentum m' = (1 + sqrt(1 + 4 m^2)) / 2.

    ``ahead = fresh + (m - 1) / m' (fresh - nodes)``. Momentum that leads uphill is dropped: the restart by gradient of
    O'Donoghue and Candes.
    """
    uphill = 0.0
    for n in range(nodes.shape[0]):
        for k in range(3):
            uphill += (ahead[n, k] - fresh[n, k]) * (fresh[n, k] - nodes[n, k])
    following = 0.5 * (1.0 + np.sqrt(1.0 + 4.0 * momentum * momentum))
    beta = (momentum - 1.0) / following
    if uphill > 0.0:
        following, beta = 1.0, 0.0
    for n in range(nodes.shape[0]):
        for k in range(3):
            ahead[n, k] = fresh[n, k] + beta * (fresh[n, k] - nodes[n, k])
            nodes[n, k] = fresh[n, k]
    return float(following)


@allocating
def _relax(
    nodes: Float64Array, sheet: _Sheet, thing: _Object, grips: _Grips, step: float, tolerance: float, limit: int
) -> tuple[float, Float64Array, Float64Array]:
    """Descend to equilibrium in place; return the relative residual, the reactions and the gaps."""
    count = nodes.shape[0]
    reaction, gap = np.zeros(count), np.zeros(count)
    gradient, swept = np.empty_like(nodes), np.empty_like(nodes)
    ahead, clear = nodes.copy(), _Clearance(nodes.copy(), np.zeros(count))
    _project(ahead, nodes, sheet.free, thing, grips, clear)
    nodes[:] = ahead
    momentum = 1.0
    relative = np.inf
    least, kept = np.inf, nodes.copy()
    for iteration in range(limit):
        gauge = _gradient(ahead, sheet, swept, gradient)
        if iteration % 20 == 19:
            worst = _balance(ahead, gradient, thing, grips, reaction, gap)
            relative = worst / (abs(gauge) * sheet.nodal_area_m2)
            if relative < tolerance:
                nodes[:] = ahead
                break
            if not relative < _OVERSHOT * least:
                nodes[:] = kept
                relative = np.inf
                break
            if relative < least:
                least = relative
                kept[:] = nodes
        fresh = ahead - step * gradient
        _project(fresh, ahead, sheet.free, thing, grips, clear)
        momentum = _accelerate(nodes, fresh, ahead, momentum)
        _project(ahead, nodes, sheet.free, thing, grips, clear)
    return relative, reaction, gap


class Membrane:
    """The membrane filled with the air that brings its untouched apex to the design's height."""

    def __init__(self, design: MembraneDesign | None = None, tolerance: float = 1e-3) -> None:
        self.design = design or MembraneDesign()
        self.mesh = build_mesh(self.design)
        self.tolerance = tolerance
        self._direction = np.random.default_rng(0).standard_normal(self.mesh.flat.shape) * self.mesh.free[:, None]
        self._gas_joule = 0.0  # p V, found next
        self.rest = self._inflate()

    @cached_property
    def coarse(self) -> Membrane | None:
        """The same membrane on a mesh half as fine, for first guesses; None where that would be too coarse."""
        columns, rows = self.design.cells
        if columns < 2 * _FEWEST_COLUMNS:
            return None
        return Membrane(replace(self.design, cells=(columns // 4 * 2, rows // 4 * 2)), self.tolerance)

    def press(
        self,
        kind: int,
        pose: Float64Array,
        start: Float64Array | None = None,
        held: Float64Array | None = None,
        tolerance: float | None = None,
    ) -> MembraneState:
        """Solve the contact problem with an object whose pose (3, 4) takes points of the membrane's frame to its own.

        ``start``, (N, 3), is the first guess, by default the untouched membrane. ``held``, (N, 3), are places on the
        object where nodes stick while they touch; NaN for nodes that slide, as all do by default. ``tolerance`` is that
        of the residual, by default the membrane's own.
        """
        nodes = self.rest.nodes if start is None else start
        thing = _Object(kind, pose, self.mesh.relief_m)
        grips = _Grips.of(np.full_like(nodes, np.nan) if held is None else held.copy())
        sticks = ~np.isnan(grips.point[:, 0])
        grips.normal[sticks] = _lay(thing, grips.point, sticks)
        return self._solve(thing, nodes, grips, tolerance or self.tolerance, _MAX_ITERATIONS)

    @property
    def _sheet(self) -> _Sheet:
        mesh, design, area = self.mesh, self.design, self.mesh.area.sum() / len(self.mesh.flat)
        body = (*self._vectors, len(mesh.triangles), mesh.free, design.stiffening)
        return _Sheet(*body, self._gas_joule, design.dead_volume_m3, area)

    @cached_property
    def _vectors(self) -> tuple[Any, Any, Float64Array]:
        """Corners, inverse and stiffness of `_Sheet`."""
        mesh, missing = self.mesh, -len(self.mesh.triangles) % LANES
        rows = (*3 * mesh.triangles.T, *mesh.inverse.reshape(-1, 4).T, mesh.stiffness)
        first, second, third, *inverse, stiffness = (np.pad(row, (0, missing)) for row in rows)
        return (first, second, third), tuple(inverse), stiffness

    def _solve(self, thing: _Object, start: Float64Array, grips: _Grips, tolerance: float, limit: int) -> MembraneState:
        sheet = self._sheet
        nodes, share = start.copy(), 0.8
        while True:
            step = share / self._curvature(nodes)
            # what lets go in an attempt that overshoots holds in the next
            own = _Grips(grips.point.copy(), grips.normal, grips.patience.copy())
            residual, reaction, gap = _relax(nodes, sheet, thing, own, step, tolerance, limit)
            # Compressed triangles are stiffer than at the start: too long a step overshoots for good.
            if np.isfinite(residual) or share < _SHORTEST_SHARE:
                break
            share /= 2
        ON_SOLVED.get()()
        volume = _forces(nodes, sheet, np.empty_like(nodes), np.empty_like(nodes)) + self.design.dead_volume_m3
        return MembraneState(nodes, reaction, gap, float(self._gas_joule / volume), float(residual))

    def _curvature(self, nodes: Float64Array) -> float:
        """Estimate the largest eigenvalue of the energy's Hessian by power iteration, warm from call to call."""
        sheet, step = self._sheet, 1e-6
        here, there, swept = np.empty_like(nodes), np.empty_like(nodes), np.empty_like(nodes)
        _gradient(nodes, sheet, swept, here)
        eigenvalue = 0.0
        for _ in range(12):
            self._direction /= np.linalg.norm(self._direction)
            _gradient(nodes + step * self._direction, sheet, swept, there)
            self._direction = (there - here) / step
            eigenvalue = float(np.linalg.norm(self._direction))
        return eigenvalue

    def _inflate(self) -> MembraneState:
        """Find the amount of air, in p V, that lifts the apex to the design's height, by the secant rule."""
        design = self.design
        if design.cells[0] >= _REFINED_COLUMNS and self.coarse is not None:
            nodes = self.interpolated(self.coarse, self.coarse.rest.nodes)
            amounts = [self.coarse._gas_joule, 1.0001 * self.coarse._gas_joule]
        else:
            x, y = 2 * self.mesh.flat[:, 0] / design.width_m, 2 * self.mesh.flat[:, 1] / design.height_m
            nodes = self.mesh.flat.copy()
            nodes[:, 2] = design.apex_m * (1 - x * x) * (1 - y * y)
            dome = 0.55 * design.apex_m * design.width_m * design.height_m + design.dead_volume_m3
            amounts = [dome * (ATMOSPHERE_PA + 1500.0), dome * (ATMOSPHERE_PA + 2500.0)]
        errors: list[float] = []
        nothing = _Object(NO_OBJECT, np.zeros((3, 4)), self.mesh.relief_m)
        no_grips = _Grips.of(np.full_like(nodes, np.nan))
        for _ in range(12):
            self._gas_joule = amounts[len(errors)]
            state = self._solve(nothing, nodes, no_grips, self.tolerance / 10, 20_000)
            nodes = state.nodes
            errors.append(float(nodes[:, 2].max()) - design.apex_m)
            if abs(errors[-1]) < 2e-7:
                break
            if len(errors) >= 2:
                slope = (errors[-1] - errors[-2]) / (amounts[-1] - amounts[-2])
                amounts.append(amounts[-1] - errors[-1] / slope)
        return state

    def interpolated(self, other: Membrane, nodes: Float64Array) -> Float64Array:
        """Return the nodes of the same membrane on another mesh, interpolated at this mesh's, (N, 3)."""
        nodes = other.at(self.mesh.flat[:, :2], nodes)
        nodes[~self.mesh.free] = self.mesh.flat[~self.mesh.free]
        return nodes

    def gradient(self, nodes: Float64Array) -> Float64Array:
        """Return the gradient of the total energy at any nodes, (N, 3), newtons."""
        gradient = np.empty_like(nodes)
        _gradient(nodes, self._sheet, np.empty_like(nodes), gradient)
        return gradient

    def surface(self, nodes: Float64Array) -> Float64Array:
        """Return the outer surface, folds included, (N, 3)."""
        surface = nodes.copy()
        surface[:, 2] += self.mesh.relief_m
        return surface

    def at(self, flat: Float64Array, nodes: Float64Array) -> Float64Array:
        """Return the present positions, (M, 3), of points of the flat sheet, (M, 2), interpolated between nodes."""
        (nx, ny), design = self.design.cells, self.design
        grid = nodes.reshape(ny + 1, nx + 1, 3)
        s = np.clip((flat[:, 0] / design.width_m + 0.5) * nx, 0, nx)
        t = np.clip((flat[:, 1] / design.height_m + 0.5) * ny, 0, ny)
        i, j = np.minimum(s.astype(np.intp), nx - 1), np.minimum(t.astype(np.intp), ny - 1)
        fs, ft = (s - i)[:, None], (t - j)[:, None]
        upper = (1 - fs) * grid[j, i] + fs * grid[j, i + 1]
        lower = (1 - fs) * grid[j + 1, i] + fs * grid[j + 1, i + 1]
        return np.asarray((1 - ft) * upper + ft * lower)


def contact_load(membrane: Membrane, state: MembraneState) -> Float64Array:
    """Return the force of the object on each node, friction included, (N, 3), newtons: what rubber and air lack."""
    return np.asarray(np.where((state.reaction_n > 0.0)[:, None], membrane.gradient(state.nodes), 0.0))


def object_pose(rotation: Any, origin: Any) -> Float64Array:
    """Return the 3 x 4 matrix from the surrounding frame to an object's frame."""
    rotation, origin = np.asarray(rotation, dtype=np.float64), np.asarray(origin, dtype=np.float64)
    return np.hstack([rotation.T, -(rotation.T @ origin)[:, None]])


def contact_share(membrane: Membrane, state: MembraneState, kind: int, pose: Float64Array) -> Float64Array:
    """Return how much of each node's share of the sheet is in contact, 0 to 1, shape (N,).

    A node at the edge of contact carries only part of what it would carry if its neighbours touched as well: in one
    dimension a string that leaves the object a way s beyond its last node, in cells of length h, loads that node with
    the share 1/2 + s / h. So the whole load is computed with the first free nodes laid onto the object, and the edge is
    where the share falls through one half. If nodes simply counted as touching or not, the patch would be half a cell
    too wide.
    """
    mesh = membrane.mesh
    touching = state.reaction_n > 0.0
    share = touching.astype(np.float64)
    beside = _beside(touching, membrane.design.cells) & mesh.free
    if not beside.any():
        return share
    thing, laid = _Object(kind, pose, mesh.relief_m), state.nodes.copy()
    _lay(thing, laid, beside)
    gradient = membrane.gradient(laid)
    edge = touching & _beside(~touching, membrane.design.cells)
    for n in np.flatnonzero(edge).tolist():
        nx, ny, nz = _normal(thing, laid, n)
        whole = gradient[n, 0] * nx + gradient[n, 1] * ny + gradient[n, 2] * nz
        share[n] = state.reaction_n[n] / whole if whole > state.reaction_n[n] else 1.0
    return share


def _beside(nodes: BoolArray, cells: tuple[int, int]) -> BoolArray:
    """Return the nodes next to the given ones, diagonals included, without these."""
    grid = nodes.reshape(cells[1] + 1, cells[0] + 1).astype(np.uint8)
    return (cv2.dilate(grid, np.ones((3, 3), np.uint8)).ravel() > 0) & ~nodes


def _lay(thing: _Object, nodes: Float64Array, chosen: BoolArray) -> Float64Array:
    """Move chosen nodes onto the object, in place; return its normals there."""
    relief = np.outer(thing.relief_m[chosen], (0.0, 0.0, 1.0))
    points = nodes[chosen] + relief
    normals = to_surface(thing.kind, points, thing.pose)
    nodes[chosen] = points - relief
    return normals
