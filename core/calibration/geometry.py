"""Rays of clicks in both cameras, and an alignment as a preset states it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..contact.alignment import tactile_homography, tactile_pose
from ..model.arrays import BoolArray, Float32Array, Float64Array
from ..model.frames import Rig
from ..model.intrinsics import Intrinsics
from ..preset import AlignmentSection

_NEWTON_STEPS = 8


def ray_seen(intrinsics: Intrinsics, pixels: npt.ArrayLike) -> Float64Array:
    """Return ``(x / z, y / z)`` of the rays that `Intrinsics.project` takes to pixels (N, 2), for every lens model."""
    pixels = np.asarray(pixels, np.float64)
    rays = intrinsics.normalise(pixels)
    if not intrinsics.has_distortion:
        return rays
    focal = np.array([intrinsics.fx, intrinsics.fy])
    with np.errstate(all="ignore"):  # there is no ray beyond the fold
        for _ in range(_NEWTON_STEPS):
            again = intrinsics.project(np.column_stack([rays, np.ones(len(rays))]))
            rays = rays + (pixels - again) / focal
    return rays


def color_pose(rig: Rig) -> Float64Array:
    """Return ``T_color_depth`` of the proximity camera; the identity if colour is aligned to depth."""
    return np.eye(4) if rig.proximity_color is None else np.asarray(rig.proximity_color.T_color_depth)


def color_lens(rig: Rig) -> Intrinsics:
    """Return the lens of the proximity colour image."""
    return rig.proximity.intrinsics if rig.proximity_color is None else rig.proximity_color.intrinsics


def moved(pose: npt.ArrayLike, points_m: Float64Array) -> Float64Array:
    """Return points (N, 3) transformed by a pose (4, 4)."""
    pose = np.asarray(pose, np.float64)
    return np.asarray(points_m @ pose[:3, :3].T + pose[:3, 3])


def proximity_pixels(rig: Rig, points_m: Float64Array, in_color: BoolArray | bool) -> Float64Array:
    """Project points (N, 3) of the proximity depth frame to pixels (N, 2) of the depth or the colour image."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        of_depth = rig.proximity.intrinsics.project(points_m)
        if rig.proximity_color is None or not np.any(in_color):
            return of_depth
        of_color = color_lens(rig).project(moved(color_pose(rig), points_m))
    return np.where(np.broadcast_to(in_color, len(points_m))[:, None], of_color, of_depth)


def clicks_in_depth(rig: Rig, clicked: Float64Array, in_color: BoolArray, points_m: Float64Array) -> Float64Array:
    """Return the proximity depth pixels (N, 2) of clicks (N, 2) in the depth or the colour image.

    A click in the colour image is a point on the colour camera's ray. Its distance is that of the given point (N, 3)
    of the membrane, because the proximity depth image looks through the membrane.
    """
    depth = moved(color_pose(rig), points_m)[:, 2:]
    seen = np.column_stack([ray_seen(color_lens(rig), clicked) * depth, depth])
    points = moved(np.linalg.inv(color_pose(rig)), seen)
    return np.where(in_color[:, None], proximity_pixels(rig, points, False), clicked)


@dataclass(frozen=True, eq=False)
class Alignment:
    """Where the proximity camera sees what the tactile camera sees.

    Either by a pose ``T_p_t`` (4, 4), metres, or by the homography ``H_p_t`` (3, 3) of one plane, tactile to proximity
    depth pixels. The corrected tactile depth is scale * raw + offset.
    """

    pose: Float64Array | None = None
    homography: Float64Array | None = None
    scale: float = 1.0
    offset_m: float = 0.0

    @staticmethod
    def of_preset(section: AlignmentSection, rig: Rig) -> Alignment:
        """Return the alignment that a preset states for a rig; `RigMismatchError` where neither has a pose."""
        correction = (section.depth_scale, section.depth_offset_m)
        if section.model == "rigid":
            return Alignment(tactile_pose(section, rig), None, *correction)
        return Alignment(None, tactile_homography(section, rig), *correction)

    @staticmethod
    def of_rig(rig: Rig) -> Alignment | None:
        """Return the alignment of the rig's stated pose, or None."""
        return None if rig.T_proximity_tactile is None else Alignment(np.asarray(rig.T_proximity_tactile))

    def points_m(self, rig: Rig, places: npt.ArrayLike) -> Float64Array:
        """Return points (N, 3) in the proximity depth frame of tactile pixels with raw depths (N, 3)."""
        places = np.asarray(places, np.float64)
        depth = (self.scale * places[:, 2] + self.offset_m)[:, None]
        if self.pose is not None:
            return moved(self.pose, np.column_stack([ray_seen(rig.tactile.intrinsics, places[:, :2]) * depth, depth]))
        rays = rig.proximity.intrinsics.normalise(mapped(self.homography, places[:, :2]))
        return np.column_stack([rays * depth, depth])

    def pixels(self, rig: Rig, places: npt.ArrayLike, in_color: BoolArray | bool = False) -> Float64Array:
        """Return the proximity pixels (N, 2) of tactile pixels with raw depths (N, 3)."""
        if self.homography is not None and not np.any(in_color):  # its depth pixels need no depth
            return mapped(self.homography, np.asarray(places, np.float64)[:, :2])
        return proximity_pixels(rig, self.points_m(rig, places), in_color)

    def lookup(self, rig: Rig, depth_m: Float64Array, in_color: bool) -> Float32Array:
        """Return the proximity pixel (H, W, 2) of every tactile pixel with raw depth (H, W): what `cv2.remap` takes."""
        v, u = np.indices(depth_m.shape)
        dense = np.column_stack([u.ravel(), v.ravel(), depth_m.ravel()])
        return self.pixels(rig, dense, in_color).astype(np.float32).reshape(*depth_m.shape, 2)

    def tactile_pixels(self, rig: Rig, points_m: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Return the tactile pixels (N, 2) of points (N, 3) of the proximity frame, and their corrected depths."""
        if self.pose is not None:
            seen = moved(np.linalg.inv(self.pose), points_m)
            return rig.tactile.intrinsics.project(seen), seen[:, 2]
        assert self.homography is not None
        return mapped(np.linalg.inv(self.homography), proximity_pixels(rig, points_m, False)), points_m[:, 2]


def named_sides(x: float, y: float) -> str:
    """Return in words where an image displacement leads, such as ``"right and down"``."""
    sides = [("right" if x > 0 else "left", abs(x)), ("down" if y > 0 else "up", abs(y))]
    return " and ".join(name for name, part in sides if part > 0.4 * float(np.hypot(x, y)))


def mapped(homography: npt.ArrayLike | None, pixels: Float64Array) -> Float64Array:
    assert homography is not None
    x, y, w = np.asarray(homography, np.float64) @ np.column_stack([pixels, np.ones(len(pixels))]).T
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.column_stack([x / w, y / w])
