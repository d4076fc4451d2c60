"""Jobs on a scan: reading it, finding its contact, refining its pose, scoring."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...core.estimation.start_pose import transformed
from ...core.lab.scan import (
    PaintSettings,
    RefinedPose,
    Scan,
    ScanTruth,
    load_scan,
    painted_contact,
    refine_pose,
    scan_truth,
    score_against_scan,
    surface_points,
)
from ...core.model.arrays import AnyArray, BoolArray, Float32Array, Float64Array, IndexArray, Uint8Array
from ...core.model.frames import Matrix4
from ..worker.jobs import Progress

#: Number of colours and of vertices that a scan is drawn with.
PALETTE = 127
_MAX_SHOWN = 300_000
#: Direction of the light that shades a scan, in the scan frame, and brightness of its dark side.
_LIGHT = np.array([-0.4, -0.7, -0.6]) / np.linalg.norm([0.4, 0.7, 0.6])
_DARKEST = 0.5
_SPACINGS_M = (0.0005, 0.001, 0.002, 0.004)
_MAX_POINTS = 60_000


@dataclass(frozen=True, eq=False)
class LoadedScan:
    """A scan, prepared for display.

    Attributes
    ----------
    key : str
        Digest of the scan's content.
    shown : int, shape (K,)
        The displayed vertices: all, or an even selection of a large scan.
    palette : uint8, shape (P, 3), P <= PALETTE
        RGB of the shaded scan.
    rows : uint8, shape (K,)
        Row of the palette for each shown vertex.
    """

    path: Path
    unit_m: float
    scan: Scan
    key: str
    shown: IndexArray
    palette: Uint8Array
    rows: Uint8Array


@dataclass(frozen=True, eq=False)
class ScanContact:
    """The painted contact of a scan.

    Attributes
    ----------
    vertices : bool, shape (N,)
    points : float32, shape (K, 3)
        Points evenly spread over the contact, metres, scan frame.
    area_mm2 : float
        Along the surface, not projected.
    """

    loaded: LoadedScan
    paint: PaintSettings
    vertices: BoolArray
    points: Float32Array
    area_mm2: float


@dataclass(frozen=True)
class Refinement:
    """A pose found by ICP, and the RMSE before it, metres."""

    start: Matrix4
    before_m: float
    found: RefinedPose


@dataclass(frozen=True)
class Scores:
    """Scores of the patch against the scan in a pose; ``values`` are those of `score_against_scan`."""

    pose: Matrix4
    scan_area_mm2: float
    patch_area_mm2: float
    values: dict[str, float]


def load(path: Path, unit_m: float, progress: Progress) -> LoadedScan:
    """Read a scan; raises as `load_scan` does."""
    progress(0.05, f"Reading {path.name}")
    scan = load_scan(path, unit_m)
    progress(0.7, "Preparing the view")
    count = len(scan.vertices_m)
    shown = np.arange(count)
    if count > _MAX_SHOWN:
        shown = np.sort(np.random.default_rng(0).choice(count, _MAX_SHOWN, replace=False))
    palette, rows = _palette(_shaded(scan)[shown])
    progress(1.0, "Done")
    return LoadedScan(path, unit_m, scan, _key(scan), shown, palette, rows)


def find_contact(loaded: LoadedScan, paint: PaintSettings, progress: Progress) -> ScanContact:
    """Find a scan's contact."""
    progress(0.1, "Finding the paint")
    scan = loaded.scan
    vertices = painted_contact(scan, paint)
    shares = vertices[scan.triangles].mean(axis=1)
    area_m2 = float((scan.areas_m2 * shares).sum())
    fine = next((step for step in _SPACINGS_M if area_m2 <= _MAX_POINTS * step**2), _SPACINGS_M[-1])
    progress(0.6, "Spreading points")
    return ScanContact(
        loaded, paint, vertices, surface_points(scan, vertices, fine)[0].astype(np.float32), 1e6 * area_m2
    )


def refine(contact: ScanContact, patch: Float32Array, start: Matrix4, reach_m: float, progress: Progress) -> Refinement:
    """Refine a pose by ICP; raises as `refine_pose` does."""
    before: list[float] = []

    found = refine_pose(contact.points, patch, start)
    return Refinement(start, before[0], found)


class Scorer:
    """Scores patches against the scan, as ``tactune evaluate recording`` does."""

    def __init__(self) -> None:
        self._known: tuple[ScanContact, Matrix4, ScanTruth] | None = None

    def score(
        self, contact: ScanContact, patch: Float32Array, area_mm2: float, pose: Matrix4, progress: Progress
    ) -> Scores:
        """Score a patch. Only one call may run at a time."""
        progress(0.1, "Comparing")
        truth = self._truth(contact, pose)
        progress(0.5, "Comparing")
        return Scores(pose, truth.area_mm2, area_mm2, score_against_scan(patch, area_mm2, truth))

    def _truth(self, contact: ScanContact, pose: Matrix4) -> ScanTruth:
        """Return the scan's contact in a pose; the last one is cached."""
        if self._known is None or self._known[0] is not contact or self._known[1] != pose:
            self._known = contact, pose, scan_truth(contact.loaded.scan, contact.vertices, pose)
        return self._known[2]


def centered_on(contact: ScanContact, patch: Float32Array) -> Float64Array:
    """Return a start pose that moves the centre of the scan's contact to the patch's centre: float64 (4, 4)."""
    pose = np.eye(4)
    pose[:3, 3] = patch.mean(axis=0, dtype=np.float64) - contact.points.mean(axis=0, dtype=np.float64)
    return pose


def pivot_of(contact: ScanContact) -> Float64Array:
    """Return the centre of rotation in the scan frame: the centre of its contact, or of the whole scan."""
    points: AnyArray = contact.points if len(contact.points) else contact.loaded.scan.vertices_m
    centre: Float64Array = points.mean(axis=0, dtype=np.float64)
    return centre


def posed(contact: ScanContact, pose: Matrix4) -> Float64Array:
    """Return the contact's points in the proximity frame."""
    return transformed(pose, contact.points)


def _key(scan: Scan) -> str:
    told = hashlib.blake2b(digest_size=12)
    for array in (scan.vertices_m, scan.triangles, scan.colors):
        told.update(np.ascontiguousarray(array).tobytes())
    return told.hexdigest()


def _shaded(scan: Scan) -> Float64Array:
    """Return the colours shaded by the light's direction: (N, 3)."""
    a, b, c = (scan.vertices_m[scan.triangles[:, corner]] for corner in range(3))
    across = np.cross(b - a, c - a)
    normals = np.empty_like(scan.vertices_m)
    corners = scan.triangles.ravel()
    for axis in range(3):
        normals[:, axis] = np.bincount(corners, np.repeat(across[:, axis], 3), minlength=len(normals))
    lit = normals @ -_LIGHT / np.maximum(np.linalg.norm(normals, axis=1), 1e-30)
    shade = _DARKEST + (1.0 - _DARKEST) * (0.5 + 0.5 * lit)
    return np.asarray(scan.colors * shade[:, None])


def _palette(colors: Float64Array) -> tuple[Uint8Array, Uint8Array]:
    """Quantise colours: return the palette, uint8 (P, 3), and the palette row of each colour, uint8 (K,)."""
    from PIL import Image

    image = Image.fromarray(np.rint(colors).astype(np.uint8)[None])
    few = image.quantize(PALETTE, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    palette = np.array(few.getpalette(), np.uint8).reshape(-1, 3)[:PALETTE]
    return palette, np.asarray(few, np.uint8)[0]
