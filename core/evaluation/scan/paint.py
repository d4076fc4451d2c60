"""Contact shown by thermochromic paint on a scan: painted vertices, points on them, and a patch compared with them."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from pydantic import ValidationError
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ...contact.masking import in_hsv_range
from ...errors import TactuneError
from ...model.arrays import AnyArray, BoolArray, Float32Array, Float64Array
from ...model.frames import Matrix4
from ...preset import MaskSection
from ..metrics import cloud_distances
from .pose import transformed
from .scan import Scan

SPACING_M: Final = 0.0005
_MAX_POINTS: Final = 5_000_000

#: Steps of the R2 low-discrepancy sequence (Roberts 2018): powers of 1 / x, where x^3 = x + 1.
_PLASTIC: Final = 1.3247179572447460
_STEPS: Final = (1 / _PLASTIC, 1 / _PLASTIC**2)


@dataclass(frozen=True)
class PaintSettings:
    """Colour of the touched paint, and the clean-up of its spots.

    Attributes
    ----------
    hue : tuple of int
        Hue range of the touched paint, 0 to 179 (OpenCV). A low end above the high end wraps around through red.
    saturation, value : tuple of int
        Ranges, 0 to 255.
    least_area_mm2 : float
        Smaller spots are removed and smaller holes filled.
    largest : int
        Number of spots to keep, largest first; 0 keeps all.

    Raises
    ------
    TactuneError
        A range or number is invalid.
    """

    hue: tuple[int, int] = (150, 179)
    saturation: tuple[int, int] = (40, 255)
    value: tuple[int, int] = (60, 255)
    least_area_mm2: float = 20.0
    largest: int = 0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.least_area_mm2) and self.least_area_mm2 >= 0):
            raise TactuneError(f"the paint's least area is {self.least_area_mm2} mm2; give a number from 0")
        if self.largest < 0:
            raise TactuneError(f"the paint keeps {self.largest} spots; give a number from 0, where 0 keeps all")
        self.color_range()

    def color_range(self) -> MaskSection:
        """Return the colour range, validated."""
        try:
            return MaskSection(hue=self.hue, saturation=self.saturation, value=self.value)
        except ValidationError as error:
            first = error.errors()[0]
            name = ".".join(map(str, first["loc"])) or "range"
            raise TactuneError(f"the paint's {name} is invalid: {first['msg']}; it is {first['input']!r}") from error


def painted_contact(scan: Scan, paint: PaintSettings) -> BoolArray:
    """Tell which vertices have the colour of touched paint, after the clean-up.

    First holes below the least area are filled, then spots below it are removed, then the largest spots are kept.
    Spots are connected along mesh edges. The area of a vertex is a third of the area of its triangles.

    Returns
    -------
    bool, shape (N,)
    """
    contact = in_hsv_range(scan.colors[None], paint.color_range())[0]
    least_m2 = 1e-6 * paint.least_area_mm2
    shares = _vertex_areas(scan)
    contact = contact | _small(scan, ~contact, shares, least_m2)
    contact = contact & ~_small(scan, contact, shares, least_m2)
    return _among_largest(scan, contact, shares, paint.largest) if paint.largest else contact


def contact_points(scan: Scan, contact: BoolArray, spacing_m: float = SPACING_M) -> Float32Array:
    """Return evenly spread points on the surface in contact; deterministic.

    Contact is interpolated linearly between vertices and ends at 0.5.

    Parameters
    ----------
    scan : Scan
    contact : bool, shape (N,)
        From `painted_contact`.
    spacing_m : float
        Each point represents a square of this side length, metres.

    Returns
    -------
    float32, shape (K, 3)
        Metres, in the scan's frame; empty without contact.

    Raises
    ------
    TactuneError
        ``contact`` has another number of vertices, or the spacing is invalid or gives too many points.
    """
    return surface_points(scan, contact, spacing_m)[0].astype(np.float32)


def surface_points(scan: Scan, contact: BoolArray, spacing_m: float = SPACING_M) -> tuple[Float64Array, Float64Array]:
    """Return the points of `contact_points` and the unit normals of their triangles, float64, each (K, 3)."""
    if contact.shape != (len(scan.vertices_m),):
        raise TactuneError(
            f"contact has the shape {contact.shape}, but the scan has {len(scan.vertices_m)} vertices; "
            "compute it from this scan"
        )
    touching = np.flatnonzero(contact[scan.triangles].any(axis=1))
    areas = scan.areas_m2[touching]
    if not (math.isfinite(spacing_m) and spacing_m > 0):
        raise TactuneError(f"the spacing is {spacing_m} m; give the distance of neighbouring points, such as 0.0005")
    if areas.sum() / spacing_m**2 > _MAX_POINTS:
        raise TactuneError(
            f"the painted contact is {1e4 * areas.sum():.3g} cm2 on a scan of {scan.size_m:.3g} m, too large for "
            f"points {1e3 * spacing_m:g} mm apart; check the scan's unit and the paint's colour"
        )
    if len(touching) == 0:
        return np.empty((0, 3)), np.empty((0, 3))
    count = max(round(areas.sum() / spacing_m**2), 1)
    ends = np.cumsum(areas)
    places = (np.arange(count) + 0.5) / count * ends[-1]
    chosen = np.minimum(np.searchsorted(ends, places, side="right"), len(touching) - 1)
    corners = scan.triangles[touching[chosen]]
    weights = _spread_weights(count)
    inside = (weights * contact[corners]).sum(axis=1) >= 0.5
    a, b, c = (scan.vertices_m[corners[inside, k]] for k in range(3))
    w = weights[inside]
    across = np.cross(b - a, c - a)
    points = w[:, :1] * a + w[:, 1:2] * b + w[:, 2:] * c
    return points, across / np.linalg.norm(across, axis=1, keepdims=True)


def _spread_weights(count: int) -> Float64Array:
    """Return barycentric weights, (count, 3), spread evenly over a triangle."""
    numbers = np.arange(1, count + 1)
    s, t = ((0.5 + step * numbers) % 1.0 for step in _STEPS)
    folded = s + t > 1.0
    s, t = np.where(folded, 1 - s, s), np.where(folded, 1 - t, t)
    return np.column_stack([1 - s - t, s, t])


def _vertex_areas(scan: Scan) -> Float64Array:
    """Return a third of the area of each vertex's triangles, m^2."""
    thirds = np.repeat(scan.areas_m2 / 3, 3)
    return np.asarray(np.bincount(scan.triangles.ravel(), thirds, minlength=len(scan.vertices_m)), np.float64)


def _spots(scan: Scan, marked: BoolArray) -> tuple[int, AnyArray]:
    """Return the number of connected groups of marked vertices, and the group of each vertex."""
    t = scan.triangles
    edges = np.concatenate([t[:, (0, 1)], t[:, (1, 2)], t[:, (2, 0)]])
    edges = edges[marked[edges].all(axis=1)]
    graph = coo_array((np.ones(len(edges), np.int8), (edges[:, 0], edges[:, 1])), (len(marked), len(marked)))
    count, labels = connected_components(graph, directed=False)
    return int(count), labels


def _small(scan: Scan, marked: BoolArray, shares: Float64Array, least_m2: float) -> BoolArray:
    """Tell which marked vertices belong to a spot smaller than an area, m^2."""
    count, labels = _spots(scan, marked)
    return np.asarray(marked & (np.bincount(labels, shares, minlength=count)[labels] < least_m2))


def _among_largest(scan: Scan, marked: BoolArray, shares: Float64Array, most: int) -> BoolArray:
    """Tell which marked vertices belong to the largest spots."""
    count, labels = _spots(scan, marked)
    areas = np.bincount(labels, shares * marked, minlength=count)
    kept = np.argsort(-areas, kind="stable")[:most]
    return np.asarray(np.isin(labels, kept) & marked)


@dataclass(frozen=True, eq=False)
class ScanTruth:
    """True contact from a painted scan.

    Attributes
    ----------
    points : float64, shape (K, 3)
        Points spread evenly over the contact, metres, proximity depth frame.
    area_mm2 : float
        Area projected on the plane across the optical axis, as for patches.
    """

    points: Float64Array
    area_mm2: float


def scan_truth(scan: Scan, contact: BoolArray, pose: Matrix4) -> ScanTruth:
    """Transform a scan's contact to the proximity frame.

    Parameters
    ----------
    scan : Scan
    contact : bool, shape (N,)
        As from `painted_contact`.
    pose : 4 x 4
        ``T_proximity_scan``.

    Raises
    ------
    TactuneError
        The pose puts contact behind the camera; also see `contact_points`.
    """
    found, normals = surface_points(scan, contact)
    points = transformed(pose, found)
    if len(points) and points[:, 2].min() <= 0:
        raise TactuneError(
            "the transform puts the scan's contact behind the proximity camera; it must take the scan's frame, in "
            "metres, to the proximity depth frame"
        )
    turned = normals @ np.asarray(pose)[:3, :3].T
    # projected area of a surface element with normal n seen along ray p: |n . p| / p_z
    projected = np.abs((turned * points).sum(axis=1)) / points[:, 2]
    return ScanTruth(points, float(projected.sum()) * 1e6 * SPACING_M**2)


def score_against_scan(patch: npt.ArrayLike, area_mm2: float, truth: ScanTruth) -> dict[str, float]:
    """Score a patch, (N, 3) in metres, and its area against the true contact.

    Returns
    -------
    dict
        The fields of `CloudDistances` in millimetres, such as ``patch_to_truth_rms_mm`` (nan if either is empty), and
        ``area_error_mm2``, patch minus truth.
    """
    apart = asdict(cloud_distances(patch, truth.points))
    scores = {f"{name.removesuffix('_m')}_mm": 1e3 * value for name, value in apart.items()}
    area = area_mm2 if math.isfinite(area_mm2) else 0.0
    return scores | {"area_error_mm2": area - truth.area_mm2}
