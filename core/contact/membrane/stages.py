"""The stages of the membrane contact test after the first: gaps, edge of contact, clusters, points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...model.arrays import BoolArray, Float32Array, Uint8Array
from ...model.clouds import ray_table
from ...model.frames import Rig
from ...model.provenance import Provenance
from ...preset import MembraneSection
from ..candidates import CandidateBuffers, Candidates
from ..kernels import membrane as kernels
from ..kernels.simd import LANES
from ..outliers.clusters import in_large_cluster
from .differences import Differences
from .steps import EDGE_MARGIN_PX, LocalMean, contact_bias_m, erode_rim, surroundings, turn_to_normal, window_reach

#: Share of a pixel's surroundings that must be usable for a gap, and of contact for a point.
_LEAST_SHARE, _LEAST_SHARE_OF_POINT = np.float32(0.4), np.float32(0.05)
#: The edge of contact is found from the lines where the gap is the largest one and where it is so many times that,
#: which must be below this share of the largest difference between both depths, beyond which nothing is known.
_FAR, _FARTHEST_SHARE = 2.5, 0.9
#: Lines that are nearer tell no edge.
_LEAST_FAR = 1.3


@dataclass(frozen=True, eq=False)
class Gaps:
    """Local means of the gap between membrane and object.

    Attributes
    ----------
    gap_m : float32, shape (H, W)
        Free of the sensors' bias, along the surface's normal.
    known : bool, shape (H, W)
        Where enough pixels are usable.
    bias_m : float
        What was taken off the differences before they were turned to the normal.
    differences : Differences
        What they are means of, cut to the surroundings of the known ones.
    """

    gap_m: Float32Array
    known: BoolArray
    bias_m: float
    differences: Differences


def mean_gaps(everywhere: Differences, section: MembraneSection, rig: Rig) -> Gaps | None:
    """Average the differences and free them of bias and slope; None where nowhere enough pixels are usable."""
    camera, margin_px = rig.proximity.intrinsics, window_reach(section.window_px) + EDGE_MARGIN_PX
    means = LocalMean(everywhere.usable, section.window_px)
    known = (means.share > _LEAST_SHARE) & ~everywhere.excluded
    part = surroundings(known, margin_px, vectors=LANES)
    if part is None:
        return None
    differences, means, known = everywhere.cut(part), means.cut(part), np.ascontiguousarray(known[part])
    bias_m = differences.print_bias_m if section.bias_m > 0 else 0.0
    gap = means.of(differences.difference_m - np.float32(bias_m))
    if section.bias_m > 0:
        # half of it: with little contact the most frequent gap is not that of contact
        contact_m = np.float32(contact_bias_m(gap, known, section.bias_m) / 2)
        gap -= contact_m
        bias_m += float(contact_m)
    if section.slope:
        smoothing = means if section.window_px >= 1 else LocalMean(differences.usable, 1.0)
        depth = smoothing.of(differences.depth_m)
        turn_to_normal(gap, depth, ray_table(camera), differences.corner, (camera.fx, camera.fy))
    return Gaps(gap, known, bias_m, differences)


def within_edge(gaps: Gaps, section: MembraneSection) -> BoolArray:
    """Return the pixels that are near the object, without the rim where the membrane only leaves it."""
    near = near_pixels(gaps, section)
    far = min(_FAR, _FARTHEST_SHARE * section.difference_m / section.gap_m) if section.gap_m > 0 else _FAR
    if section.erosion == 0 or far < _LEAST_FAR:
        return near
    wide = gaps.known & (gaps.gap_m < np.float32(far * section.gap_m))
    return erode_rim(near, wide, far, section.erosion, section.core_share, section.max_erosion_px)


def near_pixels(gaps: Gaps, section: MembraneSection) -> BoolArray:
    """Return the pixels whose mean gap is smaller than the largest."""
    return gaps.known & (gaps.gap_m < np.float32(section.gap_m))


def large_contacts(contact: BoolArray, gaps: Gaps, section: MembraneSection, rig: Rig) -> BoolArray:
    """Return contact without connected groups that are smaller than the preset's smallest contact."""
    camera, (top, left), depth_m = rig.proximity.intrinsics, gaps.differences.corner, gaps.differences.depth_m
    rows, columns = np.nonzero(contact)
    pixels = (rows + top) * camera.width + columns + left
    large = in_large_cluster(depth_m[rows, columns], pixels, camera, section.min_area_mm2)
    if large.all():
        return contact
    kept = np.zeros_like(contact)
    kept[rows[large], columns[large]] = True
    return kept


def surface_points(
    contact: BoolArray, gaps: Gaps, section: MembraneSection, rig: Rig, buffers: CandidateBuffers
) -> Candidates:
    """Return contact that has a depth, with points from both sensors' depths, smoothed."""
    differences = gaps.differences
    means = LocalMean(contact & differences.usable, section.smooth_px)
    depth = means.of(differences.depth_m - np.float32(section.tactile_weight) * differences.difference_m)
    count = kernels.collect_points(
        contact, depth, means.share, _LEAST_SHARE_OF_POINT, ray_table(rig.proximity.intrinsics), *differences.corner,
        buffers.pixels, buffers.points,
    )  # fmt: skip
    return buffers.collect({0: count})


def early_provenance(verdicts: Uint8Array, everywhere: Differences) -> Uint8Array:
    """Write over the verdicts of `DifferenceFinder.classify` that nowhere enough pixels are usable."""
    verdicts[everywhere.place][everywhere.usable] = Provenance.OUTLIER
    return verdicts


def full_provenance(
    verdicts: Uint8Array,
    everywhere: Differences,
    gaps: Gaps,
    section: MembraneSection,
    within: BoolArray,
    pressed: BoolArray,
    balanced: BoolArray,
    large: BoolArray,
    contact: Candidates,
) -> Uint8Array:
    """Write the verdicts of the later stages over those of `DifferenceFinder.classify`."""
    early_provenance(verdicts, everywhere)
    part, usable = verdicts[gaps.differences.place], gaps.differences.usable
    part[usable & gaps.known] = Provenance.OUTSIDE_TOLERANCE
    part[usable & near_pixels(gaps, section)] = Provenance.RIM
    part[usable & within] = Provenance.NOT_PRESSED
    part[usable & pressed] = Provenance.RIM
    part[usable & balanced] = Provenance.SMALL_CLUSTER
    part[usable & large] = Provenance.OUTLIER
    verdicts.reshape(-1)[contact.pixels] = Provenance.CONTACT
    return verdicts
