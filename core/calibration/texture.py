"""Pairs without clicking: the dye droplets on the membrane, matched between both colour images.

SIFT descriptors give a rough initial set, unless the rig has a pose. Then the proximity colour image is warped into the
tactile view through the tactile depth and the current pose, so that a droplet has the same size and almost the same
place in both images. The remaining offset is measured patch by patch (pyramidal Lucas-Kanade, sub-pixel). The pose is
fitted to the result, and warping and matching are repeated.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import cv2
import numpy as np

from ..errors import CalibrationError
from ..model.alignment import PointPair
from ..model.arrays import BoolArray, Float32Array, Float64Array, Uint8Array
from ..model.clouds import valid_depth
from ..model.frames import Rig, SensorFrame
from .detect import to_gray
from .geometry import Alignment
from .points import PointArrays
from .robust_fit import Fit, fit_rigid
from .snapshots import depth_under

_ROUNDS = 3
_PATCH_PX = 15
_REACH_PX = 12.0
#: A place that is tracked there and back ends this near to itself, pixels.
_RETURN_PX = 0.3
_MIN_CORRELATION = 0.85
_MAX_FEATURES = 400
_MIN_DISTANCE_PX = 12.0
_MIN_PAIRS = 12
_RATIO = 0.8
#: Standard deviation of a matched droplet, pixels.
_MATCH_SIGMA_PX = 0.15
#: Images of different scenes agree by chance within `_REACH_PX`; a lens without its distortion agrees to this, pixels.
_MAX_RMS_PX = 4.0


def match_texture(frames: Sequence[SensorFrame], rig: Rig) -> tuple[list[PointPair], float]:
    """Propose pairs, the best first, from texture of frames at several inflations, and their RMS residual."""
    for frame in frames:
        frame.check_against(rig)
        if frame.tactile_color is None:
            raise CalibrationError(f"frame {frame.sequence} has no tactile colour image to match; click the points")
    views = [_View(number, frame, rig) for number, frame in enumerate(frames)]
    stated = Alignment.of_rig(rig)
    found = _guided(views, rig, stated) if stated is not None else _NOTHING
    if len(found) < _MIN_PAIRS:
        found = _guided(views, rig, _fit(_described(views), rig).alignment)
    for _ in range(_ROUNDS - 1):
        found = _guided(views, rig, _fit(found, rig).alignment)
    fit = _fit(found, rig)
    if fit.rms_px > _MAX_RMS_PX:
        raise CalibrationError(
            f"places that look alike agree only to {fit.rms_px:.1f} px, right ones to {_MAX_RMS_PX:g} px; "
            "check that both images show the same scene, or click the points"
        )
    kept = found[fit.inliers]
    best_first = kept[np.argsort(-kept[:, 6], kind="stable")].tolist()
    image: Literal["depth", "color"] = "depth" if rig.proximity_color is None else "color"
    pairs = [
        PointPair(
            **dict(zip(_PLACES, places, strict=True)),
            id=f"t{rank}",
            proximity_image=image,
            snapshot=int(view),
            origin=f"texture, correlation {likeness:.2f}",
        )
        for rank, (*places, view, likeness) in enumerate(best_first, 1)
    ]
    return pairs, fit.rms_px


#: Pairs in rows: tactile pixel and depth, proximity pixel, number of the view, correlation of both patches.
_NOTHING = np.zeros((0, 7))
_PLACES = ("tactile_u", "tactile_v", "tactile_depth_m", "proximity_u", "proximity_v")


class _View:
    """One frame prepared for matching: grey images, features with depth, and dense depth for warping."""

    def __init__(self, number: int, frame: SensorFrame, rig: Rig) -> None:
        assert frame.tactile_color is not None
        self.number = number
        self.tactile = _textured(frame.tactile_color)
        self.proximity = _textured(frame.proximity_color)
        valid = valid_depth(frame.tactile_depth)
        self.depth_m = _filled(frame.tactile_depth.astype(np.float64) * rig.tactile.depth_unit_m, valid)
        self._counts, self._unit = frame.tactile_depth, rig.tactile.depth_unit_m
        # pixels whose whole patch has depth, small holes ignored
        closed = cv2.morphologyEx(valid.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((7, 7), np.uint8))
        inner = cv2.erode(closed, np.ones((_PATCH_PX, _PATCH_PX), np.uint8))
        corners = cv2.goodFeaturesToTrack(
            self.tactile, _MAX_FEATURES, 0.02, _MIN_DISTANCE_PX, mask=inner, blockSize=_PATCH_PX
        )
        self.features = self.with_depth(np.zeros((0, 2)) if corners is None else np.float64(corners).reshape(-1, 2))

    def with_depth(self, places: Float64Array) -> Float64Array:
        """Return tactile pixels (N, 2) with their depths (N, 3), nan without depth."""
        found = [depth_under(self._counts, self._unit, u, v, radius=3) for u, v in places]
        return np.column_stack([places, np.array(found, dtype=np.float64)])


def measure_pairs(frame: SensorFrame, rig: Rig, alignment: Alignment) -> PointArrays:
    """Locate places of the tactile image in the proximity colour image; the alignment must be right to about 10 px."""
    return _points(_guided([_View(0, frame, rig)], rig, alignment))


def _guided(views: list[_View], rig: Rig, alignment: Alignment) -> Float64Array:
    """Warp each view, measure the remaining offset of each feature, and keep those with high correlation."""
    from scipy.ndimage import map_coordinates  # slow to import

    height, width = rig.tactile.intrinsics.shape
    parts = [_NOTHING]
    for view in views:
        features = view.features[np.isfinite(view.features[:, 2])]
        if not len(features):
            continue
        lookup = alignment.lookup(rig, view.depth_m, in_color=True)
        warped: Uint8Array = np.asarray(
            cv2.remap(view.proximity, lookup[..., 0], lookup[..., 1], cv2.INTER_CUBIC), np.uint8
        )
        start = features[:, :2].astype(np.float32)
        moved, kept = tracked(view.tactile, warped, start, levels=2)
        kept &= np.hypot(*(moved - features[:, :2]).T) < _REACH_PX
        kept &= ((moved >= _PATCH_PX) & (moved < (width - _PATCH_PX, height - _PATCH_PX))).all(axis=1)
        likeness = np.zeros(len(features))
        for i in np.flatnonzero(kept):
            likeness[i] = _likeness(view.tactile, warped, features[i, :2], moved[i])
        kept &= likeness >= _MIN_CORRELATION
        at = moved[kept, ::-1].T
        proximity = np.column_stack([map_coordinates(lookup[..., axis], at, order=1) for axis in range(2)])
        parts.append(_rows(features[kept], proximity.astype(np.float64), view, likeness[kept]))
    return np.concatenate(parts)


def tracked(first: Uint8Array, second: Uint8Array, places: Float32Array, levels: int) -> tuple[Float64Array, BoolArray]:
    """Return where places (N, 2) of one image are in the other, by pyramidal Lucas-Kanade, and which lead back."""
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 40, 0.001)
    options: dict[str, Any] = {"winSize": (_PATCH_PX, _PATCH_PX), "maxLevel": levels, "criteria": criteria}
    start = places.reshape(-1, 1, 2)
    there, ahead, _ = cv2.calcOpticalFlowPyrLK(first, second, start, np.empty_like(start), **options)
    back, behind, _ = cv2.calcOpticalFlowPyrLK(second, first, there, np.empty_like(start), **options)
    returned = np.hypot(*(back - start).reshape(-1, 2).T) < _RETURN_PX
    found = (np.asarray(ahead) & np.asarray(behind)).ravel().astype(bool)
    return there.reshape(-1, 2).astype(np.float64), found & returned


def _described(views: list[_View]) -> Float64Array:
    """Match SIFT descriptors with the ratio test and the mutual nearest neighbour."""
    sift, matcher = cv2.SIFT.create(nfeatures=2000), cv2.BFMatcher()
    parts = [_NOTHING]
    for view in views:
        tactile, proximity = (sift.detectAndCompute(image, None) for image in (view.tactile, view.proximity))
        if tactile[1] is None or proximity[1] is None or min(len(tactile[0]), len(proximity[0])) < 2:
            continue
        backward = {match.queryIdx: match.trainIdx for match in matcher.match(proximity[1], tactile[1])}
        best = [
            first
            for first, second in matcher.knnMatch(tactile[1], proximity[1], k=2)
            if first.distance < _RATIO * second.distance and backward.get(first.trainIdx) == first.queryIdx
        ]
        here = view.with_depth(np.array([tactile[0][match.queryIdx].pt for match in best]).reshape(-1, 2))
        there = np.array([proximity[0][match.trainIdx].pt for match in best]).reshape(-1, 2)
        known = np.isfinite(here[:, 2])
        parts.append(_rows(here[known], there[known], view, np.ones(int(known.sum()))))
    return np.concatenate(parts)


def _fit(found: Float64Array, rig: Rig) -> Fit:
    if len(found) < _MIN_PAIRS:
        raise CalibrationError(
            f"only {len(found)} places look alike, {_MIN_PAIRS} are needed; light the membrane evenly, or click points"
        )
    return fit_rigid(_points(found), rig, sigma_px=_MATCH_SIGMA_PX)


def _rows(places: Float64Array, proximity: Float64Array, view: _View, likeness: Float64Array) -> Float64Array:
    return np.column_stack([places, proximity, np.full(len(places), view.number), likeness])


def _points(found: Float64Array) -> PointArrays:
    return PointArrays(found[:, :2], found[:, 2], found[:, 3:5], np.ones(len(found), bool))


def _likeness(first: Uint8Array, second: Uint8Array, here: Float64Array, there: Float64Array) -> float:
    size = (_PATCH_PX, _PATCH_PX)
    a = cv2.getRectSubPix(first, size, (float(here[0]), float(here[1])))
    b = cv2.getRectSubPix(second, size, (float(there[0]), float(there[1])))
    return float(cv2.matchTemplate(a, b, cv2.TM_CCOEFF_NORMED)[0, 0])


def _textured(image: Uint8Array) -> Uint8Array:
    """Return a grey image with equalised local contrast, so that both exposures are comparable."""
    return np.asarray(cv2.createCLAHE(clipLimit=2.0, tileGridSize=(8, 8)).apply(to_gray(image)))


def _filled(depth_m: Float64Array, valid: BoolArray) -> Float64Array:
    """Smooth the depth and fill holes by normalised convolution."""
    weight = cv2.GaussianBlur(valid.astype(np.float64), (0, 0), 2.5)
    smooth = cv2.GaussianBlur(np.where(valid, depth_m, 0.0), (0, 0), 2.5)
    usual = float(np.median(depth_m[valid])) if valid.any() else 0.3
    return np.asarray(np.where(weight > 0.05, smooth / np.maximum(weight, 0.05), usual))
