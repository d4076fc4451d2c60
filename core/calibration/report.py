"""Result of a calibration: data, JSON, text, and the verdict with the most useful next step."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ..errors import minus
from ..model.alignment import CalibrationRecord, ModelSummary, PointPair, SnapshotRecord
from ..model.arrays import Float64Array
from ..model.files import finite_or_none
from ..model.frames import Rig
from ..preset import HomographyAlignment, Preset, RigidAlignment, now
from .agreement import Agreement
from .points import listed
from .robust_fit import Fit

#: Noise of one pixel of either depth camera on this sensor, metres.
PROXIMITY_NOISE_M = 0.001
TACTILE_NOISE_M = 0.0005
#: Typical slope of the membrane across the line of sight; tangent of the angle at which it leaves an object.
MEMBRANE_SLOPE = 0.5
TAKE_OFF_TANGENT = 1.0
#: Two-sided 95 % quantile of the normal distribution: share of the pixels in contact that pass the tolerance test.
_PASSING_SIGMAS = 1.96

_GRID = (13, 10)
_MEMBRANE_SHARE = np.array([0.8, 0.65])


def membrane_places(tactile: Float64Array, depth_m: Float64Array, rig: Rig) -> Float64Array:
    """Return a grid over the membrane with depths interpolated from the clicked points, shape (M, 3).

    The membrane is assumed to fill the central `_MEMBRANE_SHARE` of the tactile image and to contain all points.
    Depths are interpolated by inverse squared distance; 0.3 m if no point has depth.
    """
    height, width = rig.tactile.intrinsics.shape
    size = np.array([width - 1.0, height - 1.0])
    low = np.minimum(size * (1 - _MEMBRANE_SHARE) / 2, tactile.min(axis=0))
    high = np.maximum(size * (1 + _MEMBRANE_SHARE) / 2, tactile.max(axis=0))
    u, v = np.meshgrid(np.linspace(low[0], high[0], _GRID[0]), np.linspace(low[1], high[1], _GRID[1]))
    places = np.stack([u.ravel(), v.ravel()], axis=1)
    known = np.isfinite(depth_m)
    if not known.any():
        return np.column_stack([places, np.full(len(places), 0.3)])
    gaps = ((places[:, None] - tactile[None, known]) ** 2).sum(axis=2)
    weights = 1.0 / (gaps + 20.0**2)
    return np.column_stack([places, weights @ depth_m[known] / weights.sum(axis=1)])


def seen_places(fit: Fit, places: Float64Array, rig: Rig) -> Float64Array:
    """Return those of places (M, 3) that the fit predicts inside the proximity image; all if there are none."""
    height, width = rig.proximity.intrinsics.shape
    with np.errstate(divide="ignore", invalid="ignore"):
        proximity = fit.predict(places)
        inside = ((proximity >= 0) & (proximity <= (width - 1, height - 1))).all(axis=1)
    return places[inside] if inside.any() else places


def millimetres_per_pixel(depth_m: npt.ArrayLike, rig: Rig) -> Float64Array:
    """Return the width of a proximity pixel at a depth, millimetres."""
    lens = rig.proximity.intrinsics
    return np.asarray(np.asarray(depth_m) * 2000.0 / (lens.fx + lens.fy))


def bound(derivative: Float64Array, degrees: int) -> float:
    """Return the 95 % bound of the root mean square error over places, pixels.

    The squared error ``e^T M e``, ``M = mean J^T J``, is a sum of chi-squares weighted by M's eigenvalues, about one
    chi-square of as many degrees as gives the same mean and variance (Box 1954). If the noise was estimated from
    ``degrees`` surplus measurements, it is divided by their chi-square. No degrees mean the stated noise.

    ``derivative`` is `Agreement.sensitivity` at the places, shape (M, 2, P).
    """
    from scipy.special import chdtri, fdtri  # slow to import

    rows = derivative.reshape(-1, derivative.shape[2])
    weights = rows.T @ rows / len(derivative)
    mean = float(np.trace(weights))
    if mean <= 0.0:
        return 0.0
    of_error = mean**2 / float((weights**2).sum())
    ratio = fdtri(of_error, degrees, 0.95) if degrees > 0 else chdtri(of_error, 0.05) / of_error
    return float(np.sqrt(mean * ratio))


def patch_effect(lateral_mm: npt.ArrayLike, along_mm: npt.ArrayLike, distance_m: npt.ArrayLike) -> tuple[float, float]:
    """Propagate alignment errors to the contact test ``|dp - dt| <= t dp``.

    Return the error of a patch's boundary, mm, and the least t with which 95 % of the pixels in contact pass.

    A lateral error l reads the tactile depth beside the right place; on a membrane of slope m this changes dt by
    ``m l``. An error a along the line of sight changes dp by a. Both sensors add noise,
    `PROXIMITY_NOISE_M` (n_p) and `TACTILE_NOISE_M` (n_t). At true contact:

        s_i^2 = a_i^2 + (m l_i)^2 / 2 + n_p^2 + n_t^2,        t = 1.96 sqrt(mean (s_i / d_i)^2)

    (l is the error in two directions, the slope is along one). If the membrane leaves the object at an angle with
    tangent g, the boundary moves by ``sqrt(l^2 + (a / g)^2)``.
    All three are given at places of the membrane, shape (M,).
    """
    lateral, along = np.asarray(lateral_mm, np.float64), np.asarray(along_mm, np.float64)
    sensors = (PROXIMITY_NOISE_M**2 + TACTILE_NOISE_M**2) * 1e6
    variance = along**2 + (MEMBRANE_SLOPE * lateral) ** 2 / 2 + sensors
    relative = variance / (np.asarray(distance_m, np.float64) * 1e3) ** 2
    boundary_mm = float(np.sqrt(np.mean(lateral**2 + (along / TAKE_OFF_TANGENT) ** 2)))
    return boundary_mm, float(_PASSING_SIGMAS * np.sqrt(relative.mean()))


ModelName = Literal["homography", "rigid"]
#: Expected alignment error over the membrane, pixels, up to which a calibration is good, and usable.
GOOD_PX, USABLE_PX = 0.6, 1.5
#: The same for the contact patch's boundary, millimetres: a homography may fit its pairs and be wrong at other depths.
GOOD_MM, USABLE_MM = 5.0, 20.0
#: Number of points from which the quality can be judged.
ADVISED_POINTS = 6
#: Depth that the points of a rigid alignment should span, millimetres.
ADVISED_SPAN_MM = 20.0
#: A pair stands out if its residual exceeds this multiple of the median residual, and this many pixels.
_SUSPICIOUS, _CLICK_AGAIN_PX = 3.0, 1.0


@dataclass(frozen=True)
class PairQuality:
    """One pair under a fit: clicked minus predicted proximity pixel, and that across the line of sight (mm, or nan)."""

    id: str
    used: bool = True
    dx: float = math.nan
    dy: float = math.nan
    residual_mm: float = math.nan

    @property
    def residual_px(self) -> float:
        """Length of the residual, pixels."""
        return math.hypot(self.dx, self.dy)


@dataclass(frozen=True, eq=False)
class ModelQuality:
    """Quality of one model's fit; ``rms_px`` is None where no pair is surplus, the error is that over the membrane."""

    model: ModelName
    fit: Fit
    agreement: Agreement
    rms_px: float | None
    alignment_px: float
    alignment_mm: float
    alignment_bound_95_px: float
    boundary_error_mm: float
    supported_tolerance: float
    pairs: tuple[PairQuality, ...]

    @property
    def excluded(self) -> tuple[str, ...]:
        """Ids of the outliers."""
        return tuple(pair.id for pair in self.pairs if not pair.used)

    def far_from_fit(self) -> list[PairQuality]:
        """Return the inliers with a much larger residual than the median, the worst first."""
        kept = sorted((pair for pair in self.pairs if pair.used), key=lambda pair: -pair.residual_px)
        usual = float(np.median([pair.residual_px for pair in kept]))
        limit = max(_SUSPICIOUS * usual, _CLICK_AGAIN_PX)
        return [pair for pair in kept if self.fit.degrees > 0 and pair.residual_px > limit]

    @property
    def standing_out(self) -> frozenset[str]:
        """Ids of the pairs to look at: rejected, or far from the fit, not merely the worst."""
        return frozenset({*self.excluded, *(pair.id for pair in self.far_from_fit())})

    @property
    def summary(self) -> dict[str, Any]:
        """What a preset keeps, as JSON values; missing ones are None."""
        return {name: getattr(self, name) for name in ModelSummary.model_fields}

    @property
    def cross_validated_px(self) -> float | None:
        return self.agreement.cross_validated_px


@dataclass(frozen=True)
class DepthOffset:
    """An offset of the tactile depth fitted to the pairs, metres, with its standard deviation; whether it is used."""

    offset_m: float
    sigma_m: float
    used: bool

    def words(self) -> str:
        """Return the offset that the preset gets, or nothing: else the bias says how the cameras' depths differ."""
        size = minus(f"{1e3 * self.offset_m:+z.2f} ± {1e3 * self.sigma_m:.2f} mm")
        return f"Depth offset: {size}." if self.used else ""


@dataclass(frozen=True, eq=False)
class CalibrationReport:
    """Fits of both models, the recommendation and the next step.

    ``model`` is the model asked for, or with ``"auto"`` the recommended one, for which ``reason`` says why. ``refused``
    says why a model was not fitted. ``depth_offset`` is None if the pairs do not determine one. ``pairs`` are all given
    ones, including disabled ones.
    """

    model: ModelName
    recommended: ModelName
    reason: str
    quality: Mapping[ModelName, ModelQuality]
    refused: Mapping[ModelName, str]
    depth_span_mm: float
    depth_offset: DepthOffset | None
    warnings: tuple[str, ...]
    pairs: tuple[PointPair, ...]
    rig: Rig
    date: datetime

    @property
    def chosen(self) -> ModelQuality:
        return self.quality[self.model]

    @property
    def homography(self) -> Fit | None:
        return self.quality["homography"].fit if "homography" in self.quality else None

    @property
    def rigid(self) -> Fit | None:
        return self.quality["rigid"].fit if "rigid" in self.quality else None

    @property
    def verdict(self) -> str:
        """Grade and next step, in words."""
        return f"{grade(self.chosen)} {next_step(self.chosen, self.depth_span_mm, self.recommended)}"

    def to_json(self) -> dict[str, Any]:
        aligned = self.chosen.fit.alignment
        return {
            "model": self.model,
            "recommended": self.recommended,
            "reason": self.reason,
            "homography": None if aligned.homography is None else aligned.homography.tolist(),
            "T_proximity_tactile": None if aligned.pose is None else aligned.pose.tolist(),
            "depth_offset_m": aligned.offset_m,
            **self.chosen.summary,
            "alignment_mm": self.chosen.alignment_mm,
            "verdict": self.verdict,
            "warnings": list(self.warnings),
            "pairs": [
                {name: finite_or_none(value) if isinstance(value, float) else value for name, value in numbers.items()}
                for numbers in (vars(pair) | {"residual_px": pair.residual_px} for pair in self.chosen.pairs)
            ],
            "refused": dict(self.refused),
            "date": self.date.isoformat(),
        }

    def apply_to(self, preset: Preset, *, snapshots: tuple[SnapshotRecord, ...] = ()) -> Preset:
        """Return the preset with this alignment, its record and its rig."""
        record = CalibrationRecord(
            date=self.date,
            model=self.model,
            proximity_serial=self.rig.proximity.serial,
            tactile_serial=self.rig.tactile.serial,
            verdict=self.verdict,
            points=self.pairs,
            snapshots=snapshots,
            quality=ModelSummary(**self.chosen.summary),
        )
        values: dict[str, Any] = {"model": self.model, "calibration": record}
        if self.homography is not None:
            H: Any = self.homography.alignment.homography
            distance_m = preset.alignment.homography.plane_distance_m
            values["homography"] = HomographyAlignment(H_p_t=H.tolist(), plane_distance_m=distance_m)
        if self.rigid is not None:
            pose: Any = self.rigid.alignment.pose
            values["rigid"] = RigidAlignment(T_proximity_tactile=pose)
            values |= {"depth_scale": 1.0, "depth_offset_m": self.rigid.alignment.offset_m}
        section = preset.alignment.model_copy(update=values)
        return preset.model_copy(update={"alignment": section, "rig": self.rig, "verdict": None, "modified": now()})

    def words(self) -> str:
        lines = [f"Model: {self.model}. {self.reason}"]
        if self.depth_offset is not None and self.depth_offset.used:
            lines.append(self.depth_offset.words())
        lines += [
            f"Residual of the {name} model: {quality.rms_px:.2f} px RMS; expected alignment error "
            f"{quality.alignment_px:.2f} px"
            for name, quality in self.quality.items()
            if quality.rms_px is not None
        ]
        lines += [f"Not fitted, {name}: {reason}" for name, reason in self.refused.items()]
        lines.append(f"Pairs under the {self.model} model (px: dX, dY, length; mm):")
        lines += [
            f"  {pair.id:>6}  {pair.dx:8.2f} {pair.dy:8.2f} {pair.residual_px:8.2f}  {pair.residual_mm:7.2f}"
            f"{'' if pair.used else '  rejected: the others contradict it'}"
            for pair in self.chosen.pairs
        ]
        lines += [f"Warning: {warning}" for warning in self.warnings]
        return "\n".join([*lines, "", f"Verdict: {self.verdict}"])


def grade(quality: ModelQuality) -> str:
    """Return the grade of a fit with its numbers, one sentence."""
    if quality.fit.degrees <= 0:
        used = sum(pair.used for pair in quality.pairs)
        return f"Unknown: a {quality.model} fits any {used} pairs, so their residuals mean nothing."
    boundary_mm = quality.boundary_error_mm
    good = quality.alignment_px <= GOOD_PX and boundary_mm <= GOOD_MM
    usable = quality.alignment_px <= USABLE_PX and boundary_mm <= USABLE_MM
    word = "Good" if good else "Usable" if usable else "Poor"
    return (
        f"{word}: expected alignment error {quality.alignment_px:.2f} px ({quality.alignment_mm:.2f} mm), with 95 % "
        f"certainty below {quality.alignment_bound_95_px:.2f} px; patch boundary off by "
        f"{boundary_mm:.2f} mm; the tolerance test needs t = {100 * quality.supported_tolerance:.2f} % or more."
    )


def next_step(quality: ModelQuality, depth_span_mm: float, recommended: ModelName) -> str:
    """Return the step that improves the calibration most, one sentence."""
    used, shared = sum(pair.used for pair in quality.pairs), quality.agreement.found
    wrong = quality.excluded or [pair.id for pair in ([] if shared else quality.far_from_fit()[:3])]
    if wrong:
        them, far = "them" if len(wrong) > 1 else "it", max(p.residual_px for p in quality.pairs if p.id in wrong)
        return f"Click {listed(wrong)} again or remove {them}: the others contradict {them} by up to {far:.1f} px."
    if used < ADVISED_POINTS:
        return f"Click at least {ADVISED_POINTS - used} more: with fewer than six the quality is a guess."
    if shared:
        return quality.agreement.next_step()
    if quality.model == "rigid" and depth_span_mm < ADVISED_SPAN_MM:
        return (
            f"Add points at another inflation level: all lie within {depth_span_mm:.0f} mm of depth, "
            f"{ADVISED_SPAN_MM:.0f} mm or more determine the pose well."
        )
    off_plane = quality.boundary_error_mm > GOOD_MM or (recommended == "rigid" and quality.alignment_px > GOOD_PX)
    if quality.model == "homography" and off_plane:
        step = "Check the tactile depths and take the rigid model: off its plane this homography is wrong."
    elif quality.alignment_px > GOOD_PX:
        wanted = min(int(np.ceil(used * (quality.alignment_px / GOOD_PX) ** 2)), 60)
        step = f"Add points where there are few, about {wanted} in all, clicked with the same care."
    else:
        step = "Check it on the live image and save it; nothing more is needed."
    return step
