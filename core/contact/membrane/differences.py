"""Differences between both depths, and what is made of contact pixels: groups and points.

Images are cropped to where anything may touch.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from ...model.arrays import BoolArray, Float32Array, Uint16Array
from ...model.clouds import ray_table
from ...model.frames import Rig
from ...model.patch import Candidates
from ...preset import MembraneSection
from ..finder import CandidateBuffers
from ..kernels import membrane as kernels
from ..outliers.clusters import in_large_cluster

#: Sigma of the Gaussian window over which the depth of the points is averaged, pixels, and its reach.
POINT_WINDOW_PX: Final = 2.0
_POINT_REACH_PX: Final = 4
#: Share of a point's window that must be in contact.
_MIN_SHARE: Final = np.float32(0.05)


@dataclass(frozen=True, eq=False)
class Differences:
    """Both depths in a rectangle of the proximity image; images are (H, W).

    Attributes
    ----------
    place : tuple of slice
        Rows and columns of the rectangle.
    difference_m : float32
        Proximity less tactile depth, less ``bias_m``; 0 where it is too large.
    counts : uint16
        Raw proximity depth.
    unit_m : float32
        Metres of a count.
    usable : bool
        Has both depths, less than the largest difference between them, and not the mask's colour.
    excluded : bool
        Outside the region or range.
    bias_m : float
        The bias that was subtracted from the proximity depth before it was aligned.
    on_prints_m : float32, shape (N,)
        The differences of pixels with the mask's colour; empty where the rig's bias was measured.
    """

    place: tuple[slice, slice]
    difference_m: Float32Array
    counts: Uint16Array
    unit_m: np.float32
    usable: BoolArray
    excluded: BoolArray
    bias_m: float
    on_prints_m: Float32Array

    def depth_m(self, counts: Uint16Array) -> Float32Array:
        """Return raw proximity depth in metres, less ``bias_m``."""
        depth = counts * self.unit_m
        depth -= np.float32(self.bias_m)
        return depth

    @property
    def corner(self) -> tuple[int, int]:
        """Row and column at which the rectangle begins."""
        return self.place[0].start, self.place[1].start

    def cut(self, part: tuple[slice, slice]) -> Differences:
        """Return a part of the rectangle."""
        height, width = self.usable.shape
        (top, left), (first, last, _), (begin, end, _) = self.corner, part[0].indices(height), part[1].indices(width)
        return replace(
            self,
            place=(slice(top + first, top + last), slice(left + begin, left + end)),
            difference_m=self.difference_m[part].copy(),
            counts=self.counts[part].copy(),
            usable=self.usable[part].copy(),
            excluded=self.excluded[part].copy(),
        )


def large_contacts(contact: BoolArray, differences: Differences, section: MembraneSection, rig: Rig) -> BoolArray:
    """Return contact without connected groups whose usable pixels are smaller than the preset's smallest contact."""
    camera, (top, left) = rig.proximity.intrinsics, differences.corner
    found, width = np.flatnonzero(contact), contact.shape[1]
    pixels = found + (found // width) * (camera.width - width) + (top * camera.width + left)
    depth = differences.depth_m(differences.counts.reshape(-1)[found]) * differences.usable.reshape(-1)[found]
    large = in_large_cluster(depth, pixels, camera, section.min_area_mm2)
    if large.all():
        return contact
    kept = np.zeros_like(contact)
    kept.reshape(-1)[found[large]] = True
    return kept


def surface_points(
    contact: BoolArray,
    differences: Differences,
    bias_m: float,
    tactile_weight: float,
    rig: Rig,
    buffers: CandidateBuffers,
) -> Candidates:
    """Return contact pixels that have a depth, with smoothed points weighted from both cameras' depths.

    Parameters
    ----------
    bias_m : float
        Bias of the differences, beyond the `Differences.bias_m` that was subtracted.
    tactile_weight : float
        Weight of the tactile depth, 0 to 1; the proximity depth has the rest.
    """
    import cv2  # here and below: importing the pipeline must not wait for it

    part = surroundings(contact, _POINT_REACH_PX)
    if part is None:
        return buffers.collect({0: 0})
    size = (2 * _POINT_REACH_PX + 1,) * 2
    weight = (contact[part] & differences.usable[part]).view(np.uint8).astype(np.float32)
    depth = differences.depth_m(differences.counts[part]) - np.float32(tactile_weight) * differences.difference_m[part]
    depth -= np.float32((1 - tactile_weight) * bias_m)
    share = np.asarray(cv2.GaussianBlur(weight, size, POINT_WINDOW_PX))
    depth = cv2.GaussianBlur(depth * weight, size, POINT_WINDOW_PX) / np.maximum(share, np.float32(1e-6))
    (top, left), (rows, columns) = differences.corner, part
    window = kernels.RayWindow(ray_table(rig.proximity.intrinsics), top + rows.start, left + columns.start)
    count = kernels.collect_points(
        np.ascontiguousarray(contact[part]), depth, share, _MIN_SHARE, window, buffers.pixels, buffers.points
    )
    return buffers.collect({0: count})


def surroundings(marked: BoolArray, margin_px: int) -> tuple[slice, slice] | None:
    """Return the bounding box of the marked pixels, padded by ``margin_px``; None without any."""
    rows, columns = (np.flatnonzero(marked.any(axis=axis)) for axis in (1, 0))
    if len(rows) == 0:
        return None
    height, width = marked.shape
    return (
        slice(max(int(rows[0]) - margin_px, 0), min(int(rows[-1]) + 1 + margin_px, height)),
        slice(max(int(columns[0]) - margin_px, 0), min(int(columns[-1]) + 1 + margin_px, width)),
    )
