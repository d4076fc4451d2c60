"""Points without an image, such as a scan's, as the cloud that both back ends draw."""

from __future__ import annotations

import numpy as np

from ...core.errors import FrameError
from ...core.model.arrays import AnyArray, Uint8Array
from .cloud_data import DepthCloud

_LEVELS = 65533
_LEAST_SPAN_M = 1e-3


def free_cloud(
    points: AnyArray,
    rows: Uint8Array,
    lut: Uint8Array,
    *,
    count: int | None = None,
    framed: bool = True,
) -> DepthCloud:
    """Show any points: an image one row high, whose rays and depths meet at them.

    Depth is 16 bits, so along z points move by up to half of 1 / 65533 of the cloud's depth (2.3 um for 300 mm).

    Parameters
    ----------
    points : float, shape (N, 3)
        Metres, in the frame of the view; finite. Pixel (0, i) of the cloud is point i.
    rows : uint8, shape (N,)
        Row of ``lut`` for every point.
    lut, count, framed
        As in `DepthCloud`.

    Raises
    ------
    FrameError
        There are not as many rows as points, or a coordinate is not finite.
    """
    places, rows = np.asarray(points, np.float64).reshape(-1, 3), np.asarray(rows, np.uint8)
    if len(rows) != len(places):
        raise FrameError(f"cloud: there are {len(places)} points but {len(rows)} rows of colours; give one for each")
    if not np.isfinite(places).all():
        raise FrameError("cloud: a point's coordinates are not finite; leave it out")
    if len(places) == 0:
        nothing = np.zeros((1, 1), np.uint16)
        rays = np.zeros((1, 1, 2), np.float32)
        return DepthCloud(nothing, _LEAST_SPAN_M, rays, lut, np.eye(4), count=count, framed=framed)
    near = float(places[:, 2].min())
    span = max(float(places[:, 2].max()) - near, _LEAST_SPAN_M)
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
        framed=framed,
    )
