"""Depth quality in words: each number with its limit, and what to do if it is exceeded.

The limits of fill rate, plane fit and temporal noise follow the depth quality that Intel's data sheet of the D400
family promises (fill rate 99 %, spatial and temporal noise in the order of 1 to 2 % of the distance); the bias is
judged by the contact test of the preset: by its tolerance, or by what the membrane test corrects.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

from ..errors import as_sentence, minus
from ..preset import Preset
from .depth_quality import NOISE_FRAMES, CameraQuality, DepthQuality

_GOOD_FILL, _FAIR_FILL = 0.99, 0.95
_GOOD_NOISE, _FAIR_NOISE = 0.01, 0.02
_GOOD_SUBPIXEL_PX, _FAIR_SUBPIXEL_PX = 0.1, 0.3
#: Plane-fit error as a share of the distance: probably not flat, and certainly not one plane.
_NOT_FLAT, _NO_PLANE = 0.03, 0.1
_TILTED_DEG, _EDGE_ON_DEG = 15.0, 70.0
#: Points off the target may turn the plane by this angle, degrees.
_STRAY_DEG = 5.0
_FLAT_STEP = "No flat surface fills the region: choose a flat target, or drag the region onto one."
_GOOD_ACCURACY = 0.02
#: If the scatter exceeds this multiple of the fair bias, the cameras do not see the same surface.
_ONE_SURFACE_SHARE = 1.5
#: The limit on a bias that counts at most for that, metres; the membrane test corrects a larger one.
_ONE_SURFACE_MAX_M = 0.01


class Verdict(StrEnum):
    """Grade of a value."""

    GOOD = "good"
    FAIR = "fair"
    POOR = "poor"
    UNKNOWN = "not known"


@dataclass(frozen=True)
class Reading:
    """One value with its grade.

    Attributes
    ----------
    title : str
        Such as ``"Fill rate"``.
    value : str
        With unit; empty if unknown.
    verdict : Verdict
    limit : str
        Limit of a good value.
    step : str
        What to do next; empty if nothing needs to be done.
    """

    title: str
    value: str
    verdict: Verdict
    limit: str = ""
    step: str = ""

    @property
    def line(self) -> str:
        """Everything in one line."""
        value = f"{self.title}: {self.value}" if self.value else self.title
        limit = f" ({self.limit_words})" if self.limit else ""
        return f"{value} – {self.verdict}{limit}." + (f" {self.step}" if self.step else "")

    @property
    def limit_words(self) -> str:
        """The limit, marked as that of a good value if the value exceeds it."""
        return self.limit if self.verdict is Verdict.GOOD or not self.limit else f"good: {self.limit}"


def judge_camera(quality: CameraQuality) -> tuple[Reading, ...]:
    """Return the readings of one camera, in display order."""
    readings = [_fill(quality), _plane(quality)]
    if math.isfinite(quality.subpixel_rms_px) and readings[-1].verdict is not Verdict.UNKNOWN:
        readings.append(_subpixel(quality))
    readings.append(_noise(quality))
    if math.isfinite(quality.z_accuracy):
        readings.append(_accuracy(quality))
    return tuple(readings)


def judge_bias(quality: DepthQuality, preset: Preset) -> Reading:
    """Grade the bias between both cameras by the contact test of a preset."""
    bias = quality.bias
    title = "Bias between the cameras"
    if bias is None:
        step = as_sentence(quality.bias_problem or "the cameras cannot be compared")
        return Reading(title, "", Verdict.UNKNOWN, step=step)
    farther = "proximity" if bias.bias_m >= 0 else "tactile"
    value = (
        f"the {farther} camera reads {1e3 * abs(bias.bias_m):.2f} mm ({100 * abs(bias.share):.2f} %) farther, "
        f"scatter {1e3 * bias.spread_m:.2f} mm"
    )
    distance_m = bias.bias_m / bias.share if bias.share else math.inf
    limits = preset.test.bias_limits(preset, distance_m)
    if bias.spread_m > _ONE_SURFACE_SHARE * min(limits.fair_m, _ONE_SURFACE_MAX_M):
        step = "The cameras do not see the same surface: put a flat, opaque target in front of both."
        return Reading(title, value, Verdict.UNKNOWN, step=step)
    if abs(bias.bias_m) <= limits.good_m:
        return Reading(title, value, Verdict.GOOD, limits.reason)
    verdict = Verdict.FAIR if abs(bias.bias_m) <= limits.fair_m else Verdict.POOR
    step = (
        f"If both see the same flat target, add {minus(f'{1e3 * bias.bias_m:+.1f}')} mm to the preset's depth offset."
    )
    return Reading(title, value, verdict, limits.reason, step)


def _fill(quality: CameraQuality) -> Reading:
    steps = {
        "proximity": "Raise the laser power or gain, lower the confidence threshold, keep sunlight and black or "
        "shiny targets away.",
        "tactile": "Light the scene evenly, give the target texture, stay beyond the shortest distance.",
    }
    share = quality.fill_rate
    verdict = _low_end(share, _GOOD_FILL, _FAIR_FILL)
    step = "" if verdict is Verdict.GOOD else steps[quality.role]
    return Reading("Fill rate", f"{100 * share:.1f} %", verdict, f"{100 * _GOOD_FILL:.0f} % or more", step)


def _plane(quality: CameraQuality) -> Reading:
    share = quality.plane_rms_share
    if not math.isfinite(share):
        return Reading(
            "Plane fit", "", Verdict.UNKNOWN, step="Too few pixels in the region have depth for a plane fit."
        )
    if quality.stray_tilt_deg > _STRAY_DEG:
        step = (
            f"Pixels far from the target turn the plane by {quality.stray_tilt_deg:.0f}°: "
            "make the region smaller, so that it holds the flat target only."
        )
        return Reading("Plane fit", "no flat surface", Verdict.UNKNOWN, step=step)
    if share > _NO_PLANE or quality.angle_deg > _EDGE_ON_DEG:
        return Reading("Plane fit", "no flat surface", Verdict.UNKNOWN, step=_FLAT_STEP)
    value = (
        f"{1e3 * quality.plane_rms_m:.2f} mm, {100 * share:.2f} % of {1e3 * quality.distance_m:.0f} mm, "
        f"tilted {quality.angle_deg:.0f}°"
    )
    limit = f"below {100 * _GOOD_NOISE:.0f} % at this distance"
    verdict = _high_end(share, _GOOD_NOISE, _FAIR_NOISE)
    step = ""
    if share > _NOT_FLAT:
        step = _FLAT_STEP
    elif quality.angle_deg > _TILTED_DEG:
        step = "Turn the target to face the camera."
    elif verdict is not Verdict.GOOD:
        step = "Check that the target is flat; otherwise come nearer and improve the light."
    return Reading("Plane fit RMS", value, verdict, limit, step)


def _subpixel(quality: CameraQuality) -> Reading:
    error = quality.subpixel_rms_px
    verdict = _high_end(error, _GOOD_SUBPIXEL_PX, _FAIR_SUBPIXEL_PX)
    step = ""
    if verdict is not Verdict.GOOD:
        step = "Give the flat target a fine, irregular texture; if that does not help, recalibrate the camera."
        if quality.plane_rms_share > _FAIR_NOISE:
            step = "This value is meaningful on a flat target only."
    return Reading("Subpixel RMS", f"{error:.3f} px", verdict, f"below {_GOOD_SUBPIXEL_PX} px", step)


def _noise(quality: CameraQuality) -> Reading:
    share = quality.temporal_noise_share
    if not math.isfinite(share):
        step = f"It needs {NOISE_FRAMES} frames of a static scene; let the source play."
        return Reading("Temporal noise", "", Verdict.UNKNOWN, step=step)
    value = f"{1e3 * quality.temporal_noise_m:.2f} mm, {100 * share:.2f} %, over {quality.frames} frames"
    limit = f"below {100 * _GOOD_NOISE:.0f} % at this distance"
    verdict = _high_end(share, _GOOD_NOISE, _FAIR_NOISE)
    step = "" if verdict is Verdict.GOOD else "Keep the scene static; if it is, improve light and texture."
    return Reading("Temporal noise", value, verdict, limit, step)


def _accuracy(quality: CameraQuality) -> Reading:
    share = quality.z_accuracy
    verdict = _high_end(abs(share), _GOOD_ACCURACY, 2 * _GOOD_ACCURACY)
    step = "" if verdict is Verdict.GOOD else "Measure the true distance along the optical axis, from the front glass."
    word = "too far" if share >= 0 else "too near"
    limit = f"within {100 * _GOOD_ACCURACY:.0f} %"
    return Reading("Z accuracy", f"{100 * abs(share):.2f} % {word}", verdict, limit, step)


def _low_end(value: float, good: float, fair: float) -> Verdict:
    return Verdict.GOOD if value >= good else Verdict.FAIR if value >= fair else Verdict.POOR


def _high_end(value: float, good: float, fair: float) -> Verdict:
    return Verdict.GOOD if value <= good else Verdict.FAIR if value <= fair else Verdict.POOR
