"""The mesh of a known object: read from a file, its unit found, its axes named, its surface searched by Open3D."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

from ..errors import MissingExtraError, SourceError
from ..model.arrays import BoolArray, Float64Array, Int32Array
from ..model.units import UNITS_M
from ..sources.simulator.scenes import Scene
from .mesh_files import read_triangles, triangle_areas

#: Suffixes of meshes.
SUFFIXES: Final = (".obj", ".ply", ".stl")
#: Diagonals, metres, of objects that a membrane of 0.3 m can feel. The range is less than a factor of 1000 wide, so at
#: most one of metres and millimetres fits.
_SMALLEST_M, _LARGEST_M = 0.01, 2.0
#: Side of the quads of a simulated object's mesh, metres.
_SIMULATED_SIDE_M: Final = 0.0015
#: Points of the surface that tell its size, its axis of symmetry and its symmetries.
_SAMPLE: Final = 4000
#: A surface is round about an axis if this share of it, by area, lies within this share of its size.
_ROUND_SHARE, _ROUND_ERROR = 0.6, 0.02
#: Largest difference of the entries of equal motions.
_SAME_MOTION: Final = 0.05


@dataclass(frozen=True, eq=False)
class Axis:
    """A line in the mesh's frame: a point, metres, and a unit vector, each float64 (3,)."""

    point_m: Float64Array
    direction: Float64Array


@dataclass(frozen=True, eq=False)
class ObjectMesh:
    """The surface of an object in its own frame.

    Attributes
    ----------
    vertices_m : float64, shape (N, 3)
        Metres.
    triangles : int32, shape (M, 3)
        Vertex numbers, counter-clockwise seen from outside.
    name : str
    unit : str
        Unit of the file, ``m`` or ``mm``, for messages.
    """

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
    def _sample(self) -> tuple[Float64Array, Float64Array]:
        return self.sample(_SAMPLE)

    def sample(self, count: int) -> tuple[Float64Array, Float64Array]:
        """Return points spread evenly over the surface, metres, and the unit normals there, each (count, 3)."""
        random, areas = np.random.default_rng(0), triangle_areas(self.vertices_m, self.triangles)
        chosen = random.choice(len(areas), count, p=areas / areas.sum())
        a, b, c = (self.vertices_m[self.triangles[chosen, k]] for k in range(3))
        s, t = random.random((2, count, 1))
        s, t = np.where(s + t > 1, 1 - s, s), np.where(s + t > 1, 1 - t, t)
        normals = np.cross(b - a, c - a)
        return a + s * (b - a) + t * (c - a), normals / np.linalg.norm(normals, axis=1, keepdims=True)

    @cached_property
    def centre_m(self) -> Float64Array:
        """Centre of the surface, metres, float64 (3,)."""
        corners, areas = self.vertices_m[self.triangles], triangle_areas(self.vertices_m, self.triangles)
        return np.asarray(np.average(corners.mean(axis=1), axis=0, weights=areas))

    @cached_property
    def radius_m(self) -> float:
        """RMS distance of the surface from its centre, metres: the lever that turns angles into distances."""
        return math.sqrt(float(((self._sample[0] - self.centre_m) ** 2).sum(axis=1).mean()))

    @cached_property
    def scene(self) -> Any:
        """Open3D's ray casting scene of the mesh, which also finds closest points.

        Raises
        ------
        MissingExtraError
            Open3D is not installed.
        """
        scene = import_open3d().t.geometry.RaycastingScene(nthreads=1)
        scene.add_triangles(self.vertices_m.astype(np.float32), self.triangles.astype(np.uint32))
        return scene

    @cached_property
    def round_axis(self) -> Axis | None:
        """The axis about which most of the surface is round, such as that of a cup without its handle; else None.

        The turn that moves the surface least out of itself is the smallest eigenvector of the sum over the surface of
        J J^T with J = (p x n, n), as in Gelfand and Guibas, "Shape segmentation using local slippage analysis"
        (2004). It is fitted again with what does not follow it weighted down.
        """
        places, normals = self._sample
        places = (places - self.centre_m) / self.radius_m
        rows = np.concatenate([np.cross(places, normals), normals], axis=1)
        best: Axis | None = None
        best_share = _ROUND_SHARE
        for start in np.eye(3):  # about each axis of the file; the fit then finds the true one
            motion = np.concatenate([start, np.zeros(3)])
            for _ in range(30):
                weights = 1 / ((rows @ motion) ** 2 + _ROUND_ERROR**2)
                motion = np.linalg.eigh((rows * weights[:, None]).T @ rows)[1][:, 0]
                turn = float(np.linalg.norm(motion[:3]))
                if turn < 1e-3:
                    break
                motion /= turn
            share = float(np.mean(np.abs(rows @ motion) < 2 * _ROUND_ERROR))
            pitch = float(np.dot(motion[:3], motion[3:]))
            if turn >= 1e-3 and abs(pitch) < 0.1 and share > best_share:
                point = self.centre_m + self.radius_m * np.cross(motion[:3], motion[3:])
                best, best_share = Axis(point, motion[:3].copy()), share
        return best

    @cached_property
    def symmetries(self) -> list[Float64Array]:
        """Motions, 4 x 4, that lay the surface onto itself within 2 % of its size; the first moves nothing.

        Quarter and third turns about the axes of the file and about the principal axes are tried. Those about the axis
        of a round object are endless and not among them.
        """
        corners, areas = self.vertices_m[self.triangles], triangle_areas(self.vertices_m, self.triangles)
        away = corners.mean(axis=1) - self.centre_m
        principal, places = np.linalg.eigh((away * areas[:, None]).T @ away)[1], self._sample[0] - self.centre_m
        found = [np.eye(4)]
        for axes in (np.eye(3), principal * np.sign(np.linalg.det(principal))):
            for turn in Rotation.create_group("O").as_matrix():
                motion = np.eye(4)
                motion[:3, :3] = axes @ turn @ axes.T
                motion[:3, 3] = self.centre_m - motion[:3, :3] @ self.centre_m
                if any(np.abs(motion - other).max() < _SAME_MOTION for other in found):
                    continue
                turned = (places @ motion[:3, :3].T + self.centre_m).astype(np.float32)
                apart = self.scene.compute_distance(turned).numpy()
                if math.sqrt(float((apart**2).mean())) < _ROUND_ERROR * self.radius_m:
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
    """Read the mesh of an object.

    Parameters
    ----------
    path : path
        ``.obj``, ``.ply`` or ``.stl``.
    unit : {"m", "cm", "mm", "in"}, optional
        By default m if the object then is 10 mm to 2 m large, else mm: a cup of 95 is not 95 m.

    Raises
    ------
    SourceError
        The file cannot be read, has no triangles, a vertex is not finite, or the object is too large or too small.
    MissingExtraError
        trimesh is not installed.
    """
    if unit is not None and unit not in UNITS_M:
        raise SourceError(f"there is no unit {unit!r}; choose one of {', '.join(UNITS_M)}")
    vertices, triangles = read_triangles(path, SUFFIXES)
    size = math.dist(vertices.min(axis=0), vertices.max(axis=0))
    for candidate in (unit,) if unit else ("m", "mm"):
        if _SMALLEST_M <= size * UNITS_M[candidate] <= _LARGEST_M:
            return ObjectMesh(vertices * UNITS_M[candidate], triangles, Path(path).name, candidate)
    tried = f"in {unit}" if unit else "in m or in mm"
    raise SourceError(
        f"{path} is {size:.4g} across, which {tried} is no object of {1e3 * _SMALLEST_M:g} mm to {_LARGEST_M:g} m; "
        f"check its unit, which is one of {', '.join(UNITS_M)}"
    )


def simulated_mesh(scene: Scene, name: str) -> ObjectMesh:
    """Return the mesh of the object of a simulator's scene, in the frame of its true pose."""
    from ..sources.simulator.object_surface import object_surface  # on demand: it compiles the objects

    vertices, quads = object_surface(scene.pressed.kind, _SIMULATED_SIDE_M)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)
    return ObjectMesh(vertices, triangles, name)


def import_open3d() -> Any:
    """Import Open3D, or raise `MissingExtraError`."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ImportWarning)  # a build with CUDA on a computer without
            import open3d
    except (ImportError, OSError) as error:  # OSError: a system library is missing
        raise MissingExtraError(
            f'tracking an object needs Open3D, which cannot be imported ({error}): pip install "tactune[open3d]"'
        ) from error
    return open3d
