"""Dots seen by two cameras: the proximity camera's colour image shows them from another side."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from ..model.arrays import AnyArray, BoolArray, Float32Array, Float64Array, IndexArray
from ..model.frames import Rig, SensorFrame, rigid_transform
from ..model.intrinsics import Intrinsics
from .dot_edges import SeenSurface
from .dot_surface import smooth_depth
from .dots import Spots

#: Finds spots in an image.
Finder = Callable[[AnyArray], Spots]

#: A dot is looked for in the second image so near to where it is expected, pixels.
_SEARCH_PX: Final = 4.0
#: How well middles are found, pixels: elsewhere, and so near to a step of depth.
MIDDLE_SIGMA_PX, EDGE_SIGMA_PX = 0.07, 0.12
_EDGE_NEAR_PX: Final = 8
#: The same in the second image, whose surface at edges is known less well: there, over so many pixels, and elsewhere.
_SECOND_EDGE_SIGMA_PX, _SECOND_FADES_PX, _SECOND_SIGMA_PX = 0.5, 2.0, 0.06
#: Where the second image shows less than this share of what it shows of a pixel's surface elsewhere, it ends.
_FOLDED: Final = 0.2
#: Squared distance, in standard deviations, beyond which a spot in the second image is another one.
_GATE: Final = 9.0
#: Dots from which the second camera's pose is adjusted, and the misfit from which on they count less, pixels.
_FEWEST_FOR_POSE: Final = 30
_POSE_MISFIT_PX: Final = 0.1
#: What the second camera does not see counts as so far beside its image, pixels.
_BESIDE_PX: Final = 1e4
#: A pose adjusted by less was near enough to find all dots by it, pixels.
_POSE_SETTLED_PX: Final = 1.0


@dataclass(frozen=True, eq=False)
class PlacedDots:
    """Dots in space and how well each is known.

    Attributes
    ----------
    pixels : float64, shape (N, 2)
        In the tactile image, ``(u, v)``.
    points_m : float64, shape (N, 3)
        In the tactile camera's frame; nan where there is no depth.
    covariance_m2 : float64, shape (N, 3, 3)
    """

    pixels: Float64Array
    points_m: Float64Array
    covariance_m2: Float64Array

    @classmethod
    def of(
        cls, surface: SeenSurface, pixels: Float64Array, points_m: Float64Array, sigma_m: Float64Array
    ) -> PlacedDots:
        """Tell how well dots are known whose depths have standard deviations ``sigma_m``, shape (N,).

        A middle that is off by a pixel is off on the surface, by the more the steeper this is seen.
        """
        depth = points_m[:, 2:]
        rays = points_m / depth
        middle_sigma = np.where(_at_edge(surface, pixels), EDGE_SIGMA_PX, MIDDLE_SIGMA_PX)
        focal_px = surface.intrinsics.fx, surface.intrinsics.fy
        across = np.zeros((len(pixels), 3, 2))
        across[:, 0, 0], across[:, 1, 1] = (points_m[:, 2] / focal for focal in focal_px)
        moved = (across + rays[:, :, None] * surface.slopes(pixels)[:, None, :]) * middle_sigma[:, None, None]
        nearer = rays * sigma_m[:, None]
        return cls(pixels, points_m, moved @ moved.transpose(0, 2, 1) + nearer[:, :, None] * nearer[:, None, :])


@dataclass(frozen=True, eq=False)
class SecondCamera:
    """The camera that sees the dots, too.

    Attributes
    ----------
    intrinsics : Intrinsics
    rotation : float64, shape (3, 3)
    translation_m : float64, shape (3,)
        These take points in the tactile camera's frame to this camera's.
    """

    intrinsics: Intrinsics
    rotation: Float64Array
    translation_m: Float64Array

    @classmethod
    def of(cls, rig: Rig) -> SecondCamera | None:
        """Return the proximity colour camera; None where its pose is not known."""
        if rig.T_proximity_tactile is None:
            return None
        pose, intrinsics = np.asarray(rig.T_proximity_tactile), rig.proximity.intrinsics
        if rig.proximity_color is not None:
            pose, intrinsics = np.asarray(rig.proximity_color.T_color_depth) @ pose, rig.proximity_color.intrinsics
        return cls(intrinsics, pose[:3, :3], pose[:3, 3])

    def sees(self, points_m: Float64Array) -> Float64Array:
        """Return the pixels, (N, 2), of points in the tactile frame, (N, 3)."""
        return self.intrinsics.project(points_m @ self.rotation.T + self.translation_m)

    def slopes(self, points_m: Float64Array) -> Float64Array:
        """Return how pixels move with points, (N, 2, 3), lens distortion left aside."""
        x, y, z = (points_m @ self.rotation.T + self.translation_m).T
        fx, fy, zero = self.intrinsics.fx, self.intrinsics.fy, np.zeros(len(x))
        pinhole = np.array([[fx / z, zero, -fx * x / z**2], [zero, fy / z, -fy * y / z**2]])
        return np.asarray(pinhole.transpose(2, 0, 1) @ self.rotation)

    def turned(self, change: Float64Array) -> SecondCamera:
        """Return it after a small rotation, radians, and movement, metres, together of shape (6,)."""
        rotation = Rotation.from_rotvec(change[:3]).as_matrix() @ self.rotation
        return SecondCamera(self.intrinsics, rotation, self.translation_m + change[3:])


@dataclass(frozen=True, eq=False)
class SecondView:
    """The dots as the second camera sees them.

    Attributes
    ----------
    camera : SecondCamera
        In the pose that fits the dots best.
    numbers : intp, shape (M,)
        Of the dots that it sees.
    seen : float64, shape (M, 2)
        Their middles in its image.
    sigma_px : float64, shape (M,)
        Standard deviation of these.
    """

    camera: SecondCamera
    numbers: IndexArray
    seen: Float64Array
    sigma_px: Float64Array

    @classmethod
    def of(
        cls, dots: PlacedDots, frame: SensorFrame, rig: Rig, surface: SeenSurface, find: Finder
    ) -> SecondView | None:
        """Find the dots in the proximity camera's colour image, and the pose from which it shows them.

        The image is brought to the pixels of the tactile one by the tactile depth, so that the same surface is
        unrolled in both. Without a pose, or where too few dots are seen to adjust it, there is None: a pose that is
        off by little moves all dots, and one that is off by more finds none.

        Parameters
        ----------
        dots : PlacedDots
        frame : SensorFrame
        rig : Rig
        surface : SeenSurface
            The tactile one.
        find : callable
            Finds spots in an image of that surface.
        """
        camera = SecondCamera.of(rig)
        if camera is None:
            return None
        rows, columns = np.indices(surface.depth_m.shape)
        depth = smooth_depth(surface.depth_m).ravel()
        rays = rig.tactile.intrinsics.normalise(np.column_stack([columns.ravel(), rows.ravel()]).astype(np.float64))
        points = np.column_stack([rays * depth[:, None], depth])
        for _ in range(2):  # again where the pose was so far off that dots were missed
            where = np.clip(np.nan_to_num(camera.sees(points), nan=-_BESIDE_PX), -_BESIDE_PX, _BESIDE_PX)
            where_px = where.reshape(*rows.shape, 2).astype(np.float32)
            spots = find(_sampled(frame.proximity_color, where_px))
            numbers, matches = _matches(dots, spots.pixels)
            if len(numbers) == 0:
                return None
            seen = _sampled(where_px, spots.pixels[matches].astype(np.float32)[None])[0].astype(np.float64)
            at = tuple(np.rint(spots.pixels[matches][:, ::-1]).astype(np.intp).T)
            edges = _folds(where_px) | surface.near_step(0)
            away_px = cv2.distanceTransform((~edges).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[at]
            plain = away_px > _EDGE_NEAR_PX
            if np.count_nonzero(plain) < _FEWEST_FOR_POSE:
                return None
            known = dots.points_m[numbers][plain]
            former, camera = camera, _adjusted(camera, known, seen[plain])
            if np.abs(camera.sees(known) - former.sees(known)).max(initial=0.0) < _POSE_SETTLED_PX:
                break
        return cls(
            camera, numbers, seen, _SECOND_SIGMA_PX + _SECOND_EDGE_SIGMA_PX * np.exp(-away_px / _SECOND_FADES_PX)
        )

    def rig(self, rig: Rig) -> Rig:
        """Return the rig with the pose of the tactile camera that this one's implies."""
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = self.camera.rotation, self.camera.translation_m
        if rig.proximity_color is not None:
            pose = np.linalg.inv(np.asarray(rig.proximity_color.T_color_depth)) @ pose
        return rig.model_copy(update={"T_proximity_tactile": rigid_transform(pose)})

    def sharpen(self, dots: PlacedDots) -> PlacedDots:
        """Move each dot to where both middles and its depth agree: one step of a Kalman filter.

        Dots are left where the second image shows something else before them.
        """
        return _updated(dots, self.numbers, self.camera, self.seen, self.sigma_px)


def _sampled(image: AnyArray, where: Float32Array) -> AnyArray:
    """Return an image, (H, W, C), between its pixels at ``where``, (h, w, 2); black beside it."""
    return np.asarray(cv2.remap(image, where[..., 0], where[..., 1], cv2.INTER_LINEAR))


def _folds(where: Float32Array) -> BoolArray:
    """Tell the pixels whose surface the second camera, which sees them at ``where``, sees edge-on or not at all."""
    right, down = np.diff(where, axis=1)[:-1], np.diff(where, axis=0)[:, :-1]
    seen = right[..., 0] * down[..., 1] - right[..., 1] * down[..., 0]
    folded = np.zeros(where.shape[:2], bool)
    folded[:-1, :-1] = seen < _FOLDED * np.median(seen)
    return folded


def _at_edge(surface: SeenSurface, pixels: Float64Array) -> BoolArray:
    height, width = surface.depth_m.shape
    u, v = np.rint(pixels).astype(np.intp).T
    return np.asarray(surface.near_step(_EDGE_NEAR_PX)[v.clip(0, height - 1), u.clip(0, width - 1)])


def _matches(dots: PlacedDots, pixels: Float64Array) -> tuple[IndexArray, IndexArray]:
    """Return the numbers of dots and of spots that are each other's nearest."""
    if len(pixels) == 0:
        return np.empty(0, np.intp), np.empty(0, np.intp)
    distance, spot = map(np.asarray, cKDTree(pixels).query(dots.pixels))
    dot = np.asarray(cKDTree(dots.pixels).query(pixels)[1])
    mutual = dot[spot] == np.arange(len(dots.pixels))
    numbers = np.flatnonzero((distance < _SEARCH_PX) & mutual & np.isfinite(dots.points_m).all(axis=1))
    return numbers, spot[numbers]


def _adjusted(camera: SecondCamera, points_m: Float64Array, seen: Float64Array) -> SecondCamera:
    """Return the camera in the pose in which most dots lie where it sees them."""

    def misfit(change: Float64Array) -> Float64Array:
        return np.asarray((camera.turned(change).sees(points_m) - seen).ravel())

    fit = least_squares(misfit, np.zeros(6), loss="soft_l1", f_scale=_POSE_MISFIT_PX, x_scale="jac")
    return camera.turned(fit.x)


def _updated(
    dots: PlacedDots, numbers: IndexArray, camera: SecondCamera, seen: Float64Array, sigma_px: Float64Array
) -> PlacedDots:
    """Return the dots after the second camera has seen some of them: one step of a Kalman filter each."""
    points, covariance = dots.points_m[numbers], dots.covariance_m2[numbers]
    slopes = camera.slopes(points)
    off = seen - camera.sees(points)
    spread = slopes @ covariance @ slopes.transpose(0, 2, 1) + sigma_px[:, None, None] ** 2 * np.eye(2)
    inverse = np.linalg.inv(spread)
    agrees = np.einsum("ni,nij,nj->n", off, inverse, off) < _GATE
    gain = covariance @ slopes.transpose(0, 2, 1) @ inverse
    moved = points + (gain @ off[:, :, None])[:, :, 0]
    known = covariance - gain @ slopes @ covariance
    all_points, all_covariance = dots.points_m.copy(), dots.covariance_m2.copy()
    all_points[numbers[agrees]] = moved[agrees]
    all_covariance[numbers[agrees]] = known[agrees]
    return PlacedDots(dots.pixels, all_points, all_covariance)
