"""Contact from the mechanics of the membrane: the contact pressure that explains its measured shape.

Kuppuswamy et al., "Fast Model-Based Contact Patch and Pose Estimation for Highly Deformable Dense-Geometry Tactile
Sensors", RA-L 2020: a mesh of the untouched membrane, the quadratic program of its equilibrium, and PIQP, a proximal
interior-point solver. Rays and positions are in the tactile camera's frame, metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from scipy import sparse
from scipy.spatial import Delaunay

from ..errors import FrameError, TactuneError, extra
from ..model.arrays import BoolArray, Float32Array, Float64Array, IndexArray, Uint16Array
from ..model.clouds import valid_depth
from ..model.frames import Rig, SensorFrame
from ..model.intrinsics import Intrinsics
from ..model.patch import ContactPatch
from ..preset import Preset
from .single_camera import MembraneView, rival_patch

ATMOSPHERE_PA = 101_325.0
#: Gauge pressure of the untouched membrane, and volume of air below the plane of its rim.
GAUGE_PRESSURE_PA = 1600.0
HOUSING_M3 = 0.009
#: Approximate number of mesh nodes, as in the paper.
NODES = 440
#: A node is in contact above this share of the air's present gauge pressure; a flat object carries all of it.
CONTACT_SHARE = 0.5
#: What a contact pressure as large as the gauge pressure costs, in squared millimetres of misfit at one node.
REGULARISATION = 1.0

_MIN_NODES = 20
#: Minimum share of the nodes with a measured depth.
_SEEN_SHARE = 0.6
#: A depth that differs by more than this from the mean of its surroundings is a false match, metres.
_FALSE_MATCH_M = 0.015
#: Notches in the region's outline up to this width are closed.
_NICK_PX = 15
#: Nodes with a smaller cosine between ray and normal are not used, because their displacement is uncertain.
_EDGE_ON = 0.3
_LARGEST_RADIUS_M = 10.0
_MM = 1e-3
_TOLERANCE = 1e-10
_MAX_STEPS = 60


class MembraneMechanics:
    """Finds the nodes of an elastic, pressurised membrane that carry contact pressure."""

    def __init__(self, preset: Preset, rig: Rig, untouched: SensorFrame, nodes: int = NODES) -> None:
        untouched.check_against(rig)
        self._rig = rig
        self._view = MembraneView(preset.alignment, rig)
        factor_m = self._factor_m = rig.tactile.depth_unit_m * preset.alignment.depth_scale
        offset_m = preset.alignment.depth_offset_m
        mesh = build_mesh(untouched.tactile_depth, rig.tactile.intrinsics, factor_m, offset_m, nodes)
        self.problem = MembraneProblem(mesh)
        self._untouched = mesh.sample(untouched.tactile_depth, factor_m)
        self._way_per_depth = np.linalg.norm(mesh.positions, axis=1) / mesh.positions[:, 2]
        self._pixels, self._corners, self._weights = interpolation(mesh)

    def find(self, frame: SensorFrame) -> ContactPatch:
        frame.check_against(self._rig)
        counts = frame.tactile_depth
        x = self.problem.solve(self.way_m(counts))
        contact = self.pressure_image(x) > CONTACT_SHARE * self.problem.air_pressure(x)
        points = self._view.points(contact, counts)
        return rival_patch(frame, self._rig, points, lambda: self._view.pick(contact, counts))

    def way_m(self, counts: Uint16Array) -> Float64Array:
        """Return each node's displacement along its ray since the untouched frame, metres; nan where unseen."""
        now = self.problem.mesh.sample(counts, self._factor_m)
        way_m = (now - self._untouched) * self._factor_m * self._way_per_depth
        seen = np.count_nonzero(np.isfinite(way_m))
        if seen < _SEEN_SHARE * len(way_m):
            raise FrameError(
                f"mechanics: only {seen} of {len(way_m)} nodes of the membrane have depth; check what the camera sees"
            )
        return np.asarray(way_m)

    def pressure_image(self, x: Float64Array) -> Float32Array:
        """Return the contact pressure over the untouched gauge pressure, shape (Ht, Wt); 0 off the mesh."""
        pressure = self.problem.contact_pressure(x).astype(np.float32)
        image = np.zeros(self._rig.tactile.intrinsics.shape, np.float32)
        image.reshape(-1)[self._pixels] = np.einsum("ij,ij->i", pressure[self._corners], self._weights)
        return image


@dataclass(frozen=True, eq=False)
class MembraneMesh:
    """N nodes and their triangles, counter-clockwise as seen from outside."""

    pixels: Float64Array  # (N, 2): (u, v) in the tactile image
    positions: Float64Array  # (N, 3)
    normals: Float64Array  # (N, 3): outward, away from the camera
    triangles: IndexArray
    rim: BoolArray  # (N,): on the outline, where the membrane is clamped
    region: BoolArray  # (Ht, Wt): tactile pixels that the mesh covers
    spacing_px: float  # between neighbouring nodes

    @property
    def facing(self) -> Float64Array:
        """Cosines between rays and normals, shape (N,)."""
        rays = self.positions / np.linalg.norm(self.positions, axis=1, keepdims=True)
        return np.asarray(np.einsum("ij,ij->i", rays, self.normals))

    def sample(self, counts: Uint16Array, factor_m: float) -> Float64Array:
        """Return the mean counts around each node, shape (N,); nan where less than half of them have depth."""
        return sample_depth(counts, self.pixels, self.spacing_px, factor_m)


def sample_depth(counts: Uint16Array, pixels: Float64Array, spacing_px: float, factor_m: float) -> Float64Array:
    """Return mean counts in squares around pixels (N, 2), without false matches."""
    width_px = 2 * max(1, round(spacing_px / 4)) + 1
    depth, valid = counts.astype(np.float32), valid_depth(counts)
    near = _box_mean(depth, valid, 3 * width_px, 0.0)
    with np.errstate(invalid="ignore"):
        valid &= np.abs(depth - near) < _FALSE_MATCH_M / factor_m
    mean = _box_mean(depth, valid, width_px, 0.5)
    u, v = (np.ascontiguousarray(pixels[:, i : i + 1], np.float32) for i in range(2))
    looked_up = cv2.remap(mean, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=np.nan)
    return np.asarray(looked_up[:, 0], np.float64)


def build_mesh(
    untouched: Uint16Array, camera: Intrinsics, factor_m: float, offset_m: float, nodes: int
) -> MembraneMesh:
    """Cover the region where the untouched frame has depth with triangles of about equal size in the image."""
    whole = _membrane_region(untouched)
    spacing = np.sqrt(np.count_nonzero(whole) / (0.866 * nodes))
    for _ in range(6):
        region = _eroded(whole, round(spacing / 4))
        if np.count_nonzero(region) < _MIN_NODES:
            raise TactuneError(f"the untouched frame shows {np.count_nonzero(whole)} px of membrane; capture it again")
        outline, inner = _place_nodes(region, spacing)
        found = len(outline) + len(inner)
        if abs(found - nodes) <= 0.02 * nodes:
            break
        spacing *= np.sqrt(found / nodes)
    pixels = np.concatenate([outline, inner])
    depth = sample_depth(untouched, pixels, spacing, factor_m) * factor_m + offset_m
    kept, rim = np.isfinite(depth), np.arange(len(pixels)) < len(outline)
    pixels, depth, rim = pixels[kept], depth[kept], rim[kept]
    triangles = _triangulate(pixels, region) if len(pixels) > _MIN_NODES else np.empty((0, 3), np.int64)
    used = np.unique(triangles)
    inside = np.count_nonzero(~rim[used])
    if inside < _MIN_NODES or inside == len(used):
        raise TactuneError(
            f"only {inside} nodes of the untouched membrane have depth, {_MIN_NODES} are needed; capture it again"
        )
    positions = np.concatenate([camera.normalise(pixels), np.ones((len(pixels), 1))], axis=1) * depth[:, None]
    renumbered = np.full(len(pixels), -1)
    renumbered[used] = np.arange(len(used))
    triangles = renumbered[triangles]
    return MembraneMesh(
        pixels[used], positions[used], _normals(positions[used], triangles), triangles, rim[used], region, spacing
    )


def interpolation(mesh: MembraneMesh) -> tuple[IndexArray, IndexArray, Float32Array]:
    """Return the pixels, nodes and weights that interpolate node values to pixels."""
    owner = np.full(mesh.region.shape, -1, np.int32)
    corners = np.rint(mesh.pixels[mesh.triangles] * 16).astype(np.int32)
    for number, triangle in enumerate(corners):
        cv2.fillConvexPoly(owner, triangle, number, lineType=cv2.LINE_8, shift=4)
    pixels = np.flatnonzero(owner >= 0)
    nodes = mesh.triangles[owner.reshape(-1)[pixels]]
    a, b, c = np.moveaxis(mesh.pixels[nodes], 1, 0)
    v, u = np.divmod(pixels, mesh.region.shape[1])
    p = np.stack([u, v], axis=1)
    whole = _cross(b - a, c - a)
    second, third = _cross(p - a, c - a) / whole, _cross(b - a, p - a) / whole
    weights = np.clip(np.stack([1.0 - second - third, second, third], axis=1), 0.0, 1.0)
    weights /= weights.sum(axis=1, keepdims=True)
    return pixels, nodes, weights.astype(np.float32)


def _membrane_region(untouched: Uint16Array) -> BoolArray:
    """Return the largest part of the image with depth, its holes filled and its outline's nicks closed."""
    padded = cv2.copyMakeBorder(valid_depth(untouched).astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    valid = cv2.morphologyEx(padded, cv2.MORPH_CLOSE, np.ones((_NICK_PX, _NICK_PX), np.uint8))
    outlines, _ = cv2.findContours(valid, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    region = np.zeros_like(valid)
    if outlines:
        cv2.drawContours(region, [max(outlines, key=cv2.contourArea)], -1, 1, cv2.FILLED)
    return np.asarray(region[1:-1, 1:-1].astype(bool))


def _eroded(region: BoolArray, by_px: int) -> BoolArray:
    inside = cv2.copyMakeBorder(region.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    return np.asarray(cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1] > by_px)


def _place_nodes(region: BoolArray, spacing: float) -> tuple[Float64Array, Float64Array]:
    """Return nodes along a region's outline, and a hexagonal grid within it; ``(u, v)`` each."""
    outlines, _ = cv2.findContours(region.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    line = np.asarray(max(outlines, key=cv2.contourArea)[:, 0], np.float64)
    closed = np.concatenate([line, line[:1]])
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    stops = np.linspace(0.0, way[-1], max(3, round(way[-1] / spacing)), endpoint=False)
    rim = np.stack([np.interp(stops, way, closed[:, i]) for i in range(2)], axis=1)

    height, width = region.shape
    rows, columns = np.arange(0.0, height, spacing * np.sqrt(3) / 2), np.arange(0.0, width, spacing)
    u, v = np.meshgrid(columns, rows)
    u[1::2] += spacing / 2
    inner = np.stack([u.ravel(), v.ravel()], axis=1)
    far = _eroded(region, round(0.6 * spacing))
    column, row = np.minimum(np.rint(inner).astype(np.intp), (width - 1, height - 1)).T
    return rim, inner[far[row, column]]


def _triangulate(pixels: Float64Array, region: BoolArray) -> IndexArray:
    """Return the Delaunay triangles within a region, turned so that their normals point away from the camera."""
    triangles = Delaunay(pixels).simplices.astype(np.intp)
    a, b, c = np.moveaxis(pixels[triangles], 1, 0)
    column, row = np.rint((a + b + c) / 3).astype(np.intp).T
    area = _cross(b - a, c - a) / 2
    triangles[area < 0] = triangles[area < 0][:, ::-1]
    return np.asarray(triangles[region[row, column] & (np.abs(area) > 0.5)])


def _normals(positions: Float64Array, triangles: IndexArray) -> Float64Array:
    a, b, c = np.moveaxis(positions[triangles], 1, 0)
    sums = np.zeros_like(positions)
    np.add.at(sums, triangles.reshape(-1), np.repeat(np.cross(b - a, c - a), 3, axis=0))
    return np.asarray(sums / np.linalg.norm(sums, axis=1, keepdims=True))


def _cross(a: Float64Array, b: Float64Array) -> Float64Array:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _box_mean(depth: Float32Array, valid: BoolArray, width_px: int, least: float) -> Float32Array:
    """Return the mean of the valid pixels in squares; nan where their share is not above ``least``."""
    size = (width_px, width_px)
    share = cv2.boxFilter(valid.astype(np.float32), -1, size, borderType=cv2.BORDER_CONSTANT)
    total = cv2.boxFilter(np.where(valid, depth, np.float32(0)), -1, size, borderType=cv2.BORDER_CONSTANT)
    with np.errstate(all="ignore"):
        return np.where(share > least, total / share, np.float32(np.nan)).astype(np.float32)


class MembraneProblem:
    """Equilibrium of the membrane as a quadratic program, solved for one frame after another.

    Minimise ``x' P x / 2 + q' x`` subject to ``A x = 0`` and contact pressures >= 0. ``x`` holds the displacements of
    all nodes but the rim's in millimetres, the rise of the air's pressure and the contact pressures of the same nodes,
    both in units of the untouched gauge pressure. The frames differ in P, which is diagonal, and in q only.
    """

    def __init__(self, mesh: MembraneMesh) -> None:
        stiffness, areas = stiffness_and_areas(mesh.positions, mesh.triangles)
        inner = ~mesh.rim
        self.mesh, self.inner, self.areas_m2 = mesh, inner, areas
        self.radius_m = curvature_radius(mesh, stiffness, areas)
        volume = HOUSING_M3 + enclosed_volume(mesh)
        self.gas_per_m3 = (ATMOSPHERE_PA + GAUGE_PRESSURE_PA) / GAUGE_PRESSURE_PA / volume
        self.A = self._constraints(stiffness)
        moved = int(inner.sum())
        self.positive = slice(moved + 1, 2 * moved + 1)
        self._solver: Any = None

    def _constraints(self, stiffness: sparse.csr_matrix) -> sparse.csc_matrix:
        """Return the equilibrium equation of each inner node, divided by the mean area, and the gas law."""
        areas, mean = self.areas_m2, self.areas_m2[self.inner].mean()
        tension_mm = self.radius_m / 2 * _MM
        share = areas[self.inner] / mean
        balance = [
            sparse.csc_matrix(tension_mm / mean * stiffness[self.inner][:, self.inner]),
            sparse.csc_matrix(-share[:, None]),
            _diagonal(share),
        ]
        gas = np.zeros((1, sum(block.shape[1] for block in balance)))
        gas[0, : balance[0].shape[1]] = self.gas_per_m3 * _MM * areas[self.inner]
        gas[0, balance[0].shape[1]] = 1.0
        return sparse.csc_matrix(sparse.vstack([sparse.hstack(balance), sparse.csc_matrix(gas)]))

    def program(self, way_m: Float64Array) -> tuple[sparse.csc_matrix, Float64Array]:
        """Return P and q for displacements of the nodes along their rays (N,), metres; nan where a node is not seen."""
        cosine, way_mm = self.mesh.facing[self.inner], way_m[self.inner] / _MM
        seen = np.isfinite(way_mm) & (cosine > _EDGE_ON)
        areas = self.areas_m2[self.inner]
        misfit = np.where(seen, 1.0 / np.maximum(cosine, _EDGE_ON) ** 2, 0.0)
        diagonal = np.concatenate([misfit, [0.0], REGULARISATION * areas / areas.mean()])
        q = np.zeros(len(diagonal))
        q[: len(cosine)] = -np.where(seen, way_mm / np.maximum(cosine, _EDGE_ON), 0.0)
        return _diagonal(diagonal), q

    def solve(self, way_m: Float64Array) -> Float64Array:
        """Return x for these displacements."""
        piqp = extra("piqp", "mechanics", "lab")
        P, q = self.program(way_m)
        if self._solver is None:  # the sparsity pattern is ordered and analysed once, with displacements of 0
            self._solver = piqp.SparseSolver()
            settings = self._solver.settings
            settings.eps_abs = settings.eps_rel = _TOLERANCE
            settings.eps_duality_gap_abs = settings.eps_duality_gap_rel = _TOLERANCE
            settings.max_iter = _MAX_STEPS
            lower = np.full(len(q), -np.inf)
            lower[self.positive] = 0.0
            first_P, first_q = self.program(np.zeros(len(self.inner)))
            self._solver.setup(first_P, first_q, self.A, np.zeros(self.A.shape[0]), x_l=lower)
        self._solver.update(P=P, c=q)
        status = self._solver.solve()
        if status != piqp.PIQP_SOLVED:
            steps = self._solver.result.info.iter
            raise TactuneError(f"mechanics: the solver gave up after {steps} steps ({status.name})")
        return np.array(self._solver.result.x)

    def contact_pressure(self, x: Float64Array) -> Float64Array:
        """Return the contact pressure at every node, in units of the gauge pressure, shape (N,)."""
        pressure = np.zeros(len(self.inner))
        pressure[self.inner] = x[self.positive]
        return pressure

    def air_pressure(self, x: Float64Array) -> float:
        """Return the gauge pressure of the air, in units of the untouched one."""
        return 1.0 + float(x[self.positive.start - 1])


def stiffness_and_areas(positions: Float64Array, triangles: IndexArray) -> tuple[sparse.csr_matrix, Float64Array]:
    """Return the stiffness of the surface's Laplace operator (no unit) and the nodes' areas (m^2)."""
    count = len(positions)
    rows, columns, values, areas = [], [], [], np.zeros(count)
    for corner in range(3):
        i, j, k = triangles[:, corner], triangles[:, (corner + 1) % 3], triangles[:, (corner + 2) % 3]
        to_j, to_k = positions[j] - positions[i], positions[k] - positions[i]
        twice_area = np.linalg.norm(np.cross(to_j, to_k), axis=1)
        half_cotangent = np.einsum("ij,ij->i", to_j, to_k) / twice_area / 2
        rows += [j, k, j, k]
        columns += [k, j, j, k]
        values += [-half_cotangent, -half_cotangent, half_cotangent, half_cotangent]
        np.add.at(areas, i, twice_area / 6)
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    return sparse.csr_matrix(entries, shape=(count, count)), areas


def curvature_radius(mesh: MembraneMesh, stiffness: sparse.csr_matrix, areas: Float64Array) -> float:
    """Return the radius of the sphere whose mean curvature is the mesh's average off the rim, metres."""
    inner = ~mesh.rim
    bent = np.einsum("ij,ij->i", stiffness @ mesh.positions, mesh.normals)
    twice_curvature = float(bent[inner].sum() / areas[inner].sum())
    if twice_curvature < 2.0 / _LARGEST_RADIUS_M:
        raise TactuneError("mechanics: the untouched membrane does not bulge outward; inflate it and capture it again")
    return 2.0 / twice_curvature


def enclosed_volume(mesh: MembraneMesh) -> float:
    """Return the volume between the mesh and the plane through its rim, m^3."""
    centroid = mesh.positions[mesh.rim].mean(axis=0)
    normal = np.linalg.svd(mesh.positions[mesh.rim] - centroid)[2][2]
    a, b, c = np.moveaxis(mesh.positions[mesh.triangles] - centroid, 1, 0)
    heights = (a + b + c) @ normal / 3
    return abs(float(np.sum(heights * (np.cross(b - a, c - a) @ normal)) / 2))


def _diagonal(values: Float64Array) -> sparse.csc_matrix:
    """Return a diagonal matrix that stores zeros, too, so that its pattern is always the same."""
    count = len(values)
    return sparse.csc_matrix((values, np.arange(count), np.arange(count + 1)), shape=(count, count))
