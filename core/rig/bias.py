"""The bias between both cameras: what the proximity camera reads farther than the tactile one on the same surface.

It is known only where both see the same surface: on prints of the membrane, which reflect infrared; where an object is
pressed firmly into the membrane; or all over the image, if there is no membrane. Elsewhere a gap looks like a bias.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import cv2
import numpy as np

from ..contact.alignment import make_alignment
from ..contact.masking import in_hsv_range
from ..contact.membrane.frame_bias import most_frequent_m
from ..contact.pixels import colors_at, region_bounds
from ..errors import minus
from ..model.arrays import Float32Array, spread
from ..model.clouds import deproject, pixel_areas_m2, valid_depth
from ..model.frames import Rig, SensorFrame
from ..preset import MaskSection, Preset

#: Standard deviation of the bias that no area reduces, metres.
_BIAS_FLOOR_M: Final = 0.0002

#: Prints: how far their rim is eroded, fewest pixels of one, largest bias, and largest scatter between prints.
_PRINT_RIM_PX, _PRINT_PIXELS, _MAX_BIAS_M, _MAX_SCATTER_M = 5, 60, 0.04, 0.006
#: Smallest range of depth that tells the slope of the bias, metres.
_MIN_RANGE_M: Final = 0.040
#: Prints whose bias is off by more than this number of robust standard deviations do not count.
_TRIM: Final = 5.0
#: Both cameras see the same scene if this share of the pixels with both depths differs by one bias, within a share of
#: the distance. Behind an inflated membrane no object is everywhere at one distance from it.
SAME_SCENE, _PEAK_SHARE = 0.5, 0.02
#: Fewest pixels with both depths; side of the blocks that count as independent, pixels, and fewest pixels of one.
_MIN_PIXELS, _BLOCK_PX, _BLOCK_PIXELS = 2000, 40, 200
#: Step between the rows and columns that tell at first whether it is one scene.
_STRIDE: Final = 4


@dataclass(frozen=True)
class MeasuredBias:
    """The bias between both cameras and its standard deviation, metres.

    ``per_m`` is its slope per metre of depth, 0 if the range of depth is too small to tell; ``share`` is that of a
    scene's pixels with both depths that have this bias.
    """

    bias_m: float
    sigma_m: float
    origin: Literal["prints", "contact", "scene", "unknown"]
    per_m: float = 0.0
    share: float = 0.0

    @property
    def place(self) -> str:
        """Where it was measured, in words."""
        return {
            "prints": "on the prints of the mask's colour",
            "contact": "in firm contact",
            "scene": f"in {100 * self.share:.0f} % of the pixels that both cameras measure",
            "unknown": "nowhere",
        }[self.origin]


def depth_differences(frame: SensorFrame, preset: Preset, rig: Rig) -> tuple[Float32Array, Float32Array]:
    """Return the proximity depth, and the difference of both depths, for each proximity pixel; nan where unknown.

    Raises a `RigMismatchError` if neither preset nor rig has the pose between the cameras.
    """
    bounds = region_bounds(preset.region, rig.proximity.intrinsics.shape)
    aligned = make_alignment(preset.alignment, rig).align(frame.proximity_depth, frame.tactile_depth, bounds)
    return aligned.expected_m, aligned.expected_m - aligned.measured_m


def scene_bias(expected_m: Float32Array, difference_m: Float32Array, min_relief: float = 0.0) -> MeasuredBias | None:
    """Return the bias over the whole image, from `depth_differences`; None if a membrane is between the cameras.

    Between a flat membrane and a flat object behind it the gap is the same everywhere, too: the depth of the scene must
    vary by ``min_relief`` times the bias.
    """
    some = difference_m[::_STRIDE, ::_STRIDE]
    centre = most_frequent_m(some[np.isfinite(some)])
    for image, depth in ((some, expected_m[::_STRIDE, ::_STRIDE]), (difference_m, expected_m)):
        known = np.isfinite(image)
        with np.errstate(invalid="ignore"):
            peak = np.abs(image - centre) < _PEAK_SHARE * depth
        if np.count_nonzero(peak) < max(SAME_SCENE * np.count_nonzero(known), 1):
            return None
        centre = float(np.median(image[peak]))
    near_m, far_m = np.percentile(expected_m[peak], (5, 95))
    if np.count_nonzero(known) < _MIN_PIXELS or far_m - near_m < min_relief * abs(centre):
        return None
    share = np.count_nonzero(peak) / np.count_nonzero(known)
    blocks = []
    for top in range(0, peak.shape[0], _BLOCK_PX):
        for left in range(0, peak.shape[1], _BLOCK_PX):
            part = np.s_[top : top + _BLOCK_PX, left : left + _BLOCK_PX]
            if np.count_nonzero(peak[part]) >= _BLOCK_PIXELS:
                blocks.append([np.median(image[part][peak[part]]) for image in (difference_m, expected_m)])
    if len(blocks) < 2:
        return MeasuredBias(centre, _PEAK_SHARE * near_m, "scene", share=share)
    difference, depth = np.array(blocks, np.float64).T
    wide = float(np.std(depth))
    per_m = float(np.polyfit(depth, difference, 1)[0]) if wide > 0 else 0.0
    scatter = float(np.std(difference - per_m * (depth - depth.mean()))) / np.sqrt(len(blocks))
    sigma_m = float(np.hypot(scatter, _BIAS_FLOOR_M))
    return MeasuredBias(centre, sigma_m, "scene", per_m, share)


def print_bias(
    frames: Sequence[SensorFrame],
    rig: Rig,
    preset: Preset,
    density_m4: float,
    difference_m: Float32Array | None = None,
) -> MeasuredBias | None:
    """Return the bias on prints of the mask's colour, where the proximity camera sees the membrane itself, or None.

    ``density_m4`` is the noise power per area of the difference of both depths; ``difference_m`` is that of a single
    frame, where it is known.
    """
    if not preset.mask.enabled or not frames:
        return None
    whole = preset.with_value("region.enabled", False)
    prints: list[tuple[float, float, float]] = []
    for frame in frames:
        difference = depth_differences(frame, whole, rig)[1] if difference_m is None else difference_m
        prints += _prints(frame, rig, preset.mask, difference)
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
    return MeasuredBias(mean_m, sigma_m, "prints", per_m)


def _prints(
    frame: SensorFrame, rig: Rig, mask: MaskSection, difference: Float32Array
) -> Iterator[tuple[float, float, float]]:
    """Yield median bias, median depth and area of each print, metres and m^2."""
    camera = rig.proximity
    height, width = camera.intrinsics.shape
    with np.errstate(invalid="ignore"):
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


def pressed_bias(
    contacts: Iterable[tuple[float, float] | None], density_m4: float, floor_m: float = _BIAS_FLOOR_M
) -> MeasuredBias | None:
    """Return the bias of frames from those in firm contact, metres, and its area, m^2; None without enough contact."""
    firm = np.array([contact for contact in contacts if contact is not None])
    if not len(firm):
        return None
    noise = np.sqrt(density_m4 / np.median(firm[:, 1]))
    return MeasuredBias(float(np.median(firm[:, 0])), float(np.hypot(noise, floor_m)), "contact")


def describe_bias(bias: MeasuredBias) -> str:
    if bias.origin == "unknown":
        return "The bias could not be told from a gap: press an object firmly (1,000 mm² or more) and measure again."
    slope = f", and {abs(bias.per_m) * 100:.1f} mm {'more' if bias.per_m > 0 else 'less'} per 100 mm of depth"
    return (
        f"Bias between the cameras: {minus(f'{1e3 * bias.bias_m:+z.1f}')} ± {1e3 * bias.sigma_m:.1f} mm, proximity "
        f"{'farther' if bias.bias_m >= 0 else 'nearer'}{slope if bias.per_m else ''}, measured {bias.place}."
    )
