"""A quick look at the bias between both cameras in the present patch, cheap enough to repeat while frames run."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from ...contact.masking import colors_at, in_hsv_range
from ...contact.membrane.bias import most_frequent_m, rig_bias
from ...contact.membrane.steps import firm_contact_bias
from ...contact.membrane.tension import LIMITS_PER_M, measured_curvature_per_m
from ...errors import RigMismatchError
from ...model.arrays import Float32Array
from ...model.clouds import deproject
from ...model.frames import Rig, SensorFrame
from ...model.patch import ContactPatch
from ...preset import Preset
from ...rig.bias import MeasuredBias, print_bias
from .disagreement import PEAK_SHARE, SAME_SCENE, Disagreement, peak_of

#: Step between the rows and columns that are read at first.
_STRIDE: Final = 4
#: Fewest read pixels on prints, and their largest difference, metres, as in `print_bias`.
_MIN_PRINT_PIXELS, _MAX_ON_PRINTS_M = 20, 0.04
#: A bias on prints that seems smaller than this share of the limit is below it.
_CLEARLY_BELOW: Final = 0.7
#: The depth of the scene must vary by this multiple of the peak, or the peak may be a gap.
_MIN_RELIEF: Final = 1.5


def quick_disagreement(
    frame: SensorFrame, patch: ContactPatch, preset: Preset, rig: Rig, above_m: float
) -> Disagreement | None:
    """Measure how much both cameras disagree, if it is more than ``above_m``, where that can be told from a gap.

    Parameters
    ----------
    patch : ContactPatch
        That of the frame and preset.
    above_m : float
        A smaller bias may give None, which saves time.
    """
    return (
        _in_whole_scene(patch, above_m)
        or _on_prints(frame, patch, preset, rig, above_m)
        or _in_firm_contact(frame, patch, preset, rig)
    )


def _in_whole_scene(patch: ContactPatch, above_m: float) -> Disagreement | None:
    """Return the peak of the differences, if it holds most of them over a scene whose depth varies.

    Between a flat membrane and a flat object behind it the gap is the same everywhere too.
    """
    expected, difference = (image[::_STRIDE, ::_STRIDE] for image in _differences(patch))
    known = np.isfinite(difference)
    centre = most_frequent_m(difference[known])
    with np.errstate(invalid="ignore"):
        in_peak = np.abs(difference - centre) < PEAK_SHARE * expected
    if np.count_nonzero(in_peak) < SAME_SCENE * np.count_nonzero(known) or abs(centre) < _CLEARLY_BELOW * above_m:
        return None
    near, far = np.percentile(expected[in_peak], (5, 95))
    if far - near < _MIN_RELIEF * abs(centre):
        return None
    peak = peak_of(*_differences(patch))
    return Disagreement.in_peak(peak) if peak is not None and peak.same_scene else None


def _on_prints(
    frame: SensorFrame, patch: ContactPatch, preset: Preset, rig: Rig, above_m: float
) -> Disagreement | None:
    """Return the bias on prints of the mask's colour."""
    if not preset.mask.enabled:
        return None
    difference = _differences(patch)[1]
    pixels = np.arange(difference.size).reshape(difference.shape)[::_STRIDE, ::_STRIDE]
    near = np.abs(difference[::_STRIDE, ::_STRIDE]) < _MAX_ON_PRINTS_M
    points = deproject(frame.proximity_depth, rig.proximity, pixels[near])
    colors, seen = colors_at(points, pixels[near], frame.proximity_color, rig)
    found = difference.reshape(-1)[pixels[near]][seen & in_hsv_range(colors, preset.mask)]
    if len(found) < _MIN_PRINT_PIXELS or abs(float(np.median(found))) < _CLEARLY_BELOW * above_m:
        return None
    try:
        bias = print_bias([frame], rig, preset, rig_bias(preset.noise, rig).noise_m4)
    except RigMismatchError:  # a homography without a pose
        return None
    return None if bias is None else Disagreement.on_prints(bias)


def _in_firm_contact(frame: SensorFrame, patch: ContactPatch, preset: Preset, rig: Rig) -> Disagreement | None:
    """Return the bias in firm contact as the membrane test finds it, also if the preset has another test.

    Only an inflated membrane tells firm contact from a flat gap.
    """
    facts, known = patch.membrane, rig_bias(preset.noise, rig)
    if facts is not None:
        found = (facts.bias_m, facts.firm_m2) if facts.firm_m2 > 0 and len(patch.points) else None
    else:
        curvature_per_m = measured_curvature_per_m(frame, preset.alignment, rig)
        if not LIMITS_PER_M[0] <= curvature_per_m <= LIMITS_PER_M[1]:
            return None
        try:
            found = firm_contact_bias(preset, rig)(frame)
        except RigMismatchError:  # a homography without a pose
            return None
    if found is None:
        return None
    bias_m, firm_m2 = found
    sigma_m = math.sqrt(known.noise_m4 / firm_m2 + known.gap_sigma_m**2)
    return Disagreement.in_firm_contact(MeasuredBias(bias_m, sigma_m, "contact"))


def _differences(patch: ContactPatch) -> tuple[Float32Array, Float32Array]:
    """Return the proximity depth and the difference of both depths of each pixel; nan where unknown."""
    aligned = patch.aligned
    return aligned.expected_m, aligned.expected_m - aligned.measured_m
