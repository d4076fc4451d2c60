"""The calibration: both models are fitted to the same pairs and cross-validated; one is recommended."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Literal

import numpy as np
import numpy.typing as npt

from ..errors import CalibrationError
from ..model.alignment import PointPair
from ..model.arrays import Float64Array
from ..model.frames import Rig
from ..preset import now
from .agreement import judge_agreement
from .fits import Fit, fit_homography, fit_rigid
from .geometry import Alignment, clicks_in_depth
from .points import PointArrays
from .quality import bound, coverage, membrane_places, millimetres_per_pixel, patch_effect, uncertainty_map
from .report import CalibrationReport, DepthOffset, ModelName, ModelQuality, PairQuality

ModelChoice = Literal["auto", "homography", "rigid"]
DepthFit = Literal["auto", "none", "offset"]

#: Distance assumed for colour clicks without depth and pose, metres.
_PLANE_M = 0.30
#: A rigid fit this much worse than a homography under cross-validation indicates wrong depths or lenses.
_MUCH_WORSE = 1.25
#: A fit farther from the rig's stated pose than this causes a warning: metres, degrees.
_STATED_POSE_M, _STATED_POSE_DEG = 0.010, 4.0
#: Standard deviations from which an offset of the depth counts: neighbouring pairs share errors of the depth, which
#: the standard deviation does not contain. One frame of the simulator gives up to 6 where there is none.
_MIN_CERTAINTY = 10.0
#: Fewer pairs determine no offset.
_MIN_OFFSET_PAIRS = 12


def calibrate(
    pairs: Sequence[PointPair],
    rig: Rig,
    model: ModelChoice = "auto",
    *,
    depth_fit: DepthFit = "auto",
    membrane: npt.ArrayLike | None = None,
) -> CalibrationReport:
    """Fit the alignment of both cameras to clicked pairs of points and report its quality.

    Both models are fitted if possible: the rigid pose of the tactile camera in the proximity depth frame, which holds
    at every depth, and the homography of one plane. Wrong pairs are rejected and named.

    Parameters
    ----------
    pairs : sequence of PointPair
        At least 4, better 12 at several inflation levels, as `read_points` returns them. Disabled and pending ones are
        kept in the report but not used. A rigid fit needs their tactile depth.
    rig : Rig
        Lenses of both cameras. Its stated pose is only compared with the fitted one.
    model : {"auto", "homography", "rigid"}
        The model to use; ``"auto"`` takes the better one.
    depth_fit : {"auto", "none", "offset"}
        Whether the rigid fit also corrects the tactile depth by an offset; ``"auto"``: where it is 10 times its
        standard deviation or more.
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
        The pairs do not determine the requested model (with ``"auto"``: no model), or contradict it.
    """
    used = [pair for pair in pairs if pair.enabled and pair.complete]
    _refuse_repeated(used)
    points = PointArrays.of(used)
    ids = [pair.id for pair in used]
    known = np.isfinite(points.tactile_depth_m)
    rigid, offset, refused_rigid = _try_rigid(points, ids, rig, depth_fit)
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
    quality: dict[ModelName, ModelQuality] = {}
    if homography is not None:
        quality["homography"] = _quality("homography", homography, points, ids, places, rigid)
    if rigid is not None:
        with_depth = [name for name, has in zip(ids, known, strict=True) if has]
        quality["rigid"] = _quality("rigid", rigid, points.keep(known), with_depth, places, rigid)
    covered = coverage(clicked.proximity, points.tactile_depth_m, rig)
    recommended, reason = _recommend(quality, refused, covered.depth_span_mm)
    return CalibrationReport(
        model=recommended if model == "auto" else model,
        recommended=recommended,
        reason=reason,
        quality=quality,
        refused={name: text for name, text in refused.items() if text},
        coverage=covered,
        depth_offset=offset,
        warnings=tuple(_warnings(used, rigid, rig)),
        pairs=tuple(pair for pair in pairs if pair.complete),
        rig=rig,
        date=now(),
    )


def _refuse_repeated(pairs: list[PointPair]) -> None:
    for name, count in Counter(pair.id for pair in pairs).items():
        if count > 1:
            raise CalibrationError(f"{count} pairs have the id {name!r}; give each pair its own")
    seen: dict[object, str] = {}
    for pair in pairs:
        place = (pair.proximity, pair.proximity_image, pair.tactile)
        if place in seen:
            raise CalibrationError(
                f"pairs {seen[place]} and {pair.id} are the same points; delete one, a pair counts only once"
            )
        seen[place] = pair.id


def _try_rigid(
    points: PointArrays, ids: list[str], rig: Rig, depth_fit: DepthFit
) -> tuple[Fit | None, DepthOffset | None, str]:
    """Return the rigid fit, the offset that the pairs show, and why there is no fit."""
    known = np.isfinite(points.tactile_depth_m)
    if known.sum() < 4 <= len(points):
        return (
            None,
            None,
            (
                f"only {known.sum()} of the {len(points)} pairs have a tactile depth, a rigid alignment needs 4; "
                "click where the tactile camera sees depth"
            ),
        )
    points, names = points.keep(known), [name for name, has in zip(ids, known, strict=True) if has]
    shifted: Fit | None = None
    offset: DepthOffset | None = None
    try:
        if depth_fit == "offset" or len(points) >= _MIN_OFFSET_PAIRS:
            try:
                shifted = fit_rigid(points, rig, offset=True, names=names)
            except CalibrationError:
                if depth_fit == "offset":
                    raise
        if shifted is not None:
            size, sigma = shifted.alignment.offset_m, float(np.sqrt(shifted.covariance[6, 6]))
            certain = depth_fit == "auto" and abs(size) >= _MIN_CERTAINTY * sigma
            offset = DepthOffset(size, sigma, used=certain or depth_fit == "offset")
        if shifted is not None and offset is not None and offset.used:
            return shifted, offset, ""
        return fit_rigid(points, rig, names=names), offset, ""
    except CalibrationError as error:
        return None, None, str(error)


def _in_depth_image(points: PointArrays, rig: Rig, rigid: Fit | None) -> PointArrays:
    """Return the points with their proximity pixels in the *depth* image.

    A click in the colour image is a ray to the membrane. Its length follows from the tactile depth and the fitted pose,
    or the rig's stated pose.
    """
    if not points.in_color.any() or rig.proximity_color is None:
        return points
    depth, known = points.tactile_depth_m, np.isfinite(points.tactile_depth_m)
    depth = np.where(known, depth, np.median(depth[known]) if known.any() else _PLANE_M)
    alignment = rigid.alignment if rigid is not None else Alignment.of_rig(rig) or Alignment(np.eye(4))
    membrane = alignment.points_m(rig, np.column_stack([points.tactile, depth]))
    pixels = clicks_in_depth(rig, points.proximity, points.in_color, membrane)
    return PointArrays(points.tactile, points.tactile_depth_m, pixels, points.in_color, points.proximity_depth_m)


def _try_homography(clicked: PointArrays, ids: list[str], rig: Rig, rigid: Fit | None) -> tuple[Fit | None, str]:
    """Fit the homography; if the rigid fit has more inliers, fit it to those.

    Points off one plane contradict every homography without being wrong; only the rigid model can tell.
    """
    own: Fit | None = None
    reason = ""
    try:
        own = fit_homography(clicked, rig, names=ids)
    except CalibrationError as error:
        reason = str(error)
    if rigid is None or rigid.degrees <= 0 or len(rigid.used) < len(clicked):
        return own, reason
    if own is not None and own.used.sum() >= rigid.used.sum():
        return own, reason
    try:
        return fit_homography(clicked, rig, use=rigid.used), ""
    except CalibrationError:
        return own, reason


def _quality(
    name: ModelName, fit: Fit, points: PointArrays, ids: list[str], places: Float64Array, rigid: Fit | None
) -> ModelQuality:
    rig = fit.model.rig
    agreement = judge_agreement(fit, points.places, uncertainty_map(fit, fit, places, rig).places, rig)
    spread = uncertainty_map(fit, agreement, places, rig)
    lateral, along, distance = spread.sigma_mm, np.zeros(len(spread.places)), spread.places[:, 2]
    if name == "rigid":
        along = 1e3 * np.sqrt((fit.distance_sensitivity(spread.places) ** 2).sum(axis=1))
    elif rigid is not None:  # off its plane a homography is wrong: the rigid fit tells by how much
        clicked = points.places[np.isfinite(points.tactile_depth_m)]
        distance = rigid.alignment.points_m(rig, clicked)[:, 2]
        gap = np.hypot(*(fit.predict(clicked) - rigid.predict(clicked)).T) * millimetres_per_pixel(distance, rig)
        lateral = np.hypot(gap, np.sqrt(np.mean(spread.sigma_mm**2)))
        along = 1e3 * (distance - clicked[:, 2] - rigid.alignment.offset_m)
    left_out = np.hypot(*fit.left_out_residuals_px().T)
    millimetres = np.hypot(*fit.residuals_px.T) * millimetres_per_pixel(points.tactile_depth_m, rig)
    return ModelQuality(
        model=name,
        fit=fit,
        agreement=agreement,
        rms_px=None if fit.degrees <= 0 else fit.rms_px,
        alignment_px=float(np.sqrt(np.mean(spread.sigma_px**2))),
        alignment_mm=float(np.sqrt(np.mean(spread.sigma_mm**2))),
        alignment_bound_95_px=bound(agreement.sensitivity(spread.places), fit.degrees),
        effect=patch_effect(lateral, along, distance),
        pairs=tuple(
            PairQuality(ids[i], bool(fit.used[i]), float(dx), float(dy), float(millimetres[i]), float(left_out[i]))
            for i, (dx, dy) in enumerate(fit.residuals_px)
        ),
        map=spread,
    )


def _recommend(
    quality: dict[ModelName, ModelQuality], refused: dict[ModelName, str], span_mm: float
) -> tuple[ModelName, str]:
    if "rigid" not in quality:
        return "homography", f"Recommended: homography, because no rigid alignment could be fitted: {refused['rigid']}."
    if "homography" not in quality:
        return "rigid", f"Recommended: rigid, because no homography could be fitted: {refused['homography']}."
    plane, rigid = quality["homography"].cross_validated_px, quality["rigid"].cross_validated_px
    if rigid is None or plane is None:
        return "rigid", (
            "Recommended: rigid, because it holds at every depth; there are too few points to cross-validate both."
        )
    left = f"a homography leaves {plane:.1f} px, rigid {rigid:.1f} px"
    if rigid > _MUCH_WORSE * plane:
        return "homography", (
            f"Recommended: homography, because in cross-validation {left}; "
            "check the tactile depths and the rig's lenses."
        )
    if rigid > plane / _MUCH_WORSE:
        return "rigid", f"Recommended: rigid: both fit equally well ({left}), and rigid holds at every depth."
    return "rigid", f"Recommended: rigid: the points span {span_mm:.0f} mm of depth; {left}."


def _warnings(pairs: list[PointPair], rigid: Fit | None, rig: Rig) -> list[str]:
    warnings = []
    outside = [pair.id for pair in pairs if not _inside(pair, rig)]
    if outside:
        warnings.append(
            f"pair {', '.join(outside[:5])} lies outside the images that the rig states; check that it is the right rig"
        )
    if rigid is not None and rig.T_proximity_tactile is not None:
        pose, stated = np.asarray(rigid.alignment.pose), np.asarray(rig.T_proximity_tactile)
        apart = float(np.linalg.norm(pose[:3, 3] - stated[:3, 3]))
        turned = _angle_deg(pose[:3, :3] @ stated[:3, :3].T)
        turn_rad, shift_m = rigid.pose_sigma
        if apart > _STATED_POSE_M + 4 * shift_m or turned > _STATED_POSE_DEG + 4 * np.degrees(turn_rad):
            warnings.append(
                f"the fitted pose lies {1e3 * apart:.0f} mm and {turned:.1f} degrees from the one that the rig states; "
                "check the pairs and the rig"
            )
    return warnings


def _inside(pair: PointPair, rig: Rig) -> bool:
    seen = rig.proximity_color_shape if pair.proximity_image == "color" else rig.proximity.intrinsics.shape
    sides = ((pair.proximity, seen), (pair.tactile, rig.tactile.intrinsics.shape))
    return all(
        place is not None and -0.5 <= place[0] <= width - 0.5 and -0.5 <= place[1] <= height - 0.5
        for place, (height, width) in sides
    )


def _angle_deg(rotation: Float64Array) -> float:
    return float(np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))))
