"""Prediction of a click's partner in the other image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.model.arrays import Float64Array, IndexArray
from ...core.model.clouds import valid_depth
from ...core.model.frames import Rig, SensorFrame
from .pictures import tactile_depth_at
from .session import Place, ProximityImage

_NEAREST_M, _FARTHEST_M, _STEPS = 0.08, 1.2, 480


@dataclass(frozen=True, eq=False)
class Alignment:
    """An alignment as the preset stores it: a pose with its depth correction, or a homography.

    Attributes
    ----------
    pose : float64 (4, 4) or None
        ``T_p_t``, metres; None for a homography.
    homography : float64 (3, 3) or None
        ``H_p_t``, tactile to proximity depth pixels.
    scale, offset_m : float
        Corrected tactile depth = scale * raw + offset.
    """

    pose: Float64Array | None = None
    homography: Float64Array | None = None
    scale: float = 1.0
    offset_m: float = 0.0


def nominal_alignment(rig: Rig) -> Alignment | None:
    """Return the alignment stated by the rig, or None."""
    return None if rig.T_proximity_tactile is None else Alignment(pose=np.asarray(rig.T_proximity_tactile))


def proximity_partner(
    alignment: Alignment, rig: Rig, frame: SensorFrame, image: ProximityImage, place: Place
) -> Place | None:
    """Predict the proximity pixel of a tactile pixel; None if that is not possible."""
    raw_m = tactile_depth_at(frame, rig, *place)
    if alignment.pose is not None:
        if raw_m is None:
            return None
        depth_m = alignment.scale * raw_m + alignment.offset_m
        ray = rig.tactile.intrinsics.normalise([place])[0]
        point = alignment.pose[:3, :3] @ np.array([*ray, 1.0]) * depth_m + alignment.pose[:3, 3]
        return _inside(project_into(point[None], rig, image)[0], rig, image)
    assert alignment.homography is not None
    x, y, w = alignment.homography @ (*place, 1.0)
    if abs(w) < 1e-12:
        return None
    if image == "depth" or rig.proximity_color is None:
        return _inside(np.array([x / w, y / w]), rig, image)
    if raw_m is None:
        return None
    ray = rig.proximity.intrinsics.normalise([(x / w, y / w)])[0]
    return _inside(project_into((np.array([*ray, 1.0]) * raw_m)[None], rig, image)[0], rig, image)


def tactile_partner(
    alignment: Alignment, rig: Rig, frame: SensorFrame, image: ProximityImage, place: Place
) -> Place | None:
    """Predict the tactile pixel of a pixel of a proximity image.

    The click's ray is followed until it intersects the membrane measured by the tactile camera.
    """
    distances = np.linspace(_NEAREST_M, _FARTHEST_M, _STEPS)
    points = _ray(rig, image, place, distances)
    if alignment.pose is not None:
        inverse = np.linalg.inv(alignment.pose)
        seen = points @ inverse[:3, :3].T + inverse[:3, 3]
        behind_m = seen[:, 2]
        pixels = rig.tactile.intrinsics.project(seen)
    else:
        assert alignment.homography is not None
        flat = rig.proximity.intrinsics.project(points)
        mapped = np.column_stack([flat, np.ones(_STEPS)]) @ np.linalg.inv(alignment.homography).T
        pixels, behind_m = mapped[:, :2] / mapped[:, 2:], points[:, 2]
        if image == "depth" or rig.proximity_color is None:
            return _inside_tactile(pixels[0], rig)
    beyond = behind_m - _membrane_m(frame, rig, alignment, pixels)
    crossing = np.flatnonzero((beyond[:-1] <= 0) & (beyond[1:] > 0))
    if len(crossing) == 0:
        return None
    first = int(crossing[0])
    share = -beyond[first] / (beyond[first + 1] - beyond[first])
    return _inside_tactile(pixels[first] + share * (pixels[first + 1] - pixels[first]), rig)


def _membrane_m(frame: SensorFrame, rig: Rig, alignment: Alignment, pixels: Float64Array) -> Float64Array:
    """Return the corrected tactile depth at pixels, nan where there is none."""
    height, width = frame.tactile_depth.shape
    nearest: IndexArray = np.clip(np.rint(pixels), -1, [width, height]).astype(np.intp)
    u, v = nearest.T
    inside = (u >= 0) & (v >= 0) & (u < width) & (v < height)
    counts = frame.tactile_depth[np.where(inside, v, 0), np.where(inside, u, 0)]
    depth_m = alignment.scale * counts * rig.tactile.depth_unit_m + alignment.offset_m
    return np.where(inside & valid_depth(counts), depth_m, np.nan)


def _ray(rig: Rig, image: ProximityImage, place: Place, distances: Float64Array) -> Float64Array:
    """Return points along the ray of a click, proximity depth frame."""
    color = rig.proximity_color if image == "color" else None
    lens = rig.proximity.intrinsics if color is None else color.intrinsics
    points = np.array([*lens.normalise([place])[0], 1.0]) * distances[:, None]
    if color is None:
        return points
    T_depth_color = np.linalg.inv(np.asarray(color.T_color_depth))
    return points @ T_depth_color[:3, :3].T + T_depth_color[:3, 3]


def project_into(points: Float64Array, rig: Rig, image: ProximityImage) -> Float64Array:
    """Project points of the proximity depth frame (N, 3), metres, to pixels of a proximity image (N, 2)."""
    if image == "depth" or rig.proximity_color is None:
        return rig.proximity.intrinsics.project(points)
    T_color_depth = np.asarray(rig.proximity_color.T_color_depth)
    return rig.proximity_color.intrinsics.project(points @ T_color_depth[:3, :3].T + T_color_depth[:3, 3])


def _inside(place: Float64Array, rig: Rig, image: ProximityImage) -> Place | None:
    height, width = rig.proximity_color_shape if image == "color" else rig.proximity.intrinsics.shape
    return _checked(place, width, height)


def _inside_tactile(place: Float64Array, rig: Rig) -> Place | None:
    return _checked(place, rig.tactile.intrinsics.width, rig.tactile.intrinsics.height)


def _checked(place: Float64Array, width: int, height: int) -> Place | None:
    u, v = float(place[0]), float(place[1])
    return (u, v) if -0.5 <= u <= width - 0.5 and -0.5 <= v <= height - 0.5 else None
