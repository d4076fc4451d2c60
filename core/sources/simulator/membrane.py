"""The inflated membrane: mesh, rubber, air, and the contact problem that gives its shape.

The sheet is a mesh of constant-strain triangles with three displacements a node, made of
incompressible rubber (neo-Hookean, stiffening with strain as Yeoh's model does) without bending
stiffness and clamped at its rim. Air in the
chamber obeys p (V + V_dead) = const, so that pressing at one place bulges the rest. A rigid object
must not be penetrated: signed distance >= 0 at every node, reaction >= 0, one of the two zero.
Along the object nodes slide without friction, or stick.

The equilibrium minimises the energy of rubber, air and atmosphere under that inequality, by
Nesterov's accelerated gradient with projection to the object's surface and restarts.
Lengths are metres in the membrane's frame: origin in the centre of the rim's plane, x along the
long side, z outward, away from the cameras. Everything is float64 and single-threaded, so that the
same input gives the same bits.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np

from ...model.arrays import BoolArray, Float64Array, Int32Array
from .mesh import MembraneDesign, build_mesh
from .objects import NO_OBJECT, compiled, distance, normal

ATMOSPHERE_PA: Final = 101_325.0
#: Nodes closer than this to the object count as touching, metres.
TOUCH_GAP_M: Final = 1e-7
#: The descent has overshot where the residual exceeds the smallest one by this factor.
_OVERSHOT: Final = 1e3
#: Shortest step, as a share of the step that the start's stiffness allows.
_SHORTEST_SHARE: Final = 0.05
#: A node nearer to the object than this lies on it, metres.
_ON_SURFACE_M = 1e-9


@dataclass(frozen=True)
class MembraneState:
    """One equilibrium.

    Attributes
    ----------
    nodes : float64, shape (N, 3)
        Positions of the mean surface in the membrane's frame, metres; `Membrane.surface` adds the folds.
    reaction_n : float64, shape (N,)
        Force with which the object pushes each node along its normal, newtons; 0 where free. Friction comes on top.
    gap_m : float64, shape (N,)
        Signed distance of each node of the surface to the object.
    pressure_pa : float
        Absolute air pressure.
    volume_m3 : float
        Air volume, dead volume included.
    residual : float
        Largest unbalanced nodal force over the gauge pressure's force on a mean node.
    iterations : int
    """

    nodes: Float64Array
    reaction_n: Float64Array
    gap_m: Float64Array
    pressure_pa: float
    volume_m3: float
    residual: float
    iterations: int


@compiled
def _forces(
    nodes: Float64Array,
    triangles: Int32Array,
    inverse: Float64Array,
    stiffness: Float64Array,
    stiffening: float,
    elastic: Float64Array,
    swept: Float64Array,
) -> float:
    """Fill in the gradients of the elastic energy and of the volume over the rim's plane; return that volume."""
    elastic[:] = 0.0
    swept[:] = 0.0
    volume = 0.0
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ux, uy, uz = nodes[b, 0] - nodes[a, 0], nodes[b, 1] - nodes[a, 1], nodes[b, 2] - nodes[a, 2]
        vx, vy, vz = nodes[c, 0] - nodes[a, 0], nodes[c, 1] - nodes[a, 1], nodes[c, 2] - nodes[a, 2]
        i00, i01, i10, i11 = inverse[t, 0, 0], inverse[t, 0, 1], inverse[t, 1, 0], inverse[t, 1, 1]
        # Columns of the deformation gradient F.
        px, py, pz = ux * i00 + vx * i10, uy * i00 + vy * i10, uz * i00 + vz * i10
        qx, qy, qz = ux * i01 + vx * i11, uy * i01 + vy * i11, uz * i01 + vz * i11
        c00, c01, c11 = px * px + py * py + pz * pz, px * qx + py * qy + pz * qz, qx * qx + qy * qy + qz * qz
        det = c00 * c11 - c01 * c01
        # First Piola-Kirchhoff stress (1 + 2 c I) mu (F - F C^-1 / det C) of
        # W = mu/2 (I + c I^2), I = tr C + 1/det C - 3.
        scale = 1.0 / (det * det)
        s00, s01, s11 = 1.0 - c11 * scale, c01 * scale, 1.0 - c00 * scale
        weight = stiffness[t] * (1.0 + 2.0 * stiffening * (c00 + c11 + 1.0 / det - 3.0))
        ax, ay, az = px * s00 + qx * s01, py * s00 + qy * s01, pz * s00 + qz * s01
        bx, by, bz = px * s01 + qx * s11, py * s01 + qy * s11, pz * s01 + qz * s11
        fbx, fby, fbz = weight * (ax * i00 + bx * i01), weight * (ay * i00 + by * i01), weight * (az * i00 + bz * i01)
        fcx, fcy, fcz = weight * (ax * i10 + bx * i11), weight * (ay * i10 + by * i11), weight * (az * i10 + bz * i11)
        elastic[b, 0] += fbx
        elastic[b, 1] += fby
        elastic[b, 2] += fbz
        elastic[c, 0] += fcx
        elastic[c, 1] += fcy
        elastic[c, 2] += fcz
        elastic[a, 0] -= fbx + fcx
        elastic[a, 1] -= fby + fcy
        elastic[a, 2] -= fbz + fcz
        nx, ny, nz = (uy * vz - uz * vy) / 6.0, (uz * vx - ux * vz) / 6.0, (ux * vy - uy * vx) / 6.0
        volume += nz * (nodes[a, 2] + nodes[b, 2] + nodes[c, 2])
        for node in (a, b, c):
            swept[node, 0] += nx
            swept[node, 1] += ny
            swept[node, 2] += nz
    return float(volume)


@compiled
def _gradient(
    nodes: Float64Array,
    triangles: Int32Array,
    inverse: Float64Array,
    stiffness: Float64Array,
    free: BoolArray,
    stiffening: float,
    air: Float64Array,
    swept: Float64Array,
    out: Float64Array,
) -> float:
    """Fill in the gradient of the total energy (minus the nodal forces); return the gauge pressure."""
    volume = _forces(nodes, triangles, inverse, stiffness, stiffening, out, swept)
    gas_joule, dead_volume, ambient = air[0], air[1], air[2]
    gauge = gas_joule / (volume + dead_volume) - ambient
    for n in range(nodes.shape[0]):
        for k in range(3):
            out[n, k] = out[n, k] - gauge * swept[n, k] if free[n] else 0.0
    return float(gauge)


@compiled
def _project(
    kind: int,
    pose: Float64Array,
    nodes: Float64Array,
    base: Float64Array,
    relief: Float64Array,
    free: BoolArray,
    grips: Float64Array,
    place: Float64Array,
    clear: Float64Array,
) -> None:
    """Move penetrating nodes out to the surface, along the normals at ``base``, or back to where they stick.

    A node sticks at ``grips[n, :3]``, where the normal is ``grips[n, 3:]``, while it does not move out of the object.
    Node n was ``clear[n]`` from the object at ``place[n]``; as long as it stays within, no distance is needed.

    With the step's own start as base a node rests only where its force is along the true normal, even
    where the distance is a bound and its inner level sets are not parallel to the surface.
    """
    for n in range(nodes.shape[0]):
        if not free[n]:
            continue
        if not np.isnan(grips[n, 0]):
            away = 0.0
            for k in range(3):
                away += (nodes[n, k] - grips[n, k]) * grips[n, 3 + k]
            if away <= 0.0:
                nodes[n], clear[n] = grips[n, :3], 0.0
                continue
        x, y, z = nodes[n, 0] - place[n, 0], nodes[n, 1] - place[n, 1], nodes[n, 2] - place[n, 2]
        if x * x + y * y + z * z < clear[n] * clear[n]:
            continue
        depth = distance(kind, pose, nodes[n, 0], nodes[n, 1], nodes[n, 2] + relief[n])
        if depth >= 0.0:
            place[n], clear[n] = nodes[n], depth
            continue
        clear[n] = 0.0
        nx, ny, nz = normal(kind, pose, base[n, 0], base[n, 1], base[n, 2] + relief[n])
        for _ in range(8):
            nodes[n, 0] -= depth * nx
            nodes[n, 1] -= depth * ny
            nodes[n, 2] -= depth * nz
            depth = distance(kind, pose, nodes[n, 0], nodes[n, 1], nodes[n, 2] + relief[n])
            if depth > -1e-12:
                break


@compiled
def _balance(
    kind: int,
    pose: Float64Array,
    nodes: Float64Array,
    relief: Float64Array,
    gradient: Float64Array,
    grips: Float64Array,
    reaction: Float64Array,
    gap: Float64Array,
) -> float:
    """Split the out-of-balance force of each node into reaction and residual; return the largest residual."""
    worst = 0.0
    for n in range(nodes.shape[0]):
        gx, gy, gz = gradient[n, 0], gradient[n, 1], gradient[n, 2]
        reaction[n] = 0.0
        gap[n] = distance(kind, pose, nodes[n, 0], nodes[n, 1], nodes[n, 2] + relief[n])
        if gap[n] <= TOUCH_GAP_M:
            nx, ny, nz = normal(kind, pose, nodes[n, 0], nodes[n, 1], nodes[n, 2] + relief[n])
            push = gx * nx + gy * ny + gz * nz
            if push > 0.0:
                reaction[n] = push
                gx, gy, gz = gx - push * nx, gy - push * ny, gz - push * nz
                if nodes[n, 0] == grips[n, 0] and nodes[n, 1] == grips[n, 1] and nodes[n, 2] == grips[n, 2]:
                    gx, gy, gz = 0.0, 0.0, 0.0  # friction carries the rest
        worst = max(worst, gx * gx + gy * gy + gz * gz)
    return float(np.sqrt(worst))


@compiled
def _relax(
    nodes: Float64Array,
    triangles: Int32Array,
    inverse: Float64Array,
    stiffness: Float64Array,
    free: BoolArray,
    stiffening: float,
    air: Float64Array,
    relief: Float64Array,
    kind: int,
    pose: Float64Array,
    grips: Float64Array,
    nodal_area: float,
    step: float,
    tolerance: float,
    limit: int,
    reaction: Float64Array,
    gap: Float64Array,
) -> tuple[int, float]:
    """Descend to equilibrium in place; return the iterations and the relative residual."""
    gradient, swept = np.empty_like(nodes), np.empty_like(nodes)
    ahead, place, clear = nodes.copy(), nodes.copy(), np.zeros(nodes.shape[0])
    _project(kind, pose, ahead, nodes, relief, free, grips, place, clear)
    nodes[:] = ahead
    momentum = 1.0
    relative = np.inf
    least, kept = np.inf, nodes.copy()
    done = 0
    for iteration in range(limit):
        gauge = _gradient(ahead, triangles, inverse, stiffness, free, stiffening, air, swept, gradient)
        if iteration % 20 == 19:
            worst = _balance(kind, pose, ahead, relief, gradient, grips, reaction, gap)
            relative = worst / (abs(gauge) * nodal_area)
            done = iteration + 1
            if relative < tolerance:
                nodes[:] = ahead
                return done, relative
            if not relative < _OVERSHOT * least:
                nodes[:] = kept
                return done, np.inf
            if relative < least:
                least = relative
                kept[:] = nodes
        fresh = ahead - step * gradient
        _project(kind, pose, fresh, ahead, relief, free, grips, place, clear)
        uphill = 0.0
        for n in range(nodes.shape[0]):
            for k in range(3):
                uphill += (ahead[n, k] - fresh[n, k]) * (fresh[n, k] - nodes[n, k])
        following = 0.5 * (1.0 + np.sqrt(1.0 + 4.0 * momentum * momentum))
        beta = (momentum - 1.0) / following
        if uphill > 0.0:
            following, beta = 1.0, 0.0
        momentum = following
        for n in range(nodes.shape[0]):
            for k in range(3):
                ahead[n, k] = fresh[n, k] + beta * (fresh[n, k] - nodes[n, k])
                nodes[n, k] = fresh[n, k]
        _project(kind, pose, ahead, nodes, relief, free, grips, place, clear)
    return done, relative


class Membrane:
    """The membrane filled with the air that brings its untouched apex to the design's height."""

    def __init__(self, design: MembraneDesign | None = None, tolerance: float = 1e-3) -> None:
        self.design = design or MembraneDesign()
        self.mesh = build_mesh(self.design)
        self.tolerance = tolerance
        self._direction = np.random.default_rng(0).standard_normal(self.mesh.flat.shape) * self.mesh.free[:, None]
        self._air = np.array([0.0, self.design.dead_volume_m3, ATMOSPHERE_PA])
        self.rest = self._inflate()

    def press(
        self,
        kind: int,
        pose: Float64Array,
        start: Float64Array | None = None,
        limit: int = 6000,
        held: Float64Array | None = None,
    ) -> MembraneState:
        """Solve the contact problem with an object in place.

        Parameters
        ----------
        kind : int
            One of the objects' kinds, or ``NO_OBJECT``.
        pose : float64, shape (3, 4)
            Takes points of the membrane's frame to the object's.
        start : float64, shape (N, 3), optional
            First guess; the untouched membrane by default.
        limit : int
            Maximum number of iterations; see `MembraneState.residual`.
        held : float64, shape (N, 3), optional
            Places on the object where nodes stick while they touch; NaN for nodes that slide, as all do by default.
        """
        nodes = self.rest.nodes if start is None else start
        grips = np.full((len(nodes), 6), np.nan)
        if held is not None:
            sticks = ~np.isnan(held[:, 0])
            grips[sticks, :3] = held[sticks]
            _lay(kind, pose, grips, self.mesh.relief_m, sticks)
            _turn(kind, pose, grips, self.mesh.relief_m)
        return self._solve(kind, pose, nodes, grips, self.tolerance, limit)

    def _solve(
        self, kind: int, pose: Float64Array, start: Float64Array, grips: Float64Array, tolerance: float, limit: int
    ) -> MembraneState:
        mesh, stiffening = self.mesh, self.design.stiffening
        body = (mesh.triangles, mesh.inverse, mesh.stiffness, mesh.free, stiffening, self._air)
        nodal_area = mesh.area.sum() / len(start)
        reaction, gap = np.zeros(len(start)), np.zeros(len(start))
        nodes, iterations, share = start.copy(), 0, 0.8
        while True:
            step = share / self._curvature(nodes)
            done, residual = _relax(
                nodes, *body, mesh.relief_m, kind, pose, grips, nodal_area, step, tolerance, limit, reaction, gap
            )
            iterations += done
            # Compressed triangles are stiffer than at the start: too long a step overshoots for good.
            if residual < tolerance or share < _SHORTEST_SHARE:
                break
            share /= 2
        scratch = np.empty_like(nodes)
        volume = _forces(nodes, *body[:3], stiffening, scratch, np.empty_like(nodes)) + self.design.dead_volume_m3
        return MembraneState(
            nodes, reaction, gap, float(self._air[0] / volume), float(volume), float(residual), int(iterations)
        )

    def _curvature(self, nodes: Float64Array) -> float:
        """Estimate the largest eigenvalue of the energy's Hessian by power iteration, warm from call to call."""
        mesh, step = self.mesh, 1e-6
        body = (mesh.triangles, mesh.inverse, mesh.stiffness, mesh.free, self.design.stiffening, self._air)
        here, there, swept = np.empty_like(nodes), np.empty_like(nodes), np.empty_like(nodes)
        _gradient(nodes, *body, swept, here)
        eigenvalue = 0.0
        for _ in range(12):
            self._direction /= np.linalg.norm(self._direction)
            _gradient(nodes + step * self._direction, *body, swept, there)
            self._direction = (there - here) / step
            eigenvalue = float(np.linalg.norm(self._direction))
        return eigenvalue

    def _inflate(self) -> MembraneState:
        """Find the amount of air, in p V, that lifts the apex to the design's height, by the secant rule."""
        design = self.design
        x, y = 2 * self.mesh.flat[:, 0] / design.width_m, 2 * self.mesh.flat[:, 1] / design.height_m
        nodes = self.mesh.flat.copy()
        nodes[:, 2] = design.apex_m * (1 - x * x) * (1 - y * y)
        empty, no_grips = np.zeros((3, 4)), np.full((len(nodes), 6), np.nan)
        dome = 0.55 * design.apex_m * design.width_m * design.height_m + design.dead_volume_m3
        amounts, errors = [dome * (ATMOSPHERE_PA + 1500.0), dome * (ATMOSPHERE_PA + 2500.0)], list[float]()
        for _ in range(12):
            self._air[0] = amounts[len(errors)]
            state = self._solve(NO_OBJECT, empty, nodes, no_grips, self.tolerance / 10, 20_000)
            nodes = state.nodes
            errors.append(float(nodes[:, 2].max()) - design.apex_m)
            if abs(errors[-1]) < 2e-7:
                break
            if len(errors) >= 2:
                slope = (errors[-1] - errors[-2]) / (amounts[-1] - amounts[-2])
                amounts.append(amounts[-1] - errors[-1] / slope)
        return state

    def gradient(self, nodes: Float64Array) -> Float64Array:
        """Return the gradient of the total energy at any nodes: float64, shape (N, 3), newtons."""
        mesh, gradient = self.mesh, np.empty_like(nodes)
        body = (mesh.triangles, mesh.inverse, mesh.stiffness, mesh.free, self.design.stiffening, self._air)
        _gradient(nodes, *body, np.empty_like(nodes), gradient)
        return gradient

    def surface(self, nodes: Float64Array) -> Float64Array:
        """Return the outer surface, folds included: float64, shape (N, 3)."""
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

    def stretches(self, nodes: Float64Array) -> Float64Array:
        """Return the principal stretches of every triangle: float64, shape (T, 2), larger first."""
        corners = nodes[self.mesh.triangles]
        edges = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
        gradient = edges @ self.mesh.inverse
        squares = np.linalg.eigvalsh(gradient.transpose(0, 2, 1) @ gradient)
        stretches: Float64Array = np.sqrt(squares[:, ::-1])
        return stretches


def object_pose(rotation: Any, origin: Any) -> Float64Array:
    """Return the 3 x 4 matrix from the surrounding frame to an object's frame."""
    rotation, origin = np.asarray(rotation, dtype=np.float64), np.asarray(origin, dtype=np.float64)
    return np.hstack([rotation.T, -(rotation.T @ origin)[:, None]])


def contact_torque(
    membrane: Membrane, state: MembraneState, kind: int, pose: Float64Array
) -> tuple[float, float, float]:
    """Return the torque of the reactions on the object about its origin, N m, along the membrane's axes.

    The parameters are those of `contact_share`. Friction, where nodes stick, is not counted.
    """
    touching = np.flatnonzero(state.reaction_n)
    points = membrane.surface(state.nodes)[touching]
    normals = np.array([normal(kind, pose, *point) for point in points]).reshape(-1, 3)
    origin = -pose[:, :3].T @ pose[:, 3]
    x, y, z = np.cross(points - origin, -normals * state.reaction_n[touching, None]).sum(axis=0)
    return float(x), float(y), float(z)


def contact_share(membrane: Membrane, state: MembraneState, kind: int, pose: Float64Array) -> Float64Array:
    """Return how much of each node's share of the sheet is in contact, 0 to 1, shape (N,).

    A node at the edge of contact carries only part of what it would carry if its neighbours touched as well: in
    one dimension a string that leaves the object a way s beyond its last node, in cells of length h, loads that
    node with the share 1/2 + s / h, whether pressure or tension about a curved object makes the load. So the whole
    load is computed with the first free nodes laid onto the object, and the edge is where the share falls through
    one half. Where nodes simply count as touching or not, the patch is half a cell too wide.

    Parameters
    ----------
    membrane : Membrane
    state : MembraneState
    kind : int
        Kind of the object.
    pose : float64, shape (3, 4)
        From the membrane's frame to the object's.
    """
    mesh = membrane.mesh
    touching = state.reaction_n > 0.0
    share = touching.astype(np.float64)
    beside = _beside(touching, membrane.design.cells) & mesh.free
    if not beside.any():
        return share
    laid = state.nodes.copy()
    _lay(kind, pose, laid, mesh.relief_m, beside)
    gradient = membrane.gradient(laid)
    edge = touching & _beside(~touching, membrane.design.cells)
    whole = np.zeros(len(laid))
    _loads(kind, pose, laid, mesh.relief_m, gradient, edge, whole)
    share[edge] = np.where(whole[edge] > state.reaction_n[edge], state.reaction_n[edge] / whole[edge], 1.0)
    return share


def _beside(nodes: BoolArray, cells: tuple[int, int]) -> BoolArray:
    """Return the nodes next to the given ones, diagonals included, without these."""
    grid = nodes.reshape(cells[1] + 1, cells[0] + 1).astype(np.uint8)
    return (cv2.dilate(grid, np.ones((3, 3), np.uint8)).ravel() > 0) & ~nodes


@compiled
def _lay(kind: int, pose: Float64Array, nodes: Float64Array, relief: Float64Array, chosen: BoolArray) -> None:
    """Move the chosen nodes onto the object."""
    for n in range(nodes.shape[0]):
        if not chosen[n]:
            continue
        for _ in range(20):
            gap = distance(kind, pose, nodes[n, 0], nodes[n, 1], nodes[n, 2] + relief[n])
            if abs(gap) < _ON_SURFACE_M:
                break
            nx, ny, nz = normal(kind, pose, nodes[n, 0], nodes[n, 1], nodes[n, 2] + relief[n])
            nodes[n, 0] -= gap * nx
            nodes[n, 1] -= gap * ny
            nodes[n, 2] -= gap * nz


@compiled
def _turn(kind: int, pose: Float64Array, grips: Float64Array, relief: Float64Array) -> None:
    """Write the object's normal beside the places where nodes stick."""
    for n in range(grips.shape[0]):
        if not np.isnan(grips[n, 0]):
            turned = normal(kind, pose, grips[n, 0], grips[n, 1], grips[n, 2] + relief[n])
            grips[n, 3], grips[n, 4], grips[n, 5] = turned


@compiled
def _loads(
    kind: int,
    pose: Float64Array,
    nodes: Float64Array,
    relief: Float64Array,
    gradient: Float64Array,
    chosen: BoolArray,
    load: Float64Array,
) -> None:
    """Write the part of the chosen nodes' unbalanced force that the object carries."""
    for n in range(nodes.shape[0]):
        if chosen[n]:
            nx, ny, nz = normal(kind, pose, nodes[n, 0], nodes[n, 1], nodes[n, 2] + relief[n])
            load[n] = gradient[n, 0] * nx + gradient[n, 1] * ny + gradient[n, 2] * nz
