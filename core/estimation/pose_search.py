"""Finds the pose of a mesh from a patch alone: many starts, the best by its two-way residual."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from ..contact.alignment import tactile_pose
from ..model.arrays import Float64Array
from ..model.clouds import ray_table
from ..model.patch import ContactPatch
from ..preset import Preset
from .object_mesh import ObjectMesh
from .pose_fit import ROUNDS, Fit, PatchPoints, fit, motion_between, moved

#: Orientations from which the whole search starts, the points and iterations of a first fit, and how many are fitted
#: to the end.
_ORIENTATIONS, _QUICK_POINTS, _QUICK_ROUNDS, _FINALISTS = 160, 120, 10, 10
#: Share of the time that the first fits take.
_QUICK_SHARE: Final = 0.9
#: Offsets of the search around a pose, as shares of the mesh's radius, and the angles tried about a free axis.
_NEAR_SHARES, _FREE_ANGLES = (0.0, 0.15, 0.35), 24
_NEAR_STARTS: Final = 16
#: Pixels between two rays that look for mesh in front of the membrane, of an image 640 wide.
_RAY_PX: Final = 8
#: Fits whose two-way residuals differ by less than this fit equally well, metres.
_EQUAL_M: Final = 0.0001
#: A mesh in front of the membrane by less than this may be noise, by more than that counts no more, metres.
_NOISE_M, _WORST_M = 0.002, 0.010


@dataclass(frozen=True, eq=False)
class Membrane:
    """Where the membrane is, seen along a grid of proximity rays; nothing of the mesh can lie in front of it.

    Attributes
    ----------
    rays : float64, shape (N, 3)
        ``(x / z, y / z, 1)``.
    depth_m : float64, shape (N,)
        Depth of the membrane in the tactile camera, metres.
    to_depth : float64, shape (4,)
        Factors of x, y, z and 1 that give a point's depth in that camera.
    area_px : float
        Pixels for which each ray stands.
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
class Searched:
    """A fit and its two-way residual: patch to mesh, and mesh in front of the membrane; RMS, metres."""

    fit: Fit
    cost_m: float


def search(
    mesh: ObjectMesh,
    patch: PatchPoints,
    film: Membrane | None,
    patch_px: int,
    progress: Callable[[float], None] = lambda share: None,
) -> Searched:
    """Search all orientations; ``progress`` gets the share done, 0 to 1, and ends the search by raising.

    Of poses that fit equally well, such as those along a free slide, the one touched nearest its centre is taken.
    """
    toward = patch.centre_m / np.linalg.norm(patch.centre_m)
    corners = mesh.vertices_m[mesh.triangles]
    places, normals = corners.mean(axis=1), np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    starts = []
    for rotation in _spread_rotations(_ORIENTATIONS):
        seen = np.minimum(normals @ rotation.T @ toward, 0.0)  # area that faces the camera
        if not seen.any():
            continue  # the back of an open surface
        pose = np.eye(4)
        pose[:3, :3] = rotation
        pose[:3, 3] = patch.centre_m - rotation @ ((places * seen[:, None]).sum(axis=0) / seen.sum())
        starts.append(pose)

    def off_centre_m(found: Searched) -> float:
        pose = found.fit.pose
        return float(np.linalg.norm(pose[:3, :3] @ mesh.centre_m + pose[:3, 3] - patch.centre_m))

    return _best(mesh, patch, film, patch_px, starts, off_centre_m, progress)


def search_near(
    mesh: ObjectMesh,
    patch: PatchPoints,
    film: Membrane | None,
    patch_px: int,
    last: Fit,
    pose: Float64Array,
    progress: Callable[[float], None] = lambda share: None,
) -> Searched:
    """Search around a pose, and all the way along the turns that were free there; ``progress`` as for `search`.

    Of poses that fit equally well, the one nearest to that pose is taken.
    """
    random = np.random.default_rng(0)
    starts = [pose]
    for direction in last.directions[:, last.free].T:
        turn = np.linalg.norm(direction[3:])
        if turn > 0.2:
            angles = np.linspace(0, 2 * np.pi, _FREE_ANGLES, endpoint=False)[1:]
            starts += [_turned(pose, direction, angle, last.centre_m, mesh.radius_m) for angle in angles]
        else:
            starts += [
                moved(pose, share * mesh.radius_m * direction, last.centre_m, mesh.radius_m) for share in (-0.5, 0.5)
            ]
    for share in _NEAR_SHARES[1:]:
        for motion in random.normal(size=(_NEAR_STARTS, 6)):
            starts.append(moved(pose, share * mesh.radius_m * motion / math.sqrt(2), patch.centre_m, mesh.radius_m))

    def away_m(found: Searched) -> float:
        equal = (found.fit.pose @ other for other in mesh.symmetries)
        motions = (motion_between(pose, other, patch.centre_m, mesh.radius_m) for other in equal)
        return min(float(np.linalg.norm(motion)) for motion in motions)

    return _best(mesh, patch, film, patch_px, starts, away_m, progress)


def _best(
    mesh: ObjectMesh,
    patch: PatchPoints,
    film: Membrane | None,
    patch_px: int,
    starts: list[Float64Array],
    distance_m: Callable[[Searched], float],
    progress: Callable[[float], None],
) -> Searched:
    """Fit from all starts with few points, then from the best ones with all; of equally good fits take the nearest."""
    few = patch.every(max(len(patch.points) // _QUICK_POINTS, 1))
    quick, final = list[Searched](), list[Searched]()
    for number, start in enumerate(starts):
        progress(_QUICK_SHARE * number / len(starts))
        quick.append(_scored(mesh, few, film, patch_px, start, _QUICK_ROUNDS))
    quick.sort(key=attrgetter("cost_m"))
    nearest = sorted(_equal(quick), key=distance_m)[: _FINALISTS // 2]
    others = [found for found in quick if found not in nearest]
    for number, found in enumerate((nearest + others)[:_FINALISTS]):
        progress(_QUICK_SHARE + (1 - _QUICK_SHARE) * number / _FINALISTS)
        final.append(_scored(mesh, patch, film, patch_px, found.fit.pose, ROUNDS))
    return min(_equal(final), key=distance_m)


def _equal(found: list[Searched]) -> list[Searched]:
    """Return the fits that are about as good as the best one."""
    least_m = min(each.cost_m for each in found)
    return [each for each in found if each.cost_m <= least_m + _EQUAL_M]


def _scored(
    mesh: ObjectMesh, patch: PatchPoints, film: Membrane | None, patch_px: int, start: Float64Array, rounds: int
) -> Searched:
    found = fit(mesh, patch, start, rounds)
    return Searched(found, two_way_m(mesh, found, film, patch_px))


def two_way_m(mesh: ObjectMesh, found: Fit, film: Membrane | None, patch_px: int) -> float:
    """Return the two-way residual of a fit, metres."""
    return math.hypot(found.cost_m, film.crossed_m(mesh, found.pose, patch_px) if film is not None else 0.0)


def _turned(
    pose: Float64Array, direction: Float64Array, angle: float, centre: Float64Array, radius_m: float
) -> Float64Array:
    """Return a pose after a turn about the axis of a motion."""
    spin = direction[3:] / radius_m
    point = centre + np.cross(spin, direction[:3]) / (spin @ spin)
    return moved(pose, np.concatenate([np.zeros(3), angle * radius_m * spin / np.linalg.norm(spin)]), point, radius_m)


def _spread_rotations(count: int) -> Float64Array:
    """Return rotations that cover all orientations evenly, (N, 3, 3).

    Alexa, "Super-Fibonacci spirals: fast, low-discrepancy sampling of SO(3)", CVPR 2022.
    """
    s = np.arange(count) + 0.5
    t = s / count
    alpha, beta = 2 * np.pi * s / math.sqrt(2), 2 * np.pi * s / 1.533751168755204288118041
    r, big = np.sqrt(t), np.sqrt(1 - t)
    quaternions = np.stack([r * np.sin(alpha), r * np.cos(alpha), big * np.sin(beta), big * np.cos(beta)], axis=1)
    return np.asarray(Rotation.from_quat(quaternions).as_matrix())
