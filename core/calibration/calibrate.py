"""The calibration: both models are fitted to the same pairs and cross-validated; one is recommended."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from ..errors import CalibrationError
from ..model.alignment import PointPair
from ..model.arrays import Float64Array
from ..model.frames import Rig
from ..preset import now
from .agreement import judge_agreement
from .geometry import Alignment, clicks_in_depth
from .points import PointArrays
from .report import (
    CalibrationReport,
    DepthOffset,
    ModelName,
    ModelQuality,
    PairQuality,
    bound,
    membrane_places,
    millimetres_per_pixel,
    patch_effect,
    seen_places,
)
from .robust_fit import Fit, fit_homography, fit_rigid

ModelChoice = Literal["auto", "homography", "rigid"]

#: Distance assumed for colour clicks without depth and pose, metres.
_PLANE_M = 0.30
#: A rigid fit this much worse than a homography under cross-validation indicates wrong depths or lenses.
_MUCH_WORSE = 1.25
#: A fit farther from the rig's stated pose than this causes a warning: metres, degrees.
_STATED_POSE_M, _STATED_POSE_DEG = 0.010, 4.0
#: Standard deviations from which an offset of the depth counts: neighbouring pairs share errors of the depth, which
#: the standard deviation does not contain. One frame of the simulator gives up to 6 where there is none.
_MIN_CERTAINTY = 10.0
#: A larger offset is a wrong depth unit, which no preset corrects, metres.
_MAX_OFFSET_M = 0.1
#: Fewer pairs determine no offset.
_MIN_OFFSET_PAIRS = 12


def calibrate(
    pairs: Sequence[PointPair],
    rig: Rig,
    model: ModelChoice = "auto",
    *,
    membrane: npt.ArrayLike | None = None,
) -> CalibrationReport:
    """Fit the alignment of both cameras to clicked pairs of points and report its quality.

    Both models are fitted if possible: the rigid pose of the tactile camera in the proximity depth frame, which holds
    at every depth, and the homography of one plane. Wrong pairs are rejected and named. An offset of the tactile depth
    is corrected if it is at least ten times its standard deviation.

    Parameters
    ----------
    pairs : sequence of PointPair
        At least 4, better 12 at several inflation levels, as `read_points` returns them. Disabled and pending ones are
        kept in the report but not used. A rigid fit needs their tactile depth.
    rig : Rig
        Lenses of both cameras. Its stated pose is only compared with the fitted one.
    model : {"auto", "homography", "rigid"}
        The model to use; ``"auto"`` takes the better one.
    membrane : array_like, shape (M, 3), optional
        Places (tactile u, v in pixels, raw depth in metres) over which the alignment is judged. Default: a grid over
        the tactile image at the depths of the points.

    Returns
    -------
    CalibrationReport
        ``verdict`` states the expected errors and the next step; ``apply_to`` puts the alignment into a preset.

    Raises
    ------
    CalibrationError
        The pairs do not determine the requested model (with ``"auto"``: no model), or contradict it; or the rig has one
        camera.
    """
    if not rig.has_proximity:
        raise CalibrationError("this rig has a tactile camera only, so there is no alignment to calibrate")
    used = [pair for pair in pairs if pair.enabled and pair.complete]
    _refuse_repeated(used)
    points = PointArrays.of(used)
    ids = [pair.id for pair in used]
    rigid, offset, refused_rigid = _try_rigid(points, ids, rig)
    clicked = _in_depth_image(points, rig, rigid)
    homography, refused_homography = _try_homography(clicked, ids, rig, rigid)
    refused: dict[ModelName, str] = {"homography": refused_homography, "rigid": refused_rigid}
    if model != "auto" and refused[model]:
        raise CalibrationError(refused[model])
    if homography is None and rigid is None:
        raise CalibrationError(
            refused_rigid
            if refused_homography == refused_rigid
            else f"no homography: {refused_homography}; no rigid: {refused_rigid}"
        )
    places = membrane_places(points.tactile, points.tactile_depth_m, rig) if membrane is None else np.asarray(membrane)
    fits: dict[ModelName, Fit | None] = {"homography": homography, "rigid": rigid}
    quality = {name: _quality(name, fit, places, rigid) for name, fit in fits.items() if fit is not None}
    known_m = points.tactile_depth_m[np.isfinite(points.tactile_depth_m)]
    recommended, reason = _recommend(quality, refused)
    return CalibrationReport(
        model=recommended if model == "auto" else model,
        recommended=recommended,
        reason=reason,
        quality=quality,
        refused={name: text for name, text in refused.items() if text},
        depth_span_mm=1e3 * float(np.ptp(known_m)) if len(known_m) else 0.0,
        depth_offset=offset,
        warnings=_warnings(used, rigid, rig),
        pairs=tuple(pair for pair in pairs if pair.complete),
        rig=rig,
        date=now(),
    )


def _refuse_repeated(pairs: list[PointPair]) -> None:
    seen: dict[object, str] = {}
    ids: set[str] = set()
    for pair in pairs:
        if pair.id in ids:  # the report names pairs by it
            raise CalibrationError(f"two pairs have the id {pair.id}; give each pair its own")
        place = (pair.proximity, pair.proximity_image, pair.tactile)
        if place in seen:
            raise CalibrationError(f"pairs {seen[place]} and {pair.id} are the same points; delete one of them")
        seen[place] = pair.id
        ids.add(pair.id)


def _try_rigid(points: PointArrays, ids: list[str], rig: Rig) -> tuple[Fit | None, DepthOffset | None, str]:
    """Return the rigid fit, the offset that the pairs show, and why there is no fit."""
    known = np.isfinite(points.tactile_depth_m)
    if known.sum() < 4 <= len(points):
        reason = (
            f"only {known.sum()} of the {len(points)} pairs have a tactile depth, a rigid alignment needs 4; "
            "click where the tactile camera sees depth"
        )
        return None, None, reason
    points, names = points.keep(known), [name for name, has in zip(ids, known, strict=True) if has]
    offset: DepthOffset | None = None
    if len(points) >= _MIN_OFFSET_PAIRS:
        with suppress(CalibrationError):
            shifted = fit_rigid(points, rig, offset=True, names=names)
            size, sigma = shifted.alignment.offset_m, float(np.sqrt(shifted.covariance[6, 6]))
            offset = DepthOffset(size, sigma, used=_MIN_CERTAINTY * sigma <= abs(size) <= _MAX_OFFSET_M)
            if offset.used:
                return shifted, offset, ""
    try:
        return fit_rigid(points, rig, names=names), offset, ""
    except CalibrationError as error:
        return None, None, str(error)


def _in_depth_image(points: PointArrays, rig: Rig, rigid: Fit | None) -> PointArrays:
    """Return the points with their proximity pixels in the *depth* image.

    A click in the colour image is a ray to the membrane. Its length follows from the tactile depth and the fitted pose,
    or the rig's stated pose.
    """
    in_depth = np.zeros(len(points), bool)
    if not points.in_color.any() or rig.proximity_color is None:
        return replace(points, in_color=in_depth)
    depth, known = points.tactile_depth_m, np.isfinite(points.tactile_depth_m)
    depth = np.where(known, depth, np.median(depth[known]) if known.any() else _PLANE_M)
    alignment = rigid.alignment if rigid is not None else Alignment.of_rig(rig) or Alignment(np.eye(4))
    membrane = alignment.points_m(rig, np.column_stack([points.tactile, depth]))
    pixels = clicks_in_depth(rig, points.proximity, points.in_color, membrane)
    return replace(points, proximity=pixels, in_color=in_depth)


def _try_homography(clicked: PointArrays, ids: list[str], rig: Rig, rigid: Fit | None) -> tuple[Fit | None, str]:
    """Fit the homography to the inliers of the rigid fit, if all pairs have depth."""
    # points off one plane contradict every homography without being wrong; only the rigid model can tell
    told = None
    if rigid is not None and rigid.degrees > 0 and len(rigid.inliers) == len(clicked):
        told = rigid.inliers
    try:
        return fit_homography(clicked, rig, known=told, names=ids), ""
    except CalibrationError as error:
        return None, str(error)


def _quality(name: ModelName, fit: Fit, places: Float64Array, rigid: Fit | None) -> ModelQuality:
    rig, points = fit.model.rig, fit.model.points
    places = seen_places(fit, places, rig)
    agreement = judge_agreement(fit, points.places, places, rig)
    sensitivity = agreement.sensitivity(places)
    sigma_px = np.sqrt((sensitivity**2).sum(axis=(1, 2)))
    sigma_mm = sigma_px * millimetres_per_pixel(places[:, 2], rig)
    lateral, along, distance = sigma_mm, np.zeros(len(places)), places[:, 2]
    if name == "rigid":
        along = 1e3 * np.sqrt((fit.distance_sensitivity(places) ** 2).sum(axis=1))
    elif rigid is not None:  # off its plane a homography is wrong: the rigid fit tells by how much
        clicked = points.places[np.isfinite(points.tactile_depth_m)]
        distance = rigid.alignment.points_m(rig, clicked)[:, 2]
        gap = np.hypot(*(fit.predict(clicked) - rigid.predict(clicked)).T) * millimetres_per_pixel(distance, rig)
        lateral = np.hypot(gap, np.sqrt(np.mean(sigma_mm**2)))
        along = 1e3 * (distance - clicked[:, 2] - rigid.alignment.offset_m)
    millimetres = np.hypot(*fit.residuals_px.T) * millimetres_per_pixel(points.tactile_depth_m, rig)
    boundary_mm, tolerance = patch_effect(lateral, along, distance)
    return ModelQuality(
        model=name,
        fit=fit,
        agreement=agreement,
        rms_px=None if fit.degrees <= 0 else fit.rms_px,
        alignment_px=float(np.sqrt(np.mean(sigma_px**2))),
        alignment_mm=float(np.sqrt(np.mean(sigma_mm**2))),
        alignment_bound_95_px=bound(sensitivity, fit.degrees),
        boundary_error_mm=boundary_mm,
        supported_tolerance=tolerance,
        pairs=tuple(
            PairQuality(fit.model.names[i], bool(fit.inliers[i]), float(dx), float(dy), float(millimetres[i]))
            for i, (dx, dy) in enumerate(fit.residuals_px)
        ),
    )


def _recommend(quality: dict[ModelName, ModelQuality], refused: dict[ModelName, str]) -> tuple[ModelName, str]:
    both: tuple[ModelName, ModelName] = ("homography", "rigid")
    for name, other in (both, both[::-1]):
        if other not in quality:
            return name, f"Recommended: {name}, because no {other} could be fitted: {refused[other]}."
    plane, rigid = (quality[name].cross_validated_px for name in both)
    if rigid is None or plane is None:
        compared = "there are too few points to cross-validate both"
    else:
        compared = f"each ninth of the image left out in turn, homography leaves {plane:.1f} px, rigid {rigid:.1f} px"
        if rigid > _MUCH_WORSE * plane:
            return "homography", f"Recommended: homography; {compared}; check the tactile depths and the rig's lenses."
    return "rigid", f"Recommended: rigid, because it holds at every depth; {compared}."


def _warnings(pairs: list[PointPair], rigid: Fit | None, rig: Rig) -> tuple[str, ...]:
    from scipy.spatial.transform import Rotation  # slow to import

    if outside := [pair.id for pair in pairs if not _inside(pair, rig)]:
        named = ", ".join(outside[:5])
        return (f"pair {named} lies outside the images that the rig states; check that it is the right rig",)
    if rigid is None or rig.T_proximity_tactile is None:
        return ()
    pose, stated = np.asarray(rigid.alignment.pose), np.asarray(rig.T_proximity_tactile)
    apart = float(np.linalg.norm(pose[:3, 3] - stated[:3, 3]))
    turned = np.degrees(Rotation.from_matrix(pose[:3, :3] @ stated[:3, :3].T).magnitude())
    variances = np.diag(rigid.covariance)
    turn_rad, shift_m = np.sqrt([variances[:3].sum(), variances[3:6].sum()]).tolist()  # all directions together
    if apart <= _STATED_POSE_M + 4 * shift_m and turned <= _STATED_POSE_DEG + 4 * np.degrees(turn_rad):
        return ()
    return (
        f"the fitted pose lies {1e3 * apart:.0f} mm and {turned:.1f} degrees from the one that the rig states; "
        "check the pairs and the rig",
    )


def _inside(pair: PointPair, rig: Rig) -> bool:
    seen = rig.proximity_color_shape if pair.proximity_image == "color" else rig.proximity.intrinsics.shape
    sides = ((pair.proximity, seen), (pair.tactile, rig.tactile.intrinsics.shape))
    return all(
        place is not None and -0.5 <= place[0] <= width - 0.5 and -0.5 <= place[1] <= height - 0.5
        for place, (height, width) in sides
    )
