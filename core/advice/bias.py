"""The bias between both cameras in one frame, and the depth offset that removes it.

Three kinds of pixels show one surface to both cameras: prints of the mask's colour, firm contact, and any surface that
fills most of the image. The last needs no membrane. A gap between a bulged membrane and an object differs from place to
place, so a single peak that holds most of the differences is a bias.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from ..contact.masking import colors_at, in_hsv_range
from ..contact.membrane.bias import rig_bias
from ..errors import RigMismatchError
from ..model.arrays import Float32Array
from ..model.clouds import deproject
from ..model.frames import Rig, SensorFrame
from ..model.patch import ContactPatch
from ..preset import Preset
from ..rig.noise import print_bias
from .proposal import Proposal

#: Step between the rows and columns that are read.
_STRIDE: Final = 4
#: Largest bias that is looked for, metres; the depth offset allows no larger one.
_MAX_BIAS_M: Final = 0.1
#: Bins of the histogram of differences, metres, and sigma of its smoothing, bins.
_BIN_M, _SMOOTH_BINS = 0.0005, 2.0
#: Differences within the first around the peak belong to it, metres; their share of all differences must exceed the
#: second.
_PEAK_M, _MIN_PEAK_SHARE = 0.008, 0.5
#: Fewest read pixels with both depths, and on prints.
_MIN_PIXELS, _MIN_PRINT_PIXELS = 500, 20
#: Largest difference on prints, metres, as in `print_bias`.
_MAX_ON_PRINTS_M: Final = 0.04


@dataclass(frozen=True)
class BiasInFrame:
    """The bias between both cameras.

    Attributes
    ----------
    bias_m : float
        Proximity less tactile depth on the same surface, after the preset's depth scale and offset, metres.
    sigma_m : float
        Its standard deviation.
    distance_m : float
        Distance of that surface.
    seen_on : {"prints", "contact", "surface"}
        prints: of the mask's colour. contact: firm contact. surface: one that fills most of the image.
    share : float
        Share of all pixels with both depths that show this surface; nan unless ``seen_on`` is "surface".
    """

    bias_m: float
    sigma_m: float
    distance_m: float
    seen_on: Literal["prints", "contact", "surface"]
    share: float = math.nan

    @property
    def relative(self) -> float:
        """The bias over the distance."""
        return self.bias_m / self.distance_m


def bias_in_frame(
    frame: SensorFrame, patch: ContactPatch, preset: Preset, rig: Rig, above_m: float = 0.0
) -> BiasInFrame | None:
    """Measure the bias between both cameras in a frame; None where it cannot be told from a gap.

    Parameters
    ----------
    patch : ContactPatch
        That of the frame and preset.
    above_m : float
        A bias on prints that is clearly smaller is not measured, which saves some 15 ms; None is returned then.
    """
    return _on_prints(frame, patch, preset, rig, above_m) or _in_contact(patch, preset, rig) or _on_surface(patch)


def offset_proposal(bias: BiasInFrame, preset: Preset) -> Proposal | None:
    """Return the change of the depth offset that removes a bias; None beyond what the preset allows.

    A bias that was measured with the rig holds after the offset, so it changes with it.
    """
    change_m = round(bias.bias_m, 4)
    offset_m = round(preset.alignment.depth_offset_m + change_m, 4)
    if abs(offset_m) > _MAX_BIAS_M or change_m == 0:
        return None
    changes: dict[str, object] = {"alignment.depth_offset_m": offset_m}
    if preset.noise is not None and preset.noise.bias_from != "unknown":
        changes["noise"] = preset.noise.model_dump() | {"bias_m": preset.noise.bias_m - change_m}
    return Proposal(
        section="alignment",
        changes=changes,
        label=f"Depth offset {1e3 * change_m:+.1f} mm",
        evidence=describe(bias),
        expected=f"Both cameras agree at {bias.distance_m:.2f} m: the peak of the histogram moves to 0.",
    )


def describe(bias: BiasInFrame) -> str:
    """Return the bias as one sentence."""
    farther = "farther" if bias.bias_m > 0 else "nearer"
    where = {
        "prints": "on prints of the mask's colour",
        "contact": "in firm contact",
        "surface": f"in {bias.share:.0%} of the pixels",
    }[bias.seen_on]
    return (
        f"The proximity camera reads {1e3 * abs(bias.bias_m):.1f} ± {1e3 * bias.sigma_m:.1f} mm "
        f"({abs(bias.relative):.1%}) {farther} than the tactile camera {where}."
    )


def _on_prints(frame: SensorFrame, patch: ContactPatch, preset: Preset, rig: Rig, above_m: float) -> BiasInFrame | None:
    """Measure the bias on prints of the mask's colour."""
    if not preset.mask.enabled:
        return None
    expected_m, difference_m = _read(patch)
    height, width = patch.aligned.expected_m.shape
    pixels = np.arange(height * width).reshape(height, width)[::_STRIDE, ::_STRIDE]
    near = np.abs(difference_m) < _MAX_ON_PRINTS_M
    points = deproject(frame.proximity_depth, rig.proximity, pixels[near])
    colors, seen = colors_at(points, pixels[near], frame.proximity_color, rig)
    marked = seen & in_hsv_range(colors, preset.mask)
    found = difference_m[near][marked]
    if len(found) < _MIN_PRINT_PIXELS or abs(float(np.median(found))) < 0.7 * above_m:
        return None
    try:
        measured = print_bias([frame], rig, preset, rig_bias(preset, rig).noise_m4)
    except RigMismatchError:  # a homography without a pose
        return None
    if measured is None:
        return None
    return BiasInFrame(measured.bias_m, measured.sigma_m, float(np.median(expected_m[near][marked])), "prints")


def _in_contact(patch: ContactPatch, preset: Preset, rig: Rig) -> BiasInFrame | None:
    """Return the bias that the membrane test found in firm contact."""
    facts = patch.membrane
    if facts is None or facts.firm_m2 == 0 or not len(patch.points):
        return None
    known = rig_bias(preset, rig)
    sigma_m = math.sqrt(known.noise_m4 / facts.firm_m2 + known.gap_sigma_m**2)
    return BiasInFrame(facts.bias_m, sigma_m, float(np.median(patch.points[:, 2])), "contact")


def _on_surface(patch: ContactPatch) -> BiasInFrame | None:
    """Return the peak of the differences, if it holds most of them."""
    expected_m, difference_m = _read(patch)
    usable = np.isfinite(difference_m)
    difference_m, expected_m = difference_m[usable], expected_m[usable]
    within = difference_m[np.abs(difference_m) < _MAX_BIAS_M]
    if len(within) < max(_MIN_PIXELS, _MIN_PEAK_SHARE * len(difference_m)):
        return None
    counts, edges = np.histogram(within, round(2 * _MAX_BIAS_M / _BIN_M), (-_MAX_BIAS_M, _MAX_BIAS_M))
    window = np.exp(-0.5 * (np.arange(-6, 7) / _SMOOTH_BINS) ** 2)
    mode_m = float(edges[int(np.argmax(np.convolve(counts, window, "same")))]) + _BIN_M / 2
    peak = np.abs(difference_m - np.float32(mode_m)) < _PEAK_M
    share = float(peak.mean())
    if share <= _MIN_PEAK_SHARE:
        return None
    bias_m = float(np.median(difference_m[peak]))
    sigma_m = math.hypot(bias_m - mode_m, _BIN_M)  # a peak that is not symmetric is uncertain
    return BiasInFrame(bias_m, sigma_m, float(np.median(expected_m[peak])), "surface", share)


def _read(patch: ContactPatch) -> tuple[Float32Array, Float32Array]:
    """Return the expected depth and the difference of both depths of the pixels that are read, nan without depth."""
    expected_m = patch.aligned.expected_m[::_STRIDE, ::_STRIDE]
    return expected_m, expected_m - patch.aligned.measured_m[::_STRIDE, ::_STRIDE]
