"""The mesh of a known object: read from a file by trimesh, its unit found, its surface searched by Open3D."""

from __future__ import annotations

import logging
import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np

from ..errors import SourceError, extra
from ..model.arrays import AnyArray, BoolArray, Float64Array, Int32Array
from ..model.files import UNITS_M, user_path
from ..model.frames import pose_matrix
from ..sources.ros_image import damage_told
from ..sources.simulator.scenes import Scene

#: Suffixes of meshes.
SUFFIXES: Final = (".obj", ".ply", ".stl")
#: Diagonals, metres, of objects that a membrane of 0.3 m can feel. The range is less than a factor of 1000 wide, so at
#: most one of metres and millimetres fits.
_SMALLEST_M, _LARGEST_M = 0.01, 2.0
#: Largest coordinate, in the file's unit.
_FARTHEST: Final = 1e9
#: Side of the quads of a simulated object's mesh, metres.
_SIMULATED_SIDE_M: Final = 0.0015
#: Points of the surface that tell its size, and its half turns if they lie on it within this share of its size.
_SAMPLE, _SAME_SHARE = 4000, 0.02


@dataclass(frozen=True, eq=False)
class ObjectMesh:
    """An object's surface: vertices (N, 3), m, and triangles (M, 3), counter-clockwise seen from outside."""

    vertices_m: Float64Array
    triangles: Int32Array
    name: str = "object"
    unit: str = "m"

    @property
    def size_m(self) -> Float64Array:
        """Sides of the bounding box along the mesh's axes, metres, float64 (3,)."""
        return np.asarray(np.ptp(self.vertices_m, axis=0))

    @property
    def assumed(self) -> str:
        """What was assumed about the file, as a sentence."""
        sides = " x ".join(f"{1e3 * side:.0f}" for side in self.size_m)
        return f"{self.name} was read in {self.unit}: {sides} mm"

    @cached_property
    def areas_m2(self) -> Float64Array:
        return triangle_areas(self.vertices_m, self.triangles)

    def sample(self, count: int) -> tuple[Float64Array, Float64Array]:
        """Return points spread evenly over the surface, metres, and the unit normals there, each (count, 3)."""
        random = np.random.default_rng(0)
        chosen = random.choice(len(self.areas_m2), count, p=self.areas_m2 / self.areas_m2.sum())
        a, b, c = (self.vertices_m[self.triangles[chosen, k]] for k in range(3))
        s, t = random.random((2, count, 1))
        s, t = np.where(s + t > 1, 1 - s, s), np.where(s + t > 1, 1 - t, t)
        normals = np.cross(b - a, c - a)
        return a + s * (b - a) + t * (c - a), normals / np.linalg.norm(normals, axis=1, keepdims=True)

    @cached_property
    def centre_m(self) -> Float64Array:
        centres = self.vertices_m[self.triangles].mean(axis=1)
        return np.asarray(np.average(centres, axis=0, weights=self.areas_m2))

    @cached_property
    def radius_m(self) -> float:
        """RMS distance of the surface from its centre, metres: the lever that turns angles into distances."""
        return math.sqrt(float(((self.sample(_SAMPLE)[0] - self.centre_m) ** 2).sum(axis=1).mean()))

    @cached_property
    def scene(self) -> Any:
        """Open3D's ray casting scene of the mesh, which also finds closest points."""
        scene = import_open3d().t.geometry.RaycastingScene(nthreads=1)
        scene.add_triangles(self.vertices_m.astype(np.float32), self.triangles.astype(np.uint32))
        return scene

    @cached_property
    def half_turns(self) -> list[Float64Array]:
        """Half turns about the file's and the principal axes, 4 x 4, that lay the surface onto itself within 2 %."""
        away = self.vertices_m[self.triangles].mean(axis=1) - self.centre_m
        principal = np.linalg.eigh((away * self.areas_m2[:, None]).T @ away)[1]
        places, found = self.sample(_SAMPLE)[0], [np.eye(4)]
        for axis in (*np.eye(3), *principal.T):
            turn = 2 * np.outer(axis, axis) - np.eye(3)
            motion = pose_matrix(turn, self.centre_m - turn @ self.centre_m)
            turned = places @ turn + motion[:3, 3]
            apart = np.linalg.norm(self.closest(turned)[0] - turned, axis=1)
            if math.sqrt(float((apart**2).mean())) < _SAME_SHARE * self.radius_m:
                found.append(motion)
        return found

    def closest(self, points: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Return the closest points of the surface and its unit normals there, each (N, 3), in the mesh's frame."""
        found = self.scene.compute_closest_points(points.astype(np.float32))
        return found["points"].numpy().astype(np.float64), found["primitive_normals"].numpy().astype(np.float64)

    def hits(self, origin: Float64Array, rays: Float64Array) -> tuple[Float64Array, BoolArray]:
        """Return where rays, (N, 3), from a point hit the surface first, as multiples of the rays, and which hit."""
        from_there = np.concatenate([np.broadcast_to(origin, rays.shape), rays], axis=1).astype(np.float32)
        lengths = self.scene.cast_rays(from_there)["t_hit"].numpy().astype(np.float64)
        return lengths, np.isfinite(lengths)


def load_mesh(path: Path | str, unit: str | None = None) -> ObjectMesh:
    """Read a mesh; without a unit, in m if the object then is 10 mm to 2 m large, else in mm."""
    if unit is not None and unit not in UNITS_M:
        raise SourceError(f"there is no unit {unit!r}; choose one of {', '.join(UNITS_M)}")
    path = user_path(path)
    parts = [(np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces)) for mesh in load_meshes(path, SUFFIXES)]
    vertices, triangles, _ = merge(parts, path)
    a, b, c = (vertices[triangles[:, k]] - vertices.mean(axis=0) for k in range(3))
    if (a * np.cross(b, c)).sum() < 0:  # inside out
        triangles = np.ascontiguousarray(triangles[:, ::-1])
    size = math.dist(vertices.min(axis=0), vertices.max(axis=0))
    for candidate in (unit,) if unit else ("m", "mm"):
        if _SMALLEST_M <= size * UNITS_M[candidate] <= _LARGEST_M:
            return ObjectMesh(vertices * UNITS_M[candidate], triangles, path.name, candidate)
    tried = f"in {unit}" if unit else "in m or in mm"
    raise SourceError(
        f"{path} is {size:.4g} across, which {tried} is no object of {1e3 * _SMALLEST_M:g} mm to {_LARGEST_M:g} m; "
        f"check its unit, which is one of {', '.join(UNITS_M)}"
    )


def load_meshes(path: Path | str, suffixes: Sequence[str]) -> list[Any]:
    """Return trimesh's meshes of a file, each with at most one texture."""
    path = user_path(path)
    if path.suffix.lower() not in suffixes:
        raise SourceError(f"{path} has the suffix {path.suffix!r}; a mesh is one of {', '.join(suffixes)}")
    if not path.is_file():
        raise SourceError(f"cannot read {path}: there is no such file; check the path")
    trimesh = extra("trimesh", "a mesh", "open3d")
    logging.getLogger("trimesh").addHandler(logging.NullHandler())  # it logs tracebacks for a missing texture
    with damage_told(path, f"it is no readable {path.suffix} mesh"):
        scene = trimesh.load_scene(path, process=False)
        meshes = [mesh for mesh in scene.geometry.values() if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces)]
        for mesh in meshes:
            if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
                raise SourceError(f"{path} has a triangle with an invalid vertex index; export it again")
            if not (np.abs(mesh.vertices[np.unique(mesh.faces)]) < _FARTHEST).all():
                raise SourceError(f"{path} has vertices that are nan or beyond {_FARTHEST:g}; export it again")
    if not meshes:
        raise SourceError(f"{path} has no triangles; export it as a mesh, not as points")
    return meshes


def merge(
    parts: Sequence[tuple[Float64Array, AnyArray]], path: Path | str
) -> tuple[Float64Array, Int32Array, AnyArray]:
    """Join meshes; return vertices (N, 3) and triangles (M, 3) that are left, and which of all vertices they are."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    joined = np.concatenate([vertices for vertices, _ in parts])
    vertices, first, number = np.unique(joined, axis=0, return_index=True, return_inverse=True)
    triangles = np.concatenate([faces + start for (_, faces), start in zip(parts, starts, strict=False)])
    triangles = number.reshape(-1)[triangles]
    triangles = triangles[triangle_areas(vertices, triangles) > 0]
    if len(triangles) == 0:
        raise SourceError(f"{path} has only triangles without area; export it again")
    used, renumbered = np.unique(triangles, return_inverse=True)
    return vertices[used], renumbered.reshape(-1, 3).astype(np.int32), first[used]


def triangle_areas(vertices: Float64Array, triangles: AnyArray) -> Float64Array:
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)


def simulated_mesh(scene: Scene, name: str) -> ObjectMesh:
    """Return the mesh of the object of a simulator's scene, in the frame of its true pose."""
    from ..sources.simulator.objects import object_surface  # on demand: it compiles the objects

    vertices, quads = object_surface(scene.pressed.kind, _SIMULATED_SIDE_M)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)
    return ObjectMesh(vertices, triangles, name)


def import_open3d() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ImportWarning)  # a build with CUDA on a computer without
        return extra("open3d", "tracking an object", "open3d")
