"""Painted scans of simulated objects, with the contact that the solver knows."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from scipy.spatial import cKDTree

from ...errors import ExportError, SourceError
from ...model.arrays import BoolArray, Float32Array, Float64Array, Int64Array, Uint8Array
from ...model.files import atomic_path
from ...model.frames import GroundTruth, Matrix4, Rig
from ...sources.base import FrameSource
from ...sources.simulator.objects import compiled, distance, normal
from ...sources.simulator.source import SimulatorSource
from .pose import save_transform, transformed
from .scan import SUFFIXES, import_trimesh

#: Thermochromic paint, touched and not, RGB.
PINK: Final = (235, 110, 170)
PURPLE: Final = (90, 50, 140)

#: Default side of the mesh's quads, metres: with vertex colours, and with a texture.
FINE_M: Final = 0.0008
COARSE_M: Final = 0.004
_FINEST_M, _COARSEST_M = 0.0003, 0.010
#: Texels along a quad's side; the outermost repeat their neighbours.
_BLOCK: Final = 14
#: Largest distance between membrane and touched surface along the camera's axis, metres: covers interpolation between
#: nodes and steep pixels. The far side of every object is farther away.
_NEAR_M: Final = 0.003
_SPECK_RADIUS_M: Final = 0.0012
#: Half side of a cube around the origin that contains every object, metres.
_HALF_M: Final = 0.084
_IDENTITY: Final = np.eye(4)[:3].copy()


@dataclass(frozen=True)
class PaintFlaws:
    """Deviations of a real scan's colours from two pure ones.

    Attributes
    ----------
    noise : float
        Standard deviation of each channel at each vertex or texel, 0 to 255.
    specks : int
        Spots of the other colour, 2.4 mm wide, anywhere on the object.
    seed : int
    """

    noise: float = 0.0
    specks: int = 0
    seed: int = 0


def export_painted_scan(
    source: FrameSource,
    index: int,
    path: Path | str,
    *,
    texture: bool = False,
    spacing_m: float | None = None,
    flaws: PaintFlaws | None = None,
) -> list[Path]:
    """Write the object of a simulated frame as a scan, pink where the membrane touches it, and its true pose.

    Contact is the frame's ground truth, projected from the proximity camera onto the object. Surface that the camera
    does not see stays purple.

    Parameters
    ----------
    source : FrameSource
        A `SimulatorSource`.
    index : int
        Index of the frame.
    path : path
        ``.ply`` with vertex colours; with ``texture`` ``.obj``, and a ``.mtl`` and ``.png`` beside it.
    texture : bool
        Write a coarse mesh with a fine texture instead of a fine mesh with vertex colours.
    spacing_m : float, optional
        Side of the mesh's quads, metres; default 0.0008, with a texture 0.004.
    flaws : PaintFlaws, optional

    Returns
    -------
    list of Path
        The scan, its companion files, and last ``NAME.transform.json`` for `load_transform`.

    Raises
    ------
    SourceError
        The source is no simulator or has no such frame.
    ExportError
        The suffix or spacing is invalid, or a file cannot be written.
    MissingExtraError
        trimesh or Pillow is not installed.
    """
    path, flaws = Path(path), flaws or PaintFlaws()
    if spacing_m is None:
        spacing_m = COARSE_M if texture else FINE_M
    if path.suffix.lower() != SUFFIXES[texture]:
        kind = "a texture" if texture else "vertex colours"
        raise ExportError(f"{path} has the suffix {path.suffix!r}; a scan with {kind} is {SUFFIXES[texture]}")
    if not _FINEST_M <= spacing_m <= _COARSEST_M:
        raise ExportError(
            f"the spacing is {1e3 * spacing_m:g} mm; give {1e3 * _FINEST_M:g} to {1e3 * _COARSEST_M:g} mm"
        )
    if not isinstance(source, SimulatorSource):
        raise SourceError(f"{source.name} knows no object's shape; painted scans come from the simulator, sim:")
    if not 0 <= index < len(source.scene.frames):
        raise SourceError(f"{source.name} has no frame {index}; it has 0 to {len(source.scene.frames) - 1}")
    truth, pose = source.read(index).truth, source.facts(index).T_proximity_object
    assert truth is not None
    painter = _Painter(source.scene.pressed.kind, pose, truth, source.rig, flaws)
    vertices, quads = object_surface(painter.kind, spacing_m)
    write = _textured_files if texture else _coloured_files
    transform = path.with_suffix(".transform.json")
    _write(write(path, vertices, quads, painter))
    save_transform(transform, pose)
    return [path, *([path.with_suffix(suffix) for suffix in (".mtl", ".png")] if texture else []), transform]


@dataclass(frozen=True, eq=False)
class _Painter:
    """Colours points on the object of one frame."""

    kind: int
    T_proximity_object: Matrix4
    truth: GroundTruth
    rig: Rig
    flaws: PaintFlaws

    def touched(self, points: Float64Array) -> BoolArray:
        """Tell which points of the surface, (N, 3), the proximity camera sees in contact."""
        normals = to_surface(self.kind, points)
        seen = transformed(self.T_proximity_object, points)
        outward = normals @ np.asarray(self.T_proximity_object)[:3, :3].T
        u, v = self.rig.proximity.intrinsics.project(seen).astype(np.float32).T
        assert self.truth.depth_m is not None
        share = _looked_up(self.truth.contact.astype(np.float32), u, v, cv2.INTER_LINEAR)
        film = _looked_up(self.truth.depth_m, u, v, cv2.INTER_NEAREST)
        facing = (outward * seen).sum(axis=1) < 0
        return np.asarray(facing & (share >= 0.5) & (np.abs(seen[:, 2] - film) < _NEAR_M))

    def colors(self, points: Float64Array) -> Uint8Array:
        """Return the paint's colour with flaws, uint8 (N, 3), of points on the surface."""
        touched, random = self.touched(points), np.random.default_rng(self.flaws.seed)
        if self.flaws.specks:
            centres = points[random.integers(len(points), size=self.flaws.specks)]
            hit = np.unique(np.concatenate(cKDTree(points).query_ball_point(centres, _SPECK_RADIUS_M)))
            touched[hit.astype(np.intp)] ^= True
        colors = np.where(touched[:, None], PINK, PURPLE).astype(np.float64)
        colors += self.flaws.noise * random.standard_normal(colors.shape)
        return np.clip(np.round(colors), 0, 255).astype(np.uint8)


def _looked_up(image: Float32Array, u: Float32Array, v: Float32Array, how: int) -> Float32Array:
    """Return an image's values at pixels, (N,), 0 outside."""
    rows = 4096  # OpenCV allows at most 32767 columns
    wide = [np.pad(where, (0, -len(where) % rows)).reshape(-1, rows) for where in (u, v)]
    found = cv2.remap(image, wide[0], wide[1], how, borderMode=cv2.BORDER_CONSTANT, borderValue=0.0)
    return np.asarray(found, np.float32).reshape(-1)[: len(u)]


def _coloured_files(path: Path, vertices: Float64Array, quads: Int64Array, painter: _Painter) -> dict[Path, bytes]:
    mesh = import_trimesh().Trimesh(vertices, _halves(quads), vertex_colors=painter.colors(vertices), process=False)
    return {path: mesh.export(file_type="ply")}


def _textured_files(path: Path, vertices: Float64Array, quads: Int64Array, painter: _Painter) -> dict[Path, bytes]:
    """Give each quad a square block of one texture."""
    trimesh = import_trimesh()
    import PIL.Image

    across = math.ceil(math.sqrt(len(quads)))
    down, size = -(-len(quads) // across), across * _BLOCK
    row, column = np.divmod(np.arange(len(quads)), across)
    s = (np.clip(np.arange(_BLOCK), 1, _BLOCK - 2) - 1) / (_BLOCK - 3)
    colors = painter.colors(_places(vertices[quads], s).reshape(-1, 3)).reshape(len(quads), _BLOCK, _BLOCK, 3)
    blocks = np.zeros((down, _BLOCK, across, _BLOCK, 3), np.uint8)
    blocks[row, :, column] = colors
    image = blocks.reshape(down * _BLOCK, size, 3)
    ends = np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) * (_BLOCK - 3) + 1.5  # texel centres
    x, y = (np.stack([column, row], axis=1)[:, None] * _BLOCK + ends).reshape(-1, 2).T
    material = trimesh.visual.material.SimpleMaterial(name=path.stem, image=PIL.Image.fromarray(image))
    uv = np.column_stack([x / size, 1 - y / len(image)])
    corners = np.arange(4 * len(quads)).reshape(-1, 4)
    mesh = trimesh.Trimesh(
        vertices[quads].reshape(-1, 3), _halves(corners), process=False,
        visual=trimesh.visual.TextureVisuals(uv=uv, material=material),
    )  # fmt: skip
    text = trimesh.exchange.obj.export_obj(mesh, write_texture=False, mtl_name=path.with_suffix(".mtl").name)
    picture = io.BytesIO()
    PIL.Image.fromarray(image).save(picture, "PNG")
    lines = f"newmtl {path.stem}\nKd 1.0 1.0 1.0\nmap_Kd {path.with_suffix('.png').name}\n"
    return {path.with_suffix(".png"): picture.getvalue(), path.with_suffix(".mtl"): lines.encode(), path: text.encode()}


def _places(corners: Float64Array, s: Float64Array) -> Float64Array:
    """Return points on quads (N, 4, 3) at fractions ``s`` of both sides: (N, rows, columns, 3).

    A quad consists of two flat triangles, split from its first to its third corner.
    """
    a, b, c, d = (corners[:, None, None, k] for k in range(4))
    right, down = s[None, None, :, None], s[None, :, None, None]
    lower = a + right * (b - a) + down * (c - b)
    upper = a + down * (d - a) + right * (c - d)
    return np.asarray(np.where(right >= down, lower, upper))


def _halves(quads: Int64Array) -> Int64Array:
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def _write(files: Mapping[Path, bytes]) -> None:
    for path, data in files.items():
        with atomic_path(path) as temporary:
            temporary.write_bytes(data)


def object_surface(kind: int, spacing_m: float) -> tuple[Float64Array, Int64Array]:
    """Return the surface of an object, in its own frame, as quads of about equal size.

    Surface nets (Gibson 1998): each voxel that the surface crosses gets a vertex at the mean of the crossed edges, and
    each crossed edge gets a quad. The vertices are then moved onto the surface.

    Parameters
    ----------
    kind : int
        One of the simulator's objects.
    spacing_m : float
        Side of a voxel, metres.

    Returns
    -------
    vertices : float64, shape (N, 3)
        Metres.
    quads : int64, shape (M, 4)
        Vertex indices, counter-clockwise seen from outside.
    """
    count = 2 * math.ceil(_HALF_M / spacing_m) + 2
    axis = np.asarray((np.arange(count) - (count - 1) / 2) * spacing_m, np.float64)
    values = np.empty((count, count, count), np.float32)
    _fill(kind, _IDENTITY, axis, values)
    number = _voxel_numbers(values < 0)
    sums, crossings, quads = np.zeros((number.max() + 1, 3)), np.zeros(number.max() + 1), []
    for along in range(3):
        step, beside, before = np.roll(np.eye(3, dtype=np.int64), -along, axis=0)
        start = _crossed_edges(values, along)
        near, far = values[tuple(start.T)], values[tuple((start + step).T)]
        places = axis[start] + (near / (near - far))[:, None] * step * spacing_m
        around = np.stack([number[tuple((start - back).T)] for back in (beside + before, before, 0 * step, beside)], 1)
        np.add.at(sums, around, places[:, None])
        np.add.at(crossings, around, 1)
        quads.append(np.where((near < 0)[:, None], around, around[:, ::-1]))
    vertices = sums / crossings[:, None]
    to_surface(kind, vertices)
    return vertices, np.concatenate(quads)


def _voxel_numbers(inside: BoolArray) -> Int64Array:
    """Number the voxels with corners on both sides of the surface; -1 for all others."""
    side = len(inside) - 1
    within = np.zeros((side, side, side), np.int8)
    for i, j, k in np.ndindex(2, 2, 2):
        within += inside[i : i + side, j : j + side, k : k + side]
    passed = (within > 0) & (within < 8)
    number = np.full(passed.shape, -1, np.int64)
    number[passed] = np.arange(np.count_nonzero(passed))
    return number


def _crossed_edges(values: Float32Array, along: int) -> Int64Array:
    """Return the start indices, (N, 3), of the grid edges along one axis that the surface crosses."""
    ahead = np.moveaxis(values < 0, along, 0)
    crossed = np.moveaxis(ahead[:-1] != ahead[1:], 0, along)
    return np.argwhere(crossed)


def to_surface(kind: int, points: Float64Array) -> Float64Array:
    """Move points near an object's surface onto it, in place; return the outward unit normals there, (N, 3)."""
    normals = np.empty_like(points)
    _settle(kind, _IDENTITY, points, normals)
    return normals


@compiled
def _fill(kind: int, pose: Float64Array, axis: Float64Array, values: Float32Array) -> None:
    for i in range(len(axis)):
        for j in range(len(axis)):
            for k in range(len(axis)):
                values[i, j, k] = distance(kind, pose, axis[i], axis[j], axis[k])


@compiled
def _settle(kind: int, pose: Float64Array, points: Float64Array, normals: Float64Array) -> None:
    for n in range(len(points)):
        for _ in range(12):
            x, y, z = points[n, 0], points[n, 1], points[n, 2]
            gap = distance(kind, pose, x, y, z)
            nx, ny, nz = normal(kind, pose, x, y, z)
            normals[n, 0], normals[n, 1], normals[n, 2] = nx, ny, nz
            if abs(gap) < 1e-9:
                break
            points[n, 0], points[n, 1], points[n, 2] = x - gap * nx, y - gap * ny, z - gap * nz
