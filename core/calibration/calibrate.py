"""The calibration: both models are fitted to the same correspondences and cross-validated; one is recommended."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Literal

import numpy as np
import numpy.typing as npt

from ..errors import CalibrationError
from ..model.arrays import BoolArray, Float64Array
from ..model.frames import Rig
from ..preset import now
from .agreement import Agreement, judge_agreement
from .correspondences import Correspondence, enabled_pairs, listed, pixel_arrays
from .depth_advice import advise_depth_fit
from .distortion import advise_distortion, two_planes
from .homography import CLICK_SIGMA_PX, HomographyFit, fit_homography
from .quality import (
    PatchEffect,
    UncertaintyMap,
    bound,
    coverage,
    membrane_places,
    millimetres_per_pixel,
    patch_effect,
    uncertainty_map,
)
from .report import CalibrationReport, ModelName, ModelQuality, PairQuality, distortion_verdict, verdict
from .rigid import DepthFit, Pose, RigidFit, RigidPoints, clicks_in_depth, color_lens, fit_rigid, has_ray

Model = Literal["auto", "homography", "rigid"]
DepthChoice = DepthFit | Literal["auto"]

#: Distance assumed for colour clicks without depth and pose, metres.
_PLANE_M = 0.30
#: A rigid fit this much worse than a homography under cross-validation indicates wrong depths or lenses.
_MUCH_WORSE = 1.25
#: A fit farther from the rig's stated pose than this causes a warning: metres, degrees.
_STATED_POSE_M, _STATED_POSE_DEG = 0.010, 4.0


def calibrate(
    correspondences: Sequence[Correspondence],
    rig: Rig,
    model: Model = "auto",
    *,
    depth_fit: DepthChoice = "none",
    membrane: npt.ArrayLike | None = None,
    estimate_distortion: bool = False,
) -> CalibrationReport:
    """Fit both models to correspondences and report their quality.

    Parameters
    ----------
    correspondences : sequence of Correspondence
        Disabled ones are kept in the report but not used.
    rig : Rig
    model : {"auto", "homography", "rigid"}
        The model to use; the other one is also fitted if possible.
    depth_fit : {"none", "offset", "scale", "both", "auto"}
        Let the rigid fit correct the tactile depth, with ``"auto"`` as `advise_depth_fit` recommends.
    membrane : array_like, shape (M, 3), optional
        Places (tactile u, v in pixels, depth in metres) over which the alignment is judged. Default: a grid over the
        tactile image at the depths of the points.
    estimate_distortion : bool
        Use the radial lens distortion that `advise_distortion` offers, if it offers one.

    Raises
    ------
    CalibrationError
        The correspondences do not determine the requested model (with ``"auto"``: no model), or contradict it.
    """
    pairs = enabled_pairs(correspondences)
    _refuse_repeated(pairs)
    _refuse_folded(pairs, rig)
    _, tactile, depth = pixel_arrays(pairs)
    distortion = advise_distortion(pairs, rig)
    if estimate_distortion and distortion.rig is not None:
        rig = distortion.rig
    advice = advise_depth_fit(rigid_points(pairs), rig)
    fitted_depth = advice.depth_fit if depth_fit == "auto" else depth_fit
    rigid, refused_rigid = _try_rigid(pairs, rig, fitted_depth)
    clicked = depth_pixels(pairs, rig, rigid)
    names = [pair.id for pair in pairs]
    homography, refused_homography = _try_homography(tactile, clicked, rigid, depth, names)
    refused = {"homography": refused_homography, "rigid": refused_rigid}
    bent = distortion.found and rig is not distortion.rig
    if bent:
        refused = {name: why and distortion.refusal for name, why in refused.items()}
    elif refused_homography and (planes := two_planes(pairs, rig)):
        refused["homography"] = planes
    _raise_if_missing(model, refused)

    places = membrane_places(tactile, depth, rig) if membrane is None else np.asarray(membrane, np.float64)
    quality: dict[str, ModelQuality] = {}
    if homography is not None:
        quality["homography"] = _homography_quality(homography, rigid, pairs, depth, places, rig)
    if rigid is not None:
        quality["rigid"] = _rigid_quality(rigid, pairs, depth, places, rig)
    covered = coverage(clicked, depth, rig)
    recommended, reason = _recommend(quality, refused, covered.depth_span_mm)
    chosen = recommended if model == "auto" else model
    used = np.array([pair.used for pair in quality[chosen].pairs])
    with_place = clicked if chosen == "homography" else clicked[np.isfinite(depth)]
    return CalibrationReport(
        model=chosen,
        recommended=recommended,
        reason=reason,
        homography=homography,
        rigid=rigid,
        quality=quality,
        refused={name: text for name, text in refused.items() if text},
        coverage=covered,
        verdict=distortion_verdict(quality[chosen], distortion)
        if bent
        else verdict(quality[chosen], covered, with_place[used], rig),
        distortion=distortion,
        depth_fit=fitted_depth,
        depth_advice=advice,
        warnings=tuple(_warnings(pairs, rigid, rig, fitted_depth)),
        pairs=tuple(correspondences),
        rig=rig,
        date=now(),
    )


def rigid_points(pairs: Sequence[Correspondence]) -> RigidPoints:
    """Return the correspondences with tactile depth, as arrays."""
    pairs = [pair for pair in pairs if pair.tactile_depth_m is not None]
    proximity, tactile, depth = pixel_arrays(pairs)
    measured = [np.nan if pair.proximity_depth_m is None else pair.proximity_depth_m for pair in pairs]
    in_color = np.array([pair.proximity_image == "color" for pair in pairs], dtype=bool)
    return RigidPoints(tactile, depth, proximity, in_color, np.array(measured, dtype=np.float64))


def depth_pixels(pairs: Sequence[Correspondence], rig: Rig, rigid: RigidFit | None = None) -> Float64Array:
    """Return each correspondence's pixel in the proximity *depth* image, shape (N, 2).

    A click in the colour image is a ray to the membrane. Its length follows from the tactile depth and the fitted pose,
    or the rig's stated pose.
    """
    proximity, tactile, depth = pixel_arrays(pairs)
    in_color = np.array([pair.proximity_image == "color" for pair in pairs], dtype=bool)
    if not in_color.any() or rig.proximity_color is None:
        return proximity
    usual = float(np.nanmedian(depth)) if np.isfinite(depth).any() else _PLANE_M
    depth = np.where(np.isfinite(depth), depth, usual)
    stated = np.eye(4) if rig.T_proximity_tactile is None else rig.T_proximity_tactile
    pose = Pose.of(stated) if rigid is None else rigid.pose
    points = pose.points_m(rig.tactile.intrinsics, np.column_stack([tactile, depth]))
    return clicks_in_depth(rig, proximity, in_color, points)


def _try_rigid(pairs: list[Correspondence], rig: Rig, depth_fit: DepthFit) -> tuple[RigidFit | None, str]:
    points = rigid_points(pairs)
    if len(points.tactile) < 4 and len(pairs) >= 4:
        return None, (
            f"only {len(points.tactile)} of the {len(pairs)} pairs have a tactile depth, a rigid alignment needs 4; "
            "click where the tactile camera sees depth"
        )
    try:
        names = [pair.id for pair in pairs if pair.tactile_depth_m is not None]
        return fit_rigid(points, rig, depth_fit=depth_fit, names=names), ""
    except CalibrationError as error:
        return None, str(error)


def _try_homography(
    tactile: Float64Array, proximity: Float64Array, rigid: RigidFit | None, depth: Float64Array, names: list[str]
) -> tuple[HomographyFit | None, str]:
    """Fit the homography; if the rigid fit has more inliers, fit it to those.

    Points off one plane contradict every homography without being wrong; only the rigid model can tell.
    """
    own: HomographyFit | None = None
    reason = ""
    try:
        own = fit_homography(tactile, proximity, names=names)
    except CalibrationError as error:
        reason = str(error)
    if rigid is None or rigid.degrees <= 0 or not np.isfinite(depth).all():
        return own, reason
    if own is not None and own.used.sum() >= rigid.used.sum():
        return own, reason
    try:
        return fit_homography(tactile, proximity, use=rigid.used), ""
    except CalibrationError:
        return own, reason


def _raise_if_missing(model: Model, refused: dict[str, str]) -> None:
    if model != "auto" and refused[model]:
        raise CalibrationError(refused[model])
    if all(refused.values()):
        homography, rigid = refused["homography"], refused["rigid"]
        raise CalibrationError(homography if homography == rigid else f"no homography: {homography}; no rigid: {rigid}")


def _homography_quality(
    fit: HomographyFit,
    rigid: RigidFit | None,
    pairs: list[Correspondence],
    depth: Float64Array,
    places: Float64Array,
    rig: Rig,
) -> ModelQuality:
    _, tactile, _ = pixel_arrays(pairs)
    agreement, spread = _judged(fit, np.column_stack([tactile, depth]), places, rig)
    lateral, along, distance = spread.sigma_mm, np.zeros(len(spread.places)), spread.places[:, 2]
    if rigid is not None:
        clicked = np.column_stack([tactile, depth])[np.isfinite(depth)]
        points = rigid.points_m(clicked)
        distance = points[:, 2]
        gap = np.hypot(*(fit.predict(clicked) - rigid.predict(clicked)).T) * millimetres_per_pixel(distance, rig)
        lateral = np.hypot(gap, np.sqrt(np.mean(spread.sigma_mm**2)))
        along = 1e3 * (distance - rigid.pose.scale * clicked[:, 2] - rigid.pose.offset_m)
    effect = patch_effect(lateral, along, distance)
    return _quality("homography", fit, agreement, spread, pairs, depth, rig, effect)


def _rigid_quality(
    fit: RigidFit, pairs: list[Correspondence], depth: Float64Array, places: Float64Array, rig: Rig
) -> ModelQuality:
    known = np.isfinite(depth)
    with_depth = [pair for pair, has in zip(pairs, known, strict=True) if has]
    agreement, spread = _judged(fit, rigid_points(with_depth).places, places, rig)
    along = 1e3 * np.sqrt((fit.depth_sensitivity(spread.places) ** 2).sum(axis=1))
    effect = patch_effect(spread.sigma_mm, along, spread.places[:, 2])
    return _quality("rigid", fit, agreement, spread, with_depth, depth[known], rig, effect)


def _judged(
    fit: HomographyFit | RigidFit, pairs: Float64Array, places: Float64Array, rig: Rig
) -> tuple[Agreement, UncertaintyMap]:
    """Return the agreement of a fit's regions, and its uncertainty over the places with it."""
    agreement = judge_agreement(fit, pairs, uncertainty_map(fit, places, rig).places, rig)
    return agreement, uncertainty_map(agreement, places, rig)


def _quality(
    name: ModelName,
    fit: HomographyFit | RigidFit,
    agreement: Agreement,
    spread: UncertaintyMap,
    pairs: list[Correspondence],
    depth: Float64Array,
    rig: Rig,
    effect: PatchEffect,
) -> ModelQuality:
    left_out = fit.left_out_residuals_px()
    exact = fit.degrees <= 0
    lengths = np.hypot(*fit.residuals_px.T)
    millimetres = lengths * millimetres_per_pixel(depth, rig)
    details = tuple(
        PairQuality(
            id=pair.id,
            used=bool(fit.used[i]),
            residual_u=float(fit.residuals_px[i, 0]),
            residual_v=float(fit.residuals_px[i, 1]),
            residual_px=float(lengths[i]),
            residual_mm=float(millimetres[i]),
            left_out_px=float(np.hypot(*left_out[i])),
            tactile_depth_m=float(depth[i]),
        )
        for i, pair in enumerate(pairs)
    )
    used: BoolArray = fit.used
    worst = int(np.argmax(np.where(used, lengths, -1.0)))
    known_mm = millimetres[used & np.isfinite(depth)]
    return ModelQuality(
        model=name,
        rms_px=None if exact else fit.rms_px,
        rms_mm=None if exact or not len(known_mm) else float(np.sqrt(np.mean(known_mm**2))),
        worst_px=None if exact else float(lengths[worst]),
        worst_id=None if exact else pairs[worst].id,
        agreement=agreement,
        click_noise_px=None if exact else fit.noise_factor * CLICK_SIGMA_PX,
        degrees=fit.degrees,
        condition=fit.condition,
        alignment_px=float(np.sqrt(np.mean(spread.sigma_px**2))),
        alignment_mm=float(np.sqrt(np.mean(spread.sigma_mm**2))),
        alignment_bound_95_px=bound(agreement.sensitivity(spread.places), fit.degrees),
        effect=effect,
        excluded=tuple(pair.id for pair, kept in zip(pairs, used, strict=True) if not kept),
        doubtful=tuple(pairs[i].id for i in fit.doubtful if used[i]),
        pairs=details,
        map=spread,
    )


def _recommend(quality: dict[str, ModelQuality], refused: dict[str, str], span_mm: float) -> tuple[ModelName, str]:
    if "rigid" not in quality:
        return "homography", f"Recommended: homography, because no rigid alignment could be fitted: {refused['rigid']}."
    if "homography" not in quality:
        return "rigid", f"Recommended: rigid, because no homography could be fitted: {refused['homography']}."
    plane, rigid = quality["homography"], quality["rigid"]
    if rigid.cross_validated_px is None or plane.cross_validated_px is None:
        return "rigid", (
            "Recommended: rigid, because it holds at every depth; there are too few points to cross-validate both."
        )
    left = f"a homography leaves {plane.cross_validated_px:.1f} px, rigid {rigid.cross_validated_px:.1f} px"
    if rigid.cross_validated_px > _MUCH_WORSE * plane.cross_validated_px:
        return "homography", (
            f"Recommended: homography, because in cross-validation {left}; "
            "check the tactile depths and the rig's lenses."
        )
    if rigid.cross_validated_px > plane.cross_validated_px / _MUCH_WORSE:
        return "rigid", f"Recommended: rigid: both fit equally well ({left}), and rigid holds at every depth."
    return "rigid", f"Recommended: rigid: the points span {span_mm:.0f} mm of depth; {left}."


def _refuse_repeated(pairs: list[Correspondence]) -> None:
    counts = Counter(pair.id for pair in pairs)
    for name, count in counts.items():
        if count > 1:
            raise CalibrationError(f"{count} pairs have the id {name!r}; give each pair its own")
    seen: dict[tuple[object, ...], str] = {}
    for pair in pairs:
        place = (*pair.proximity, pair.proximity_image, *pair.tactile)
        if place in seen:
            raise CalibrationError(
                f"pairs {seen[place]} and {pair.id} are the same points; delete one, a pair counts only once"
            )
        seen[place] = pair.id


def _refuse_folded(pairs: list[Correspondence], rig: Rig) -> None:
    proximity, tactile, _ = pixel_arrays(pairs)
    in_color = np.array([pair.proximity_image == "color" for pair in pairs], bool)
    seen = np.where(in_color, has_ray(color_lens(rig), proximity), has_ray(rig.proximity.intrinsics, proximity))
    for camera, known in (("tactile", has_ray(rig.tactile.intrinsics, tactile)), ("proximity", seen)):
        if not known.all():
            names = listed([pair.id for pair, found in zip(pairs, known, strict=True) if not found])
            raise CalibrationError(
                f"{names}: the {camera} lens of the rig takes no ray to that pixel; correct the lens's distortion "
                "coefficients, or delete what was clicked there"
            )


def _warnings(pairs: list[Correspondence], rigid: RigidFit | None, rig: Rig, depth_fit: DepthFit) -> list[str]:
    warnings = []
    if depth_fit in {"scale", "both"} and rigid is not None and all(pair.proximity_depth_m is None for pair in pairs):
        prior = "a prior near 1" if rig.T_proximity_tactile is None else "the rig's stated baseline"
        warnings.append(
            f"clicks alone do not determine the depth scale, so it rests on {prior}; give proximity_depth_m to points "
            "of contact clicked in the depth image"
        )
    outside = [pair.id for pair in pairs if not _inside(pair, rig)]
    if outside:
        warnings.append(
            f"pair {', '.join(outside[:5])} lies outside the images that the rig states; check that it is the right rig"
        )
    if rigid is not None and rig.T_proximity_tactile is not None:
        stated = np.asarray(rig.T_proximity_tactile)
        apart = float(np.linalg.norm(rigid.pose.translation - stated[:3, 3]))
        turned = _angle_deg(rigid.pose.rotation @ stated[:3, :3].T)
        turn_rad, shift_m = rigid.pose_sigma
        if apart > _STATED_POSE_M + 4 * shift_m or turned > _STATED_POSE_DEG + 4 * np.degrees(turn_rad):
            warnings.append(
                f"the fitted pose lies {1e3 * apart:.0f} mm and {turned:.1f} degrees from the one that the rig states; "
                "check the pairs and the rig"
            )
    return warnings


def _inside(pair: Correspondence, rig: Rig) -> bool:
    shape = rig.proximity_color_shape if pair.proximity_image == "color" else rig.proximity.intrinsics.shape
    tactile = rig.tactile.intrinsics.shape
    return all(
        -0.5 <= value <= size - 0.5
        for value, size in zip((*pair.proximity, *pair.tactile), (*shape[::-1], *tactile[::-1]), strict=True)
    )


def _angle_deg(rotation: Float64Array) -> float:
    return float(np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))))
