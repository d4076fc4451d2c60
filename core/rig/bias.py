"""The bias between both cameras: what the proximity camera reads farther than the tactile one on the same surface."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from ..contact.alignment import AlignmentModel, make_alignment
from ..contact.kernels.chain import Region
from ..contact.masking import colors_at, in_hsv_range
from ..errors import minus
from ..model.clouds import deproject, pixel_areas_m2, valid_depth
from ..model.frames import Rig, SensorFrame
from ..model.rig_noise import BiasOrigin
from ..model.robust import spread
from ..preset import MaskSection, Preset

#: Area of firm contact below which a frame tells nothing about the bias, m^2.
MIN_CONTACT_M2: Final = 1e-3
#: Standard deviation of a bias that was not measured, metres.
UNKNOWN_BIAS_M: Final = 0.005

#: Finds firm contact in a frame and returns the bias there, metres, and its area, m^2; None without contact.
ContactBias = Callable[[SensorFrame], tuple[float, float] | None]

#: Prints: how far their rim is eroded, fewest pixels of one, largest bias, and largest scatter between prints.
_PRINT_RIM_PX, _PRINT_PIXELS, _MAX_BIAS_M, _MAX_SCATTER_M = 5, 60, 0.04, 0.006
#: Standard deviation of the bias that no area reduces, metres.
_BIAS_FLOOR_M: Final = 0.0002
#: Smallest range of depth that tells the slope of the bias, metres.
_MIN_RANGE_M: Final = 0.040
#: Two biases disagree beyond this number of standard deviations.
_DISAGREE: Final = 3.0
#: Prints whose bias is off by more than this number of robust standard deviations do not count.
_TRIM: Final = 5.0


@dataclass(frozen=True)
class MeasuredBias:
    """The bias between both cameras.

    Attributes
    ----------
    bias_m, sigma_m : float
        Value and standard deviation, metres.
    origin : {"prints", "contact", "unknown"}
    per_m, per_m_sigma : float
        Slope per metre of depth, 0 if the range of depth is too small to tell, and its standard deviation.
    depth_m : float
        Mean depth that a slope refers to.
    """

    bias_m: float
    sigma_m: float
    origin: BiasOrigin
    per_m: float = 0.0
    per_m_sigma: float = 0.0
    depth_m: float = 0.0


def print_bias(frames: Sequence[SensorFrame], rig: Rig, preset: Preset, density_m4: float) -> MeasuredBias | None:
    """Return the bias on prints of the mask's colour, where the proximity camera sees the membrane itself, or None.

    Parameters
    ----------
    frames : sequence of SensorFrame
    rig : Rig
    preset : Preset
        Without a mask there are no prints.
    density_m4 : float
        Noise power per area of the difference of both depths.

    Raises
    ------
    RigMismatchError
        Neither preset nor rig has the pose between the cameras.
    """
    if not preset.mask.enabled or not frames:
        return None
    alignment = make_alignment(preset.alignment, rig)
    prints = [found for frame in frames for found in _prints(frame, rig, preset.mask, alignment)]
    if not prints:
        return None
    bias_m, depth_m, area_m2 = np.array(prints).T
    centre = float(np.median(bias_m))
    scatter = spread(bias_m, centre)
    if scatter > _MAX_SCATTER_M:
        return None  # the proximity camera looks through this colour
    kept = np.abs(bias_m - centre) <= _TRIM * scatter + 2 * _BIAS_FLOOR_M
    bias_m, depth_m, area_m2 = bias_m[kept], depth_m[kept], area_m2[kept]
    per_m, away_m = 0.0, np.zeros_like(bias_m)
    mean_m, mean_depth_m = (float(np.average(values, weights=area_m2)) for values in (bias_m, depth_m))
    each_frame = max(len(bias_m) / len(frames), 1.0)
    if np.ptp(depth_m) >= _MIN_RANGE_M:
        per_m = float(np.polyfit(depth_m, bias_m, 1, w=np.sqrt(area_m2))[0])
        away_m = per_m * (depth_m - mean_depth_m)
    between = float(np.std(bias_m - away_m)) / np.sqrt(each_frame)
    noise = np.sqrt(density_m4 / (area_m2.sum() / len(frames)))
    sigma_m = float(np.hypot(max(noise, between), _BIAS_FLOOR_M))
    per_m_sigma = max(noise, between) / float(np.std(depth_m)) if per_m else 0.0
    return MeasuredBias(mean_m, sigma_m, "prints", per_m, per_m_sigma, mean_depth_m)


def _prints(
    frame: SensorFrame, rig: Rig, mask: MaskSection, alignment: AlignmentModel
) -> Iterator[tuple[float, float, float]]:
    """Yield median bias, median depth and area of each print, metres and m^2."""
    camera = rig.proximity
    height, width = camera.intrinsics.shape
    aligned = alignment.align(frame.proximity_depth, frame.tactile_depth, Region(0, 0, width, height))
    with np.errstate(invalid="ignore"):
        difference = aligned.expected_m - aligned.measured_m
        near = np.abs(difference) < _MAX_BIAS_M
    pixels = np.flatnonzero(near & valid_depth(frame.proximity_depth))
    colors, seen = colors_at(deproject(frame.proximity_depth, camera, pixels), pixels, frame.proximity_color, rig)
    marked = np.zeros(height * width, np.uint8)
    marked[pixels] = seen & in_hsv_range(colors, mask)
    image = cv2.medianBlur(marked.reshape(height, width), 5)  # closes pixels without depth
    inner = cv2.erode(image, np.ones((_PRINT_RIM_PX, _PRINT_RIM_PX), np.uint8))
    _, labels, stats, _ = cv2.connectedComponentsWithStats(inner)
    depth_m = frame.proximity_depth * np.float32(camera.depth_unit_m)
    areas = pixel_areas_m2(depth_m, camera.intrinsics)
    for label, (left, top, wide, high, _) in enumerate(stats[1:], start=1):
        box = slice(top, top + high), slice(left, left + wide)
        inside = (labels[box] == label) & near[box]
        if inside.sum() >= _PRINT_PIXELS:
            found = difference[box][inside], depth_m[box][inside], areas[box][inside]
            yield float(np.median(found[0])), float(np.median(found[1])), float(found[2].sum())


def pressed_bias(frames: Sequence[SensorFrame], contact_bias: ContactBias, density_m4: float) -> MeasuredBias | None:
    """Return the bias where an object is pressed firmly into the membrane; None without a frame of enough contact."""
    found = [contact for frame in frames if (contact := contact_bias(frame)) is not None]
    firm = np.array([contact for contact in found if contact[1] >= MIN_CONTACT_M2])
    if not len(firm):
        return None
    noise = np.sqrt(density_m4 / np.median(firm[:, 1]))
    return MeasuredBias(float(np.median(firm[:, 0])), float(np.hypot(noise, _BIAS_FLOOR_M)), "contact")


def choose_bias(found: Sequence[MeasuredBias], warn: Callable[[str], None]) -> MeasuredBias:
    """Return the most certain bias; warn if two disagree."""
    if not found:
        return MeasuredBias(0.0, UNKNOWN_BIAS_M, "unknown")
    best, *others = sorted(found, key=lambda bias: bias.sigma_m)
    for other in others:
        if abs(other.bias_m - best.bias_m) > _DISAGREE * np.hypot(other.sigma_m, best.sigma_m):
            warn(
                f"Two measurements of the bias disagree: {_numbers(best)} on {best.origin} and {_numbers(other)} on "
                f"{other.origin}; the first is used. Check the mask and the alignment."
            )
    return best


def describe_bias(bias: MeasuredBias) -> str:
    """Return the bias in a sentence."""
    if bias.origin == "unknown":
        return (
            "The bias between the cameras could not be told from a gap: press an object firmly (10 cm2 or more) and "
            "measure again."
        )
    slope = f", and {abs(bias.per_m) * 100:.1f} mm {'more' if bias.per_m > 0 else 'less'} per 100 mm of depth"
    return (
        f"The proximity camera reads {1e3 * abs(bias.bias_m):.1f} ± {1e3 * bias.sigma_m:.1f} mm "
        f"{'farther' if bias.bias_m >= 0 else 'nearer'} than the tactile camera{slope if bias.per_m else ''} "
        f"(measured on {bias.origin})."
    )


def _numbers(bias: MeasuredBias) -> str:
    return minus(f"{1e3 * bias.bias_m:+.1f}") + f" ± {1e3 * bias.sigma_m:.1f} mm"
