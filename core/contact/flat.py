"""Flat images for the kernels, padded to at least one whole vector."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ..model.arrays import AnyArray, Float32Array
from ..model.clouds import ray_table
from ..model.intrinsics import Intrinsics
from .kernels.simd import LANES


def flat(image: AnyArray, min_length: int = LANES) -> AnyArray:
    """Return an image's elements in a row, padded with zeros to at least ``min_length`` elements."""
    pixels = np.ascontiguousarray(image).reshape(-1)
    return pixels if len(pixels) >= min_length else np.pad(pixels, (0, min_length - len(pixels)))


def planes_of(table: Float32Array) -> Float32Array:
    """Return a table (H, W, n) as n flat planes, one after another, each padded to a whole vector."""
    return np.concatenate([flat(np.ascontiguousarray(table[..., i])) for i in range(table.shape[2])])


@lru_cache(maxsize=8)
def ray_planes(intrinsics: Intrinsics) -> Float32Array:
    """Return `ray_table` for the kernels: all x / z, then all y / z, flat."""
    return planes_of(ray_table(intrinsics))
