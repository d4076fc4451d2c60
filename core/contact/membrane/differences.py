"""Differences between both depths, cropped to where anything may touch."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...model.arrays import BoolArray, Float32Array, Uint16Array


@dataclass(frozen=True, eq=False)
class Differences:
    """Both depths in a rectangle of the proximity image; images are (H, W)."""

    place: tuple[slice, slice]  # Rows and columns of the rectangle
    difference_m: Float32Array  # Proximity less tactile depth, less ``bias_m``; 0 where it is too large
    counts: Uint16Array  # Raw proximity depth
    unit_m: np.float32  # Metres of a count
    usable: BoolArray  # Has both depths, less than the largest difference between them, and not the mask's colour
    excluded: BoolArray  # Outside the region or range
    bias_m: float  # The bias that was subtracted from the proximity depth before it was aligned
    #: (N,): The differences of pixels with the mask's colour; empty where the rig's bias was measured.
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
