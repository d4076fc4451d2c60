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
_NEAR_SHARES, _FREE_ANGLES = (0.15, 0.35), 24
_NEAR_STARTS: Final = 16
#: Pixels between two rays that look for mesh in front of the membrane, of an image 640 wide.
_RAY_PX: Final = 8
#: Fits whose two-way residuals differ by less than this fit equally well, metres. Of these the nearest is taken: noise
#: would prefer one of them, and slide an object along its axis.
_EQUAL_M: Final = 0.0001
#: A mesh in front of the membrane by less than this may be noise, by more than that counts no more, metres.
_NOISE_M, _WORST_M = 0.002, 0.010

Progress = Callable[[float], None]


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
class Searched:
    """A fit and its two-way residual: patch to mesh, and mesh in front of the membrane; RMS, metres."""

    fit: Fit
    cost_m: float


@dataclass(frozen=True, eq=False)
class Search:
    """Searches for a mesh in one patch. ``progress`` gets the share done, 0 to 1, and ends a search by raising."""

    mesh: ObjectMesh
    patch: PatchPoints
    film: Membrane | None
    patch_px: int
    progress: Progress = lambda share: None

    def fitted(self, start: Float64Array, patch: PatchPoints | None = None, rounds: int = ROUNDS) -> Searched:
        """Return the fit from one start."""
        found = fit(self.mesh, patch or self.patch, start, rounds)
        crossed_m = 0.0 if self.film is None else self.film.crossed_m(self.mesh, found.pose, self.patch_px)
        return Searched(found, math.hypot(found.cost_m, crossed_m))

    def everywhere(self, pose: Float64Array | None) -> Searched:
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
            start = np.eye(4)
            start[:3, :3] = rotation
            start[:3, 3] = centre - rotation @ ((places * seen[:, None]).sum(axis=0) / seen.sum())
            starts.append(start)

        def off_centre_m(found: Searched) -> float:
            own = found.fit.pose
            return float(np.linalg.norm(own[:3, :3] @ mesh.centre_m + own[:3, 3] - centre))

        return self._best(starts, off_centre_m if pose is None else self._away_from(pose))

    def near(self, last: Fit, pose: Float64Array) -> Searched:
        """Search around a pose, and all the way along the directions that were free in the last fit."""
        random, radius_m = np.random.default_rng(0), self.mesh.radius_m
        starts = [pose]
        for direction in last.directions[:, last.free].T:
            spin = direction[3:] / radius_m
            if np.linalg.norm(direction[3:]) > 0.2:
                about = last.centre_m + np.cross(spin, direction[:3]) / (spin @ spin)
                turn = np.concatenate([np.zeros(3), radius_m * spin / np.linalg.norm(spin)])
                angles = np.linspace(0, 2 * np.pi, _FREE_ANGLES, endpoint=False)[1:]
                starts += [moved(pose, angle * turn, about, radius_m) for angle in angles]
            else:
                starts += [moved(pose, share * radius_m * direction, last.centre_m, radius_m) for share in (-0.5, 0.5)]
        for share in _NEAR_SHARES:
            for motion in random.normal(size=(_NEAR_STARTS, 6)):
                starts.append(moved(pose, share * radius_m * motion / math.sqrt(2), self.patch.centre_m, radius_m))
        return self._best(starts, self._away_from(pose))

    def _away_from(self, pose: Float64Array) -> Callable[[Searched], float]:
        centre, radius_m = self.patch.centre_m, self.mesh.radius_m
        return lambda found: float(np.linalg.norm(motion_between(pose, found.fit.pose, centre, radius_m)))

    def _best(self, starts: list[Float64Array], distance_m: Callable[[Searched], float]) -> Searched:
        """Fit from all starts with few points, then from the best ones with all; of equally good fits, the nearest."""
        few = self.patch.every(max(len(self.patch.points) // _QUICK_POINTS, 1))
        quick, final = list[Searched](), list[Searched]()
        for number, start in enumerate(starts):
            self.progress(_QUICK_SHARE * number / len(starts))
            quick.append(self.fitted(start, few, _QUICK_ROUNDS))
        quick.sort(key=attrgetter("cost_m"))
        nearest = sorted(_equal(quick), key=distance_m)[: _FINALISTS // 2]
        others = [found for found in quick if found not in nearest]
        for number, found in enumerate((nearest + others)[:_FINALISTS]):
            self.progress(_QUICK_SHARE + (1 - _QUICK_SHARE) * number / _FINALISTS)
            final.append(self.fitted(found.fit.pose))
        return min(_equal(final), key=distance_m)


def _equal(found: list[Searched]) -> list[Searched]:
    """Return the fits that are about as good as the best one."""
    least_m = min(each.cost_m for each in found)
    return [each for each in found if each.cost_m <= least_m + _EQUAL_M]


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
