"""The coloured 3D scan of an object: a triangle mesh with a colour at each vertex.

PLY and OBJ are read by trimesh (extra ``scan``). A texture usually has more detail than the vertices, so a textured
mesh is subdivided when it is read; afterwards only vertex colours are used.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np

from ...errors import MissingExtraError, SourceError, TactuneError
from ...model.arrays import AnyArray, Float64Array, Int32Array, Int64Array, Uint8Array
from ...model.files import user_path
from ...model.loading import image_size, open_regular, read_file

SUFFIXES: Final = (".ply", ".obj")

#: Plausible size of an object that a hand-sized sensor can touch.
_MAX_SIZE_M: Final = 1.0
_MIN_SIZE_M: Final = 0.002
_FILE_BYTES: Final = 2_000_000_000
#: Largest coordinate, in the file's unit.
_FARTHEST: Final = 1e9
_MAX_TRIANGLES: Final = 20_000_000

#: Textured triangles are subdivided to this edge length, metres, within this total number of triangles.
_TEXTURE_EDGE_M: Final = 0.0008
MAX_TEXTURE_TRIANGLES: Final = 1_000_000
_MAX_CUTS: Final = 24
#: Limit of the pixels of all textures, beyond 8 for each byte of their files.
_MAX_TEXELS: Final = 2**25
#: Limit of the files that a scan names, each time counted.
_MAX_NAMED: Final = 200


@dataclass(frozen=True, eq=False)
class Scan:
    """A coloured mesh in its own frame.

    Attributes
    ----------
    vertices_m : float64, shape (N, 3)
        Metres; each belongs to at least one triangle.
    triangles : int32, shape (M, 3)
        Vertex numbers.
    colors : uint8, shape (N, 3)
        RGB of the vertices.
    """

    vertices_m: Float64Array
    triangles: Int32Array
    colors: Uint8Array

    @cached_property
    def areas_m2(self) -> Float64Array:
        """Area of each triangle, float64, shape (M,)."""
        return triangle_areas(self.vertices_m, self.triangles)

    @property
    def size_m(self) -> float:
        """Diagonal of the bounding box, metres."""
        return _size(self.vertices_m)


def triangle_areas(vertices: Float64Array, triangles: AnyArray) -> Float64Array:
    """Return the area of each triangle in the square of the vertices' unit."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)


def load_scan(path: Path | str, unit_m: float = 1.0) -> Scan:
    """Read a coloured scan.

    Parameters
    ----------
    path : path
        ``.ply`` or ``.obj`` with colours of the vertices, or with a texture beside it.
    unit_m : float
        Length of the file's unit in metres, 0.001 for a file in millimetres.

    Returns
    -------
    Scan
        Coincident vertices are merged, also across texture seams; triangles without area are dropped. A textured mesh
        is subdivided to edges of 0.8 mm, or coarser to stay below a million triangles.

    Raises
    ------
    SourceError
        The file cannot be read, has no triangles or no colours, a vertex is not finite, or the size is implausible,
        probably because of a wrong unit.
    MissingExtraError
        trimesh or Pillow is not installed.
    """
    path = user_path(path)
    if not (math.isfinite(unit_m) and unit_m > 0):
        raise SourceError(f"the unit of {path} is {unit_m} m; give the length of its unit in metres, such as 0.001")
    _check_file(path, SUFFIXES)
    with _readable(path):
        meshes = [(mesh, *_in_metres(mesh, path, unit_m)) for mesh in _meshes(path)]
        edge = _cut_edge(
            [(vertices, triangles) for mesh, vertices, triangles in meshes if mesh.visual.kind == "texture"]
        )
        return _joined([_coloured(*part, edge, path) for part in meshes], path)


def read_triangles(path: Path | str, suffixes: Sequence[str] = SUFFIXES) -> tuple[Float64Array, Int32Array]:
    """Read the geometry of a mesh.

    Parameters
    ----------
    path : path
    suffixes : sequence of str
        Formats that are allowed, of those that trimesh reads.

    Returns
    -------
    vertices : float64, shape (N, 3)
        In the file's unit; coincident ones are merged.
    triangles : int32, shape (M, 3)
        Vertex numbers, counter-clockwise seen from outside if the surface is closed.

    Raises
    ------
    SourceError
        The file cannot be read, has no triangles or a vertex is not finite.
    MissingExtraError
        trimesh or Pillow is not installed.
    """
    path = user_path(path)
    _check_file(path, suffixes)
    with _readable(path):
        grey = [
            Scan(vertices, triangles.astype(np.int32), np.zeros((len(vertices), 3), np.uint8))
            for vertices, triangles in (_geometry(mesh, path) for mesh in _meshes(path))
        ]
        joined = _merged(grey, path)
    vertices, triangles = joined.vertices_m, joined.triangles
    a, b, c = (vertices[triangles[:, k]] - vertices.mean(axis=0) for k in range(3))
    inside_out = (a * np.cross(b, c)).sum() < 0
    return vertices, np.ascontiguousarray(triangles[:, ::-1]) if inside_out else triangles


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Raise a `SourceError` for whatever error trimesh gives, which does not wrap those of its parsers."""
    try:
        yield
    except TactuneError:
        raise
    except Exception as error:
        detail = " ".join(str(error).split())[:200] or type(error).__name__
        raise SourceError(f"{path} is no readable {path.suffix} mesh ({detail}); export it again") from error


def _check_file(path: Path, suffixes: Sequence[str]) -> None:
    if path.suffix.lower() not in suffixes:
        raise SourceError(f"{path} has the suffix {path.suffix!r}; a mesh is one of {', '.join(suffixes)}")
    try:
        size = path.stat().st_size
    except OSError as error:
        raise SourceError(f"cannot read {path}: {error.strerror or error}; check the path") from error
    if not path.is_file():
        raise SourceError(f"{path} is no file; give one of {', '.join(suffixes)}")
    if not 0 < size <= _FILE_BYTES:
        raise SourceError(f"{path} has {size} bytes; a scan has 1 to {_FILE_BYTES}, so export it again or coarser")


def import_trimesh() -> Any:
    """Import trimesh and what it needs for textures, or raise `MissingExtraError`."""
    try:
        import PIL.Image  # noqa: F401  # without Pillow, trimesh silently loads no texture
        import trimesh
    except ModuleNotFoundError as error:
        raise MissingExtraError(
            f'a scan needs {error.name}, which is not installed: pip install "tactune[scan]"'
        ) from error
    return trimesh


def _meshes(path: Path) -> list[Any]:
    """Return trimesh's meshes of a file, each with at most one texture."""
    trimesh = import_trimesh()
    logging.getLogger("trimesh").addHandler(logging.NullHandler())  # it logs tracebacks for a missing texture
    with open_regular(path) as file:
        suffix = path.suffix[1:].lower()
        scene = trimesh.load_scene(file, file_type=suffix, resolver=_Beside(path.parent), process=False)
    meshes = [mesh for mesh in scene.geometry.values() if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces)]
    if not meshes:
        raise SourceError(f"{path} has no triangles; export the scan as a mesh, not as points")
    if sum(len(mesh.faces) for mesh in meshes) > _MAX_TRIANGLES:
        raise SourceError(f"{path} has more than {_MAX_TRIANGLES} triangles; export it coarser")
    return meshes


class _Beside:
    """Gives trimesh the materials and textures that a mesh names: ordinary files of its folder, of a sensible size."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder.resolve()
        self._files: dict[Path, bytes] = {}
        self._named = self._texels = 0

    def get(self, name: str) -> bytes:
        """Return the bytes of a file."""
        self._named += 1
        path = (self._folder / name.strip().replace("\\", "/")).resolve()
        if self._named > _MAX_NAMED or not path.is_relative_to(self._folder):
            raise ValueError(f"{name} is outside of the folder, or one of too many")
        if path not in self._files:
            data = self._files[path] = read_file(path)
            if path.suffix.lower() not in (".mtl", ".bin"):
                width, height = image_size(data)
                self._texels += width * height - 8 * len(data)
        if self._texels > _MAX_TEXELS:
            raise ValueError("its textures are far larger than their files")
        return self._files[path]

    __getitem__ = get


def _geometry(mesh: Any, path: Path) -> tuple[Float64Array, Int64Array]:
    """Return vertices, in the file's unit, and triangles of one mesh of a file; unused vertices may become 0."""
    vertices, triangles = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise SourceError(f"{path} has a triangle with an invalid vertex index; export it again")
    used = np.unique(triangles)
    known = np.abs(vertices) < _FARTHEST
    if wrong := int(np.count_nonzero(~known[used].all(axis=1))):
        raise SourceError(
            f"{path} has vertices that are nan, infinite or beyond {_FARTHEST:g} ({wrong}); export it again"
        )
    return np.where(known, vertices, 0.0), triangles


def _in_metres(mesh: Any, path: Path, unit_m: float) -> tuple[Float64Array, Int64Array]:
    """Return vertices in metres and triangles of one mesh of a scan."""
    vertices, triangles = _geometry(mesh, path)
    _check_largest(vertices[np.unique(triangles)] * unit_m, path)
    return vertices * unit_m, triangles


def _coloured(mesh: Any, vertices: Float64Array, triangles: Int64Array, edge: float, path: Path) -> Scan:
    """Return one mesh of a file with vertex colours."""
    kind = mesh.visual.kind
    if kind == "texture":
        return _textured(mesh, vertices, triangles, edge, path)
    if kind is None:
        raise SourceError(f"{path} has no colours; export it with vertex colours, or with its texture beside it")
    return Scan(vertices, triangles.astype(np.int32), np.asarray(mesh.visual.vertex_colors, np.uint8)[:, :3])


def _textured(mesh: Any, vertices: Float64Array, triangles: Int64Array, edge: float, path: Path) -> Scan:
    """Subdivide a mesh to the detail of its texture and colour its vertices."""
    import trimesh

    remesh: Any = trimesh.remesh
    material = mesh.visual.material
    image = getattr(material, "image", None) or getattr(material, "baseColorTexture", None)
    if image is None or image.format is None or mesh.visual.uv is None:  # trimesh's placeholder has no format
        raise SourceError(
            f"{path} has a texture that is missing or cannot be read; "
            "put its image (and an .obj's .mtl) into the same folder"
        )
    # edge lengths are those of the first three columns; all columns are interpolated
    cut, finer = remesh.subdivide_to_size(
        np.column_stack([vertices, mesh.visual.uv]), triangles, edge, max_iter=_MAX_CUTS
    )
    colors = trimesh.visual.color.uv_to_color(np.nan_to_num(cut[:, 3:]), image)
    return Scan(np.ascontiguousarray(cut[:, :3]), finer.astype(np.int32), np.asarray(colors, np.uint8)[:, :3])


def _cut_edge(meshes: Sequence[tuple[Float64Array, Int64Array]]) -> float:
    """Return the edge length to which meshes can be subdivided within the limit of triangles."""
    sides = [vertices[triangles] - vertices[np.roll(triangles, 1, axis=1)] for vertices, triangles in meshes]
    longest = np.concatenate([np.empty(0), *(np.linalg.norm(side, axis=2).max(axis=1) for side in sides)])
    edge = _TEXTURE_EDGE_M
    # each subdivision halves the edges of a triangle and makes at most four of it
    while (4.0 ** np.ceil(np.log2(np.maximum(longest / edge, 1)))).sum() > max(MAX_TEXTURE_TRIANGLES, len(longest)):
        edge *= 1.2
    return edge


def _joined(parts: list[Scan], path: Path) -> Scan:
    """Join meshes and check the size."""
    scan = _merged(parts, path)
    _check_largest(scan.vertices_m, path)
    if scan.size_m < _MIN_SIZE_M:
        raise SourceError(f"{path} is {1e3 * scan.size_m:.3g} mm across; if its numbers are metres, set the unit to m")
    return scan


def _merged(parts: list[Scan], path: Path) -> Scan:
    """Join meshes: merge coincident vertices, drop triangles without area."""
    starts = np.cumsum([0, *(len(part.vertices_m) for part in parts)])
    vertices, first, number = np.unique(
        np.concatenate([part.vertices_m for part in parts]), axis=0, return_index=True, return_inverse=True
    )
    colors = np.concatenate([part.colors for part in parts])[first]
    triangles = np.concatenate([part.triangles + start for part, start in zip(parts, starts, strict=False)])
    triangles = number.reshape(-1)[triangles]
    triangles = triangles[triangle_areas(vertices, triangles) > 0]
    if len(triangles) == 0:
        raise SourceError(f"{path} has only triangles without area; export it again")
    used, renumbered = np.unique(triangles, return_inverse=True)
    return Scan(vertices[used], renumbered.reshape(-1, 3).astype(np.int32), np.ascontiguousarray(colors[used]))


def _check_largest(vertices: Float64Array, path: Path) -> None:
    if (size := _size(vertices)) > _MAX_SIZE_M:
        raise SourceError(
            f"{path} is {size:.3g} m across; if its numbers are millimetres or inches, set the unit to mm or in"
        )


def _size(vertices: Float64Array) -> float:
    return math.dist(vertices.min(axis=0), vertices.max(axis=0))
