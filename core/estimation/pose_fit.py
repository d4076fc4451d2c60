"""Fits of a mesh to a contact patch: from a start by point-to-plane distances, or from many starts.

Motions of the mesh are six lengths: a translation, and a turn about the patch's centre times the mesh's radius. So all
six can be compared, in metres.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from operator import attrgetter
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from ..contact.alignment import tactile_pose
from ..model.arrays import BoolArray, Float32Array, Float64Array, Int64Array, spread
from ..model.clouds import ray_table
from ..model.frames import Rig, pose_matrix
from ..model.patch import ContactPatch
from ..preset import Preset
from .object_mesh import ObjectMesh

#: Side of the image tiles whose points are averaged, pixels of an image that is 640 wide; a tile counts from this share
#: of its pixels.
_TILE_PX, _FILLED = 4, 0.1
#: Tiles along the side of a window, over which errors that tiles share are found.
_WINDOW_TILES: Final = 6
#: Noise density, m^4, of a real L515 at 0.3 m, for presets whose rig was not measured (`CameraNoise.density_m4`).
_DENSITY_M4: Final = 1.6e-11
#: A direction is free if its standard deviation is larger than this, metres, or if it moves the patch out of itself by
#: less than the square root of this share of what the best determined direction does: that much comes from the mesh's
#: triangles alone.
FREE_SIGMA_M: Final = 0.003
_FREE_SHARE: Final = 1e-3
#: Iterations at most, and the step at which they end, metres.
ROUNDS, _DONE_M = 20, 1e-5
#: Points within this distance of the mesh lie on it, metres; or within this many standard deviations.
ON_MESH_M, _ON_MESH_SIGMAS = 0.003, 4.0
#: Pairs farther apart than this do not count, metres, in the first and in the last iterations.
_REACH_M: Final = (0.020, 0.008)
#: Points beyond this many robust standard deviations count less (Huber); the smallest such deviation, metres.
_HUBER, _SMALLEST_SIGMA_M = 3.0, 0.0003
#: Depth noise moves points along the ray, and so by less across an oblique surface; cosines below count as this one.
_LEAST_COSINE: Final = 0.25

#: Orientations from which the whole search starts, the points and iterations of a first fit, and how many are fitted
#: to the end.
_ORIENTATIONS, _QUICK_POINTS, _QUICK_ROUNDS, _FINALISTS = 160, 120, 10, 10
#: Share of the time that the first fits take.
_QUICK_SHARE: Final = 0.9
#: Offsets of the search around a pose, as shares of the mesh's radius, and the number of starts at each.
_NEAR_SHARES, _NEAR_STARTS = (0.15, 0.35), 24
#: Pixels between two rays that look for mesh in front of the membrane, of an image 640 wide.
_RAY_PX: Final = 8
#: Fits whose two-way residuals differ by less than this fit equally well, metres. Of these the nearest is taken: noise
#: would prefer one of them, and slide an object along its axis.
_EQUAL_M: Final = 0.0001
#: A mesh in front of the membrane by less than this may be noise, by more than that counts no more, metres.
_NOISE_M, _WORST_M = 0.002, 0.010

Progress = Callable[[float], None]


@dataclass(frozen=True, eq=False)
class PatchPoints:
    """A patch averaged over image tiles, weighted by the noise.

    ``points``, (N, 3), are means in metres in the proximity depth frame, ``windows``, (N,), the numbers of the windows
    of tiles that they belong to. ``weights``, (N,), are inverse variances of their depth, 1 / m^2: the tile's area over
    the noise density, which contains what neighbours share, so that sums over many tiles have the right variance.
    """

    points: Float64Array
    weights: Float64Array
    windows: Int64Array

    @cached_property
    def centre_m(self) -> Float64Array:
        """Weighted mean of the points, metres."""
        return np.asarray(np.average(self.points, axis=0, weights=self.weights))

    def every(self, step: int) -> PatchPoints:
        return PatchPoints(self.points[::step], self.weights[::step], self.windows[::step])


def patch_points(points: Float32Array | Float64Array, rig: Rig, density_m4: float) -> PatchPoints:
    """Average points of the proximity image over its tiles."""
    camera = rig.proximity.intrinsics
    points = np.asarray(points, np.float64)
    side = max(round(_TILE_PX * camera.width / 640), 1)
    pixels = camera.fx * points[:, 0] / points[:, 2], camera.fy * points[:, 1] / points[:, 2]
    u, v = (np.floor(where / side).astype(np.int64) + 4096 for where in pixels)
    tiles, inverse, counts = np.unique(v * 8192 + u, return_inverse=True, return_counts=True)
    means = np.stack([np.bincount(inverse, points[:, k], len(tiles)) for k in range(3)], axis=1) / counts[:, None]
    kept = counts >= _FILLED * side**2
    tiles, means, counts = tiles[kept], means[kept], counts[kept]
    areas = counts * means[:, 2] ** 2 / (camera.fx * camera.fy)
    windows = tiles // 8192 // _WINDOW_TILES * 8192 + tiles % 8192 // _WINDOW_TILES
    return PatchPoints(means, areas / density_m4, windows)


def noise_density_m4(preset: Preset, rig: Rig) -> float:
    """Return the noise power of a patch per area, m^4: that of both cameras' weighted mean."""
    if preset.noise is None:
        return _DENSITY_M4
    near = preset.noise.proximity.density_m4(rig.proximity.intrinsics.fx)
    film = preset.noise.tactile.density_m4(rig.tactile.intrinsics.fx)
    return max(near * film / (near + film) if near + film > 0 else 0.0, 1e-16)


@dataclass(frozen=True, eq=False)
class Fit:
    """A mesh fitted to a patch: ``pose`` is ``T_proximity_object``, turns are about ``centre_m``.

    ``directions`` (6, 6) are orthonormal motions in columns: the translation, then the turn times the mesh's radius.
    ``sigmas_m`` (6,) are the standard deviations along them, not finite where nothing determines it, ``free`` (6,) what
    the patch does not determine. ``overlap`` is the weighted share of points that lie on the mesh, ``residual_m``
    their RMS distance along its normals (nan without any), ``cost_m`` the RMS distance of all points to the mesh, none
    counted as more than 10 mm.
    """

    pose: Float64Array
    centre_m: Float64Array
    directions: Float64Array
    sigmas_m: Float64Array
    free: BoolArray
    residual_m: float
    overlap: float
    cost_m: float


def moved(pose: Float64Array, motion: Float64Array, centre_m: Float64Array, radius_m: float) -> Float64Array:
    """Return a pose after a motion of six lengths: a translation, and a turn about a centre times the radius."""
    turn = Rotation.from_rotvec(motion[3:] / radius_m).as_matrix()
    return pose_matrix(turn @ pose[:3, :3], turn @ (pose[:3, 3] - centre_m) + centre_m + motion[:3])


def motion_between(before: Float64Array, after: Float64Array, centre_m: Float64Array, radius_m: float) -> Float64Array:
    """Return the motion of six lengths that takes one pose to another, as `moved` takes it."""
    turn = after[:3, :3] @ before[:3, :3].T
    shift = after[:3, 3] - turn @ (before[:3, 3] - centre_m) - centre_m
    return np.concatenate([shift, Rotation.from_matrix(turn).as_rotvec() * radius_m])


def fit(mesh: ObjectMesh, patch: PatchPoints, start: Float64Array, rounds: int = ROUNDS) -> Fit:
    """Fit a mesh to a patch by point-to-plane ICP (Chen and Medioni 1992), held at the start in free directions.

    Each point is paired with the closest point of the mesh, if that faces the camera. A step is solved in the
    eigenvectors of the Hessian that the patch determines (Zhang, Kaess, Singh, "On degeneracy of optimization-based
    state estimation problems", ICRA 2016). ``start`` is ``T_proximity_object``, off by less than 20 mm.
    """
    pose, centre = start, patch.centre_m
    for number in range(rounds):
        pairs = _pair(mesh, patch, pose, centre, _REACH_M[number > 3])
        values, vectors = np.linalg.eigh((pairs.rows * pairs.weights[:, None]).T @ pairs.rows)
        known = ~_is_free(values, 1.0)
        step = vectors[:, known] @ (
            (vectors[:, known].T @ (pairs.rows.T @ (pairs.weights * pairs.gaps))) / values[known]
        )
        step *= min(1.0, _REACH_M[0] / 2 / max(float(np.linalg.norm(step)), 1e-12))
        pose = moved(pose, step, centre, mesh.radius_m)
        if number > 3 and np.abs(step).max() < _DONE_M:
            break
    pairs = _pair(mesh, patch, pose, centre, _REACH_M[1])
    values, vectors = np.linalg.eigh((pairs.rows * pairs.weights[:, None]).T @ pairs.rows)
    inflation = _inflation(pairs, patch)
    overlap = float(np.average(pairs.on_mesh, weights=patch.weights))
    residual = math.sqrt(float(np.mean(pairs.gaps[pairs.on_mesh] ** 2))) if pairs.on_mesh.any() else math.nan
    cost = math.sqrt(float(np.mean(np.minimum(pairs.apart, 0.010) ** 2)))
    with np.errstate(divide="ignore"):
        sigmas = np.sqrt(inflation / np.maximum(values, 0.0))
    return Fit(pose, centre, vectors, sigmas, _is_free(values, inflation), residual, overlap, cost)


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Points and the closest points of the mesh: signed distances along its normals, rows of the Jacobian, weights."""

    gaps: Float64Array
    apart: Float64Array
    rows: Float64Array
    weights: Float64Array
    on_mesh: BoolArray


def _pair(mesh: ObjectMesh, patch: PatchPoints, pose: Float64Array, centre: Float64Array, reach_m: float) -> _Pairs:
    rotation = pose[:3, :3]
    places, normals = mesh.closest((patch.points - pose[:3, 3]) @ rotation)
    places, normals = places @ rotation.T + pose[:3, 3], normals @ rotation.T
    away = patch.points - places
    gaps, apart = (away * normals).sum(axis=1), np.linalg.norm(away, axis=1)
    cosines = -(normals * places).sum(axis=1) / np.linalg.norm(places, axis=1)
    facing = cosines > 0
    used = facing & (apart < reach_m)
    cosines = np.maximum(cosines, _LEAST_COSINE)
    along_ray = np.abs(gaps) / cosines
    sigma = max(spread(along_ray[used]) if used.any() else 0.0, _SMALLEST_SIGMA_M)
    weights = patch.weights / cosines**2 * used / np.maximum(along_ray / (_HUBER * sigma), 1)
    rows = np.concatenate([normals, np.cross(places - centre, normals) / mesh.radius_m], axis=1)
    return _Pairs(gaps, apart, rows, weights, facing & (apart < max(ON_MESH_M, _ON_MESH_SIGMAS * sigma)))


def _is_free(values: Float64Array, inflation: float) -> BoolArray:
    """Return which eigenvalues of a Hessian, 1 / m^2, are those of free directions."""
    return np.asarray((values < _FREE_SHARE * max(values[-1], 1.0)) | (values < inflation / FREE_SIGMA_M**2))


def _inflation(pairs: _Pairs, patch: PatchPoints) -> float:
    """Return the factor on variances, at least 1, by errors of mesh or camera that many tiles share."""
    _, window = np.unique(patch.windows, return_inverse=True)
    information = np.bincount(window, pairs.weights)
    pulls = np.bincount(window, pairs.weights * pairs.gaps)
    counted = information > 0.25 * information.max() if len(information) else np.zeros(0, np.bool_)
    independent = np.count_nonzero(counted) - 6
    if independent < 1:
        return 1.0
    return max(1.0, float((pulls[counted] ** 2 / information[counted]).sum()) / independent)


@dataclass(frozen=True, eq=False)
class Membrane:
    """Where the membrane is, seen along a grid of proximity rays; nothing of the mesh can lie in front of it.

    ``rays``, (N, 3), are ``(x / z, y / z, 1)``; ``depth_m``, (N,), is the membrane's depth in the tactile camera, and
    ``to_depth``, (4,), the factors of x, y, z and 1 that give a point's depth there. Each ray stands for ``area_px``.
    """

    rays: Float64Array
    depth_m: Float64Array
    to_depth: Float64Array
    area_px: float

    @classmethod
    def of(cls, patch: ContactPatch, preset: Preset) -> Membrane:
        """Return the membrane that a patch was found in."""
        camera, measured = patch.rig.proximity.intrinsics, patch.aligned.measured_m
        step = max(round(_RAY_PX * camera.width / 640), 1)
        grid = np.s_[step // 2 :: step, step // 2 :: step]
        depth = measured[grid].astype(np.float64).ravel()
        rays = np.concatenate([ray_table(camera)[grid].reshape(-1, 2), np.ones((depth.size, 1))], axis=1)
        to_depth = np.array([0.0, 0.0, 1.0, 0.0])
        if preset.alignment.model == "rigid":
            to_depth = np.linalg.inv(tactile_pose(preset.alignment, patch.rig))[2]
        seen = np.isfinite(depth)
        return cls(rays[seen].astype(np.float64), depth[seen], to_depth, float(step**2))

    def crossed_m(self, mesh: ObjectMesh, pose: Float64Array, patch_px: int) -> float:
        """Return how far a mesh lies in front of the membrane: RMS over the area of the patch, metres."""
        lengths, hit = mesh.hits(-pose[:3, 3] @ pose[:3, :3], self.rays @ pose[:3, :3])
        depth = (self.rays[hit] @ self.to_depth[:3]) * lengths[hit] + self.to_depth[3]
        beyond = np.clip(self.depth_m[hit] - depth - _NOISE_M, 0.0, _WORST_M)
        return math.sqrt(float((beyond**2).sum()) * self.area_px / max(patch_px, 1))


@dataclass(frozen=True, eq=False)
class Search:
    """Searches for a mesh in one patch. ``progress`` gets the share done, 0 to 1, and ends a search by raising."""

    mesh: ObjectMesh
    patch: PatchPoints
    film: Membrane
    patch_px: int
    progress: Progress = lambda share: None

    def fitted(self, start: Float64Array, patch: PatchPoints | None = None, rounds: int = ROUNDS) -> Fit:
        """Return the fit from one start; its cost is two-way: patch to mesh, and mesh in front of the membrane."""
        found = fit(self.mesh, patch or self.patch, start, rounds)
        crossed_m = self.film.crossed_m(self.mesh, found.pose, self.patch_px)
        return replace(found, cost_m=math.hypot(found.cost_m, crossed_m))

    def everywhere(self, pose: Float64Array | None) -> Fit:
        """Search all orientations. Of equally good fits take the one nearest to a pose, else that touched centrally."""
        mesh, centre = self.mesh, self.patch.centre_m
        toward = centre / np.linalg.norm(centre)
        corners = mesh.vertices_m[mesh.triangles]
        places, normals = corners.mean(axis=1), np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        starts = []
        for rotation in _spread_rotations(_ORIENTATIONS):
            seen = np.minimum(normals @ rotation.T @ toward, 0.0)  # area that faces the camera
            if not seen.any():
                continue  # the back of an open surface
            seen_centre = (places * seen[:, None]).sum(axis=0) / seen.sum()
            starts.append(pose_matrix(rotation, centre - rotation @ seen_centre))

        def off_centre_m(found: Fit) -> float:
            own = found.pose
            return float(np.linalg.norm(own[:3, :3] @ mesh.centre_m + own[:3, 3] - centre))

        return self._best(starts, off_centre_m if pose is None else self._away_from(pose))

    def near(self, pose: Float64Array) -> Fit:
        random, radius_m = np.random.default_rng(0), self.mesh.radius_m
        starts = [pose]
        for share in _NEAR_SHARES:
            motions = share * radius_m / math.sqrt(2) * random.normal(size=(_NEAR_STARTS, 6))
            starts += [moved(pose, motion, self.patch.centre_m, radius_m) for motion in motions]
        return self._best(starts, self._away_from(pose))

    def _away_from(self, pose: Float64Array) -> Callable[[Fit], float]:
        centre, radius_m = self.patch.centre_m, self.mesh.radius_m
        return lambda found: float(np.linalg.norm(motion_between(pose, found.pose, centre, radius_m)))

    def _best(self, starts: list[Float64Array], distance_m: Callable[[Fit], float]) -> Fit:
        """Fit from all starts with few points, then from the best ones with all; of equally good fits, the nearest."""
        few = self.patch.every(max(len(self.patch.points) // _QUICK_POINTS, 1))
        quick, final = list[Fit](), list[Fit]()
        for number, start in enumerate(starts):
            self.progress(_QUICK_SHARE * number / len(starts))
            quick.append(self.fitted(start, few, _QUICK_ROUNDS))
        quick.sort(key=attrgetter("cost_m"))
        nearest = sorted(_equal(quick), key=distance_m)[: _FINALISTS // 2]
        others = [found for found in quick if found not in nearest]
        for number, found in enumerate((nearest + others)[:_FINALISTS]):
            self.progress(_QUICK_SHARE + (1 - _QUICK_SHARE) * number / _FINALISTS)
            final.append(self.fitted(found.pose))
        return min(_equal(final), key=distance_m)


def _equal(found: list[Fit]) -> list[Fit]:
    """Return the fits that are about as good as the best one."""
    least_m = min(each.cost_m for each in found)
    return [each for each in found if each.cost_m <= least_m + _EQUAL_M]


def _spread_rotations(count: int) -> Float64Array:
    """Return rotations that cover all orientations evenly, (N, 3, 3) (Alexa, "Super-Fibonacci spirals", CVPR 2022)."""
    s = np.arange(count) + 0.5
    t = s / count
    alpha, beta = 2 * np.pi * s / math.sqrt(2), 2 * np.pi * s / 1.533751168755204288118041
    r, big = np.sqrt(t), np.sqrt(1 - t)
    quaternions = np.stack([r * np.sin(alpha), r * np.cos(alpha), big * np.sin(beta), big * np.cos(beta)], axis=1)
    return np.asarray(Rotation.from_quat(quaternions).as_matrix())
