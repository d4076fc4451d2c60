"""Correspondences without clicking: the dye droplets on the membrane, matched between both colour images.

SIFT descriptors give a rough initial set, unless the rig has a pose. Then the proximity colour image is warped into the
tactile view through the tactile depth and the current pose, so that a droplet has the same size and almost the same
place in both images. The remaining offset is measured patch by patch (inverse-compositional Lucas-Kanade, sub-pixel).
The pose is fitted to the result, and warping and matching are repeated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import map_coordinates

from ..errors import CalibrationError
from ..model.arrays import BoolArray, Float32Array, Float64Array, IndexArray, Uint8Array
from ..model.clouds import valid_depth
from ..model.frames import Rig, SensorFrame
from .correspondences import Correspondence
from .detect import to_gray
from .rigid import Pose, RigidFit, RigidPoints, color_lens, fit_rigid, to_color
from .snapshots import depth_under

_ROUNDS = 3
_PATCH_PX = 15
_REACH_PX = 12.0
_MIN_CORRELATION = 0.85
_MAX_FEATURES = 400
_MIN_DISTANCE_PX = 12.0
_MIN_PAIRS = 12
_RATIO = 0.8
#: Standard deviation of a matched droplet, pixels.
_MATCH_SIGMA_PX = 0.15
#: Images of different scenes agree by chance within `_REACH_PX`; a lens without its distortion agrees to this, pixels.
_MAX_RMS_PX = 4.0


@dataclass(frozen=True, eq=False)
class TextureMatches:
    """Proposed correspondences, best first, and their fit.

    Attributes
    ----------
    pairs : tuple of Correspondence
        In the colour image, with tactile depth and snapshot number.
    likeness : float64, shape (N,)
        Correlation of both patches, at most 1.
    fit : RigidFit
        Fit of all proposed correspondences.
    """

    pairs: tuple[Correspondence, ...]
    likeness: Float64Array
    fit: RigidFit


def match_texture(frames: Sequence[SensorFrame], rig: Rig) -> TextureMatches:
    """Propose correspondences from the texture of both colour images, over all frames.

    Parameters
    ----------
    frames : sequence of SensorFrame
        One per inflation level, preferably snapshots.
    rig : Rig
        Its ``T_proximity_tactile`` is the initial pose; without it, descriptors give one.

    Raises
    ------
    CalibrationError
        A frame has no tactile colour image, or too few correspondences agree.
    """
    if not frames:
        raise CalibrationError("texture matching needs at least one frame")
    for frame in frames:
        frame.check_against(rig)
        if frame.tactile_color is None:
            raise CalibrationError(
                f"frame {frame.sequence} has no tactile colour image, so there is no texture to match; "
                "detect a target or click the points"
            )
    stated = rig.T_proximity_tactile
    views = [_View(number, frame, rig) for number, frame in enumerate(frames)]
    start = Pose.of(stated) if stated is not None else _fit(_described(views), rig).pose
    found = _guided(views, rig, start)
    if len(found.points.tactile) < _MIN_PAIRS and stated is not None:
        start = _fit(_described(views), rig).pose
        found = _guided(views, rig, start)
    for _ in range(_ROUNDS - 1):
        found = _guided(views, rig, _fit(found, rig).pose)
    fit = _fit(found, rig)
    if fit.rms_px > _MAX_RMS_PX:
        raise CalibrationError(
            f"the {len(found.points.tactile)} places that look alike in both colour images agree only to "
            f"{fit.rms_px:.1f} px, right ones agree to {_MAX_RMS_PX:g} px; check that both images show the same "
            "scene, or click the points"
        )
    return _proposed(found, fit, rig)


@dataclass(frozen=True, eq=False)
class _Found:
    """Correspondences with their view and the correlation of both patches."""

    points: RigidPoints
    view: IndexArray
    likeness: Float64Array


class _View:
    """One frame prepared for matching: grey images, features with depth, and dense depth for warping."""

    def __init__(self, number: int, frame: SensorFrame, rig: Rig, places: Float64Array | None = None) -> None:
        assert frame.tactile_color is not None
        self.number = number
        self.tactile = _textured(frame.tactile_color)
        self.proximity = _textured(frame.proximity_color)
        valid = valid_depth(frame.tactile_depth)
        self.depth_m = _filled(frame.tactile_depth.astype(np.float64) * rig.tactile.depth_unit_m, valid)
        self._counts, self._unit = frame.tactile_depth, rig.tactile.depth_unit_m
        if places is None:
            corners = cv2.goodFeaturesToTrack(
                self.tactile, _MAX_FEATURES, 0.02, _MIN_DISTANCE_PX, mask=_inner(valid), blockSize=_PATCH_PX
            )
            places = np.zeros((0, 2)) if corners is None else corners.reshape(-1, 2).astype(np.float64)
        depth = self.depths_under(places)
        self.features = np.column_stack([places, depth])[np.isfinite(depth)]

    def depths_under(self, places: Float64Array) -> Float64Array:
        """Return depths at tactile pixels (N, 2), nan without depth."""
        found = [depth_under(self._counts, self._unit, u, v, radius=3) for u, v in places]
        return np.array([np.nan if depth is None else depth for depth in found], dtype=np.float64)


def measure_pairs(frame: SensorFrame, rig: Rig, pose: Pose, places: Float64Array | None = None) -> RigidPoints:
    """Locate places of the tactile image in the proximity colour image.

    Parameters
    ----------
    frame : SensorFrame
        With a tactile colour image.
    rig : Rig
    pose : Pose
        Correct to about 10 pixels.
    places : float64, shape (N, 2), optional
        Tactile pixels; default: all places with texture.

    Returns
    -------
    RigidPoints
        Places with depth that were found in the colour image.
    """
    return _guided_view(_View(0, frame, rig, places), rig, pose).points


def _guided(views: list[_View], rig: Rig, pose: Pose) -> _Found:
    """Warp each view, measure the remaining offset of each feature, and keep those with high correlation."""
    return _joined([_guided_view(view, rig, pose) for view in views])


def _guided_view(view: _View, rig: Rig, pose: Pose) -> _Found:
    height, width = rig.tactile.intrinsics.shape
    v, u = np.mgrid[:height, :width].astype(np.float64)
    dense = np.column_stack([u.ravel(), v.ravel(), view.depth_m.ravel()])
    lookup = _color_pixels(dense, rig, pose).astype(np.float32).reshape(height, width, 2)
    warped: Uint8Array = np.asarray(
        cv2.remap(view.proximity, lookup[..., 0], lookup[..., 1], cv2.INTER_CUBIC), np.uint8
    )
    start = view.features[:, :2].astype(np.float32).reshape(-1, 1, 2)
    if len(start) == 0:
        return _joined([])
    there, ahead = _tracked(view.tactile, warped, start)
    back, behind = _tracked(warped, view.tactile, there)
    moved = there.reshape(-1, 2).astype(np.float64)
    kept = ahead & behind
    kept &= np.hypot(*(back - start).reshape(-1, 2).T) < 0.3
    kept &= np.hypot(*(moved - view.features[:, :2]).T) < _REACH_PX
    kept &= ((moved >= _PATCH_PX) & (moved < (width - _PATCH_PX, height - _PATCH_PX))).all(axis=1)
    likeness = np.array(
        [
            _likeness(view.tactile, warped, here, place) if good else 0.0
            for here, place, good in zip(view.features[:, :2], moved, kept, strict=True)
        ]
    )
    kept &= likeness >= _MIN_CORRELATION
    features, moved, likeness = view.features[kept], moved[kept], likeness[kept]
    places = moved[:, ::-1].T
    proximity = np.column_stack([map_coordinates(lookup[..., axis], places, order=1) for axis in range(2)])
    return _Found(_color_points(features, proximity.astype(np.float64)), np.full(len(features), view.number), likeness)


def _tracked(source: Uint8Array, target: Uint8Array, start: Float32Array) -> tuple[Float32Array, BoolArray]:
    """Track places (N, 1, 2) from one image to the other; also return which were found."""
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 40, 0.001)
    places, found, _ = cv2.calcOpticalFlowPyrLK(
        source, target, start, np.empty_like(start), winSize=(_PATCH_PX, _PATCH_PX), maxLevel=2, criteria=criteria
    )
    return np.asarray(places, np.float32), np.asarray(found).ravel() == 1


def _color_pixels(places: Float64Array, rig: Rig, pose: Pose) -> Float64Array:
    """Map tactile places (N, 3) to proximity colour pixels (N, 2) by a pose."""
    return color_lens(rig).project(to_color(rig, pose.points_m(rig.tactile.intrinsics, places)))


def _described(views: list[_View]) -> _Found:
    """Match SIFT descriptors with the ratio test and the mutual nearest neighbour."""
    sift = cv2.SIFT.create(nfeatures=2000)
    parts = []
    for view in views:
        tactile, proximity = (sift.detectAndCompute(image, None) for image in (view.tactile, view.proximity))
        if tactile[1] is None or proximity[1] is None or min(len(tactile[0]), len(proximity[0])) < 2:
            continue
        matcher = cv2.BFMatcher()
        forward = matcher.knnMatch(tactile[1], proximity[1], k=2)
        backward = {match.queryIdx: match.trainIdx for match in matcher.match(proximity[1], tactile[1])}
        best = [
            first
            for first, second in forward
            if first.distance < _RATIO * second.distance and backward.get(first.trainIdx) == first.queryIdx
        ]
        here = np.array([tactile[0][match.queryIdx].pt for match in best]).reshape(-1, 2)
        there = np.array([proximity[0][match.trainIdx].pt for match in best]).reshape(-1, 2)
        depth = view.depths_under(here)
        known = np.isfinite(depth)
        places = np.column_stack([here, depth])[known]
        parts.append(
            _Found(_color_points(places, there[known]), np.full(len(places), view.number), np.ones(len(places)))
        )
    return _joined(parts)


def _fit(found: _Found, rig: Rig) -> RigidFit:
    if len(found.points.tactile) < _MIN_PAIRS:
        raise CalibrationError(
            f"only {len(found.points.tactile)} places look alike in both colour images, {_MIN_PAIRS} are needed; "
            "light the membrane evenly, average more frames, or click the points"
        )
    return fit_rigid(found.points, rig, click_sigma_px=_MATCH_SIGMA_PX)


def _proposed(found: _Found, fit: RigidFit, rig: Rig) -> TextureMatches:
    points = found.points
    order = np.flatnonzero(fit.used)[np.argsort(-found.likeness[fit.used], kind="stable")]
    pairs = tuple(
        Correspondence(
            id=f"t{rank + 1}",
            proximity_u=float(points.proximity[i, 0]),
            proximity_v=float(points.proximity[i, 1]),
            tactile_u=float(points.tactile[i, 0]),
            tactile_v=float(points.tactile[i, 1]),
            tactile_depth_m=float(points.tactile_depth_m[i]),
            proximity_image="depth" if rig.proximity_color is None else "color",
            snapshot=int(found.view[i]),
        )
        for rank, i in enumerate(order)
    )
    return TextureMatches(pairs, found.likeness[order], fit)


def _color_points(places: Float64Array, proximity: Float64Array) -> RigidPoints:
    count = len(places)
    return RigidPoints(places[:, :2], places[:, 2], proximity, np.ones(count, bool), np.full(count, np.nan))


def _joined(parts: list[_Found]) -> _Found:
    if not parts:
        return _Found(_color_points(np.zeros((0, 3)), np.zeros((0, 2))), np.zeros(0, np.intp), np.zeros(0))
    return _Found(
        RigidPoints.joined([part.points for part in parts]),
        np.concatenate([part.view for part in parts]),
        np.concatenate([part.likeness for part in parts]),
    )


def _likeness(first: Uint8Array, second: Uint8Array, here: Float64Array, there: Float64Array) -> float:
    size = (_PATCH_PX, _PATCH_PX)
    a = cv2.getRectSubPix(first, size, (float(here[0]), float(here[1])))
    b = cv2.getRectSubPix(second, size, (float(there[0]), float(there[1])))
    return float(cv2.matchTemplate(a, b, cv2.TM_CCOEFF_NORMED)[0, 0])


def _textured(image: Uint8Array) -> Uint8Array:
    """Return a grey image with equalised local contrast, so that both exposures are comparable."""
    return np.asarray(cv2.createCLAHE(clipLimit=2.0, tileGridSize=(8, 8)).apply(to_gray(image)))


def _inner(valid: BoolArray) -> Uint8Array:
    """Return the mask of pixels whose whole patch has depth, small holes ignored."""
    closed = cv2.morphologyEx(valid.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((7, 7), np.uint8))
    return np.asarray(cv2.erode(closed, np.ones((_PATCH_PX, _PATCH_PX), np.uint8)))


def _filled(depth_m: Float64Array, valid: BoolArray) -> Float64Array:
    """Smooth the depth and fill holes by normalised convolution."""
    weight = cv2.GaussianBlur(valid.astype(np.float64), (0, 0), 2.5)
    smooth = cv2.GaussianBlur(np.where(valid, depth_m, 0.0), (0, 0), 2.5)
    usual = float(np.median(depth_m[valid])) if valid.any() else 0.3
    return np.asarray(np.where(weight > 0.05, smooth / np.maximum(weight, 0.05), usual))
