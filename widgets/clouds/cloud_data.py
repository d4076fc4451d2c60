"""Point clouds as the views take them: depth images that are deprojected while drawn, and free points."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from ...core.model.arrays import AnyArray, BoolArray, Float32Array, Float64Array, IndexArray, Uint8Array, Uint16Array

#: The largest raw count that is a depth.
HIGHEST_COUNT = 65534


@dataclass(frozen=True, eq=False)
class DepthCloud:
    """A depth image with everything needed to draw it as a coloured point cloud.

    Arrays are shared, not copied, and must not change afterwards: views recognise them by identity. Corrected
    depth is ``depth_scale * depth_unit_m * counts + depth_offset_m``, metres; points where it is not positive are not
    drawn.
    """

    depth: Uint16Array  # (H, W) raw counts; 0 and 65535 are no depth and never drawn
    depth_unit_m: float
    rays: Float32Array  # (H, W, 2): x / z and y / z of every pixel, as `Intrinsics.rays` returns it
    lut: Uint8Array  # (256, 4) RGBA; alpha 0 hides a point; in between, the background shows through
    pose: Float64Array  # (4, 4): takes points of the camera to the frame of the view, the proximity depth frame
    depth_scale: float = 1.0
    depth_offset_m: float = 0.0
    #: (H, W) rows of ``lut``; None: from the corrected depth, ``depth_range_m`` over rows 0 to 255.
    index: Uint8Array | None = None
    depth_range_m: tuple[float, float] = (0.0, 1.0)
    #: The number of points that a view states, where it is not the number of points drawn (a patch over its context).
    count: int | None = None

    def __post_init__(self) -> None:
        for name in ("depth", "rays", "lut", "pose", "index"):
            array = getattr(self, name)
            if array is not None and not array.flags.c_contiguous:
                object.__setattr__(self, name, np.ascontiguousarray(array))

    @property
    def metres_per_count(self) -> float:
        return self.depth_unit_m * self.depth_scale

    @property
    def index_from_depth(self) -> tuple[float, float]:
        """``(a, b)``: the row of ``lut`` is ``floor(clip(a z + b, 0, 1) * 255 + 0.5)`` for depth z, metres."""
        near, far = self.depth_range_m
        return 1.0 / (far - near), -near / (far - near)

    def looks_like(self, other: DepthCloud) -> bool:
        """Whether both clouds share their arrays and have equal numbers, so that one picture shows both."""
        shared = (getattr(self, name) is getattr(other, name) for name in ("depth", "rays", "lut", "index"))
        numbers = ("depth_unit_m", "depth_scale", "depth_offset_m", "depth_range_m", "count")
        equal = (getattr(self, name) == getattr(other, name) for name in numbers)
        return all(shared) and all(equal) and bool((self.pose == other.pose).all())

    def drawn(self) -> BoolArray:
        """Return the pixels that appear as points: bool (H, W)."""
        lowest = max(1, int(np.floor(-self.depth_offset_m / self.metres_per_count)) + 1)
        if lowest > HIGHEST_COUNT:
            return np.zeros(self.depth.shape, np.bool_)
        drawn = (self.depth >= lowest) & (self.depth <= HIGHEST_COUNT)
        if not self.lut[:, 3].all():
            opaque = (self.lut[:, 3] > 0).astype(np.uint8)
            drawn &= np.asarray(cv2.LUT(self.rows(), opaque)).view(np.bool_)
        return drawn

    def rows(self) -> Uint8Array:
        """Return the row of ``lut`` for every pixel: uint8 (H, W)."""
        if self.index is not None:
            return self.index
        a, b = self.index_from_depth
        depth = self.depth * np.float32(self.metres_per_count) + np.float32(self.depth_offset_m)
        share = np.clip(depth * np.float32(a) + np.float32(b), np.float32(0), np.float32(1))
        rows: Uint8Array = (share * np.float32(255) + np.float32(0.5)).astype(np.uint8)
        return rows

    def near(self, pixel_matrix: Float64Array, at: tuple[float, float], reach: float) -> IndexArray:
        """Return the flat pixels of the points drawn within ``reach`` of a place of the view; see `ViewCamera`."""
        across, down, away = (pixel_matrix @ self.pose).astype(np.float32)
        z = self.depth * np.float32(self.metres_per_count) + np.float32(self.depth_offset_m)
        x, y = self.rays[..., 0], self.rays[..., 1]

        def along(row: Float32Array) -> Float32Array:
            return np.asarray(z * (row[0] * x + row[1] * y + row[2]) + row[3])

        u, v = (along(row - np.float32(place) * away) for row, place in zip((across, down), at, strict=True))
        within = np.maximum(np.abs(u), np.abs(v)) <= np.float32(reach) * along(away)
        pixels = np.flatnonzero(within)
        return np.asarray(pixels[self.drawn().reshape(-1)[pixels]])

    def places(self, pixels: IndexArray) -> Float64Array:
        """Return where flat pixels lie in the frame of the view: float64 (N, 3), metres."""
        depth = self.depth.reshape(-1)[pixels] * self.metres_per_count + self.depth_offset_m
        rays = self.rays.reshape(-1, 2)[pixels].astype(np.float64)
        in_camera = np.column_stack([rays * depth[:, None], depth])
        return np.asarray(in_camera @ self.pose[:3, :3].T + self.pose[:3, 3])

    def points(self, step: int = 1) -> Float64Array:
        """Return the drawn pixels of every ``step``-th row and column in the frame of the view: (N, 3), metres."""
        chosen = np.zeros(self.depth.shape, np.bool_)
        chosen[::step, ::step] = self.drawn()[::step, ::step]
        return self.places(np.flatnonzero(chosen))

    @cached_property
    def point_count(self) -> int:
        return int(np.count_nonzero(self.drawn())) if self.count is None else self.count


_LEVELS = 65533
_MIN_SPAN_M = 1e-3


def free_cloud(points: AnyArray, rows: Uint8Array, lut: Uint8Array, *, count: int) -> DepthCloud:
    """Return a cloud of one or more points (N, 3), metres, in the frame of the view: an image of one row.

    ``rows`` (N,) are those of ``lut``; pixel (0, i) is point i. Depth is 16 bits, so along z points move by up to half
    of 1 / 65533 of the cloud's depth (2.3 um for 300 mm).
    """
    places = np.asarray(points, np.float64)
    near = float(places[:, 2].min())
    span = max(float(places[:, 2].max()) - near, _MIN_SPAN_M)
    unit = span / _LEVELS
    counts = np.rint((places[:, 2] - near) / unit).astype(np.uint16) + np.uint16(1)
    # Seen from one span before the nearest point, so that no ray is steeper than the cloud is wide.
    depth = counts * unit + span
    pose = np.eye(4)
    pose[2, 3] = near - unit - span
    return DepthCloud(
        depth=counts[None],
        depth_unit_m=unit,
        rays=(places[:, :2] / depth[:, None]).astype(np.float32)[None],
        lut=lut,
        pose=pose,
        depth_offset_m=span,
        index=rows[None],
        count=count,
    )
