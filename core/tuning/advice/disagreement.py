"""How much both cameras disagree where they measure the same surface, and on which surface that is known."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from ...contact.alignment import make_alignment
from ...contact.checks import rig_in_use
from ...contact.membrane.bias import most_frequent_m, rig_bias
from ...contact.membrane.steps import firm_contact_bias
from ...contact.pixels import region_bounds
from ...errors import AdviceError
from ...model.arrays import Float32Array, Float64Array
from ...model.clouds import pixel_areas_m2
from ...model.frames import Rig, SensorFrame
from ...preset import Preset
from ...rig.bias import MeasuredBias, pressed_bias, print_bias
from ...sources.base import Progress
from .proposal import Evidence

#: Differences within this share of the distance belong to the peak.
PEAK_SHARE: Final = 0.02
#: Both cameras see the same scene if this share of the pixels with both depths lies in the peak. Behind an inflated
#: membrane no object is everywhere at one distance from it.
SAME_SCENE: Final = 0.5
#: Side of the blocks that count as independent, pixels, and fewest pixels of one.
_BLOCK_PX, _BLOCK_PIXELS = 40, 200
#: Fewest pixels with both depths.
_MIN_PIXELS: Final = 2000
#: Standard deviation of a bias that no area reduces, metres, and smallest painted contact, m^2.
_FLOOR_M, _MIN_PAINTED_M2 = 0.0002, 2e-4
#: Two biases disagree beyond this number of standard deviations.
_DISAGREE: Final = 3.0


@dataclass(frozen=True)
class DepthPeak:
    """The peak of the differences between proximity and tactile depth in one frame.

    Attributes
    ----------
    bias : MeasuredBias
        Proximity less tactile depth in the peak.
    share : float
        Share of the pixels with both depths that lie in the peak.
    distance_m : float
        Median proximity depth in the peak.
    """

    bias: MeasuredBias
    share: float
    distance_m: float

    @property
    def same_scene(self) -> bool:
        """Whether both cameras see the same scene, without a membrane between them."""
        return self.share >= SAME_SCENE


@dataclass(frozen=True)
class Disagreement:
    """A measured bias, words for the surface that both cameras see there, and whether that is the whole scene."""

    bias: MeasuredBias
    place: str
    same_scene: bool = False

    @classmethod
    def in_peak(cls, peak: DepthPeak) -> Disagreement:
        """Both cameras see the same scene."""
        return cls(peak.bias, f"in {100 * peak.share:.0f} % of the pixels that both cameras measure", same_scene=True)

    @classmethod
    def on_prints(cls, bias: MeasuredBias) -> Disagreement:
        """The proximity camera sees the membrane on prints."""
        return cls(bias, "on the prints of the mask's colour")

    @classmethod
    def in_firm_contact(cls, bias: MeasuredBias) -> Disagreement:
        """The membrane lies on an object."""
        return cls(bias, "in firm contact")


def depth_differences(frame: SensorFrame, preset: Preset, rig: Rig) -> tuple[Float32Array, Float32Array]:
    """Return the proximity depth, and the difference of both depths, for each proximity pixel; nan where unknown."""
    rig = rig_in_use(preset, rig)
    bounds = region_bounds(preset.region, rig.proximity.intrinsics.shape)
    aligned = make_alignment(preset.alignment, rig).align(frame.proximity_depth, frame.tactile_depth, bounds)
    return aligned.expected_m, aligned.expected_m - aligned.measured_m


def difference_peak(frame: SensorFrame, preset: Preset, rig: Rig) -> DepthPeak | None:
    """Return the peak of the differences between both depths; None if too few pixels have both.

    Raises
    ------
    RigMismatchError
        Neither preset nor rig has the pose between the cameras.
    """
    return peak_of(*depth_differences(frame, preset, rig))


def peak_of(expected: Float32Array, difference: Float32Array) -> DepthPeak | None:
    """Return the peak of `depth_differences`; None if too few pixels have both depths."""
    known = np.isfinite(difference)
    if np.count_nonzero(known) < _MIN_PIXELS:
        return None
    centre = most_frequent_m(difference[known])
    peak = known
    for _ in range(2):
        with np.errstate(invalid="ignore"):
            peak = known & (np.abs(difference - centre) < PEAK_SHARE * expected)
        centre = float(np.median(difference[peak]))
    share = np.count_nonzero(peak) / np.count_nonzero(known)
    blocks = np.array(list(_blocks(np.where(peak, difference, np.nan), expected)))
    bias = _fit(blocks, centre) if len(blocks) > 1 else MeasuredBias(centre, PEAK_SHARE * centre, "unknown")
    return DepthPeak(bias, share, float(np.median(expected[peak])))


def measure_disagreement(evidence: Evidence, progress: Progress) -> tuple[Disagreement, list[Disagreement]]:
    """Measure the bias between the cameras where both see the same surface.

    Returns
    -------
    best : Disagreement
        The most certain one.
    contradicting : list of Disagreement
        Those that differ from it by more than three standard deviations.

    Raises
    ------
    AdviceError
        No such surface: contact can't be told from bias.
    """
    preset, rig = evidence.preset, evidence.rig
    found: list[Disagreement] = []
    progress(0.1, "Comparing both depths")
    peak = difference_peak(evidence.frame, preset, rig)
    if peak is not None and peak.same_scene:
        found.append(Disagreement.in_peak(peak))
    else:
        power_m4 = rig_bias(preset.noise, rig).noise_m4
        free = [frame for frame in (evidence.untouched, *evidence.frames) if frame is not None]
        progress(0.3, "Measuring the bias on prints")
        if (bias := print_bias(free, rig, preset, power_m4)) is not None:
            found.append(Disagreement.on_prints(bias))
        progress(0.6, "Measuring the bias in contact")
        if (bias := _painted_bias(evidence, power_m4)) is not None:
            found.append(Disagreement(bias, "in painted contact"))
        elif (bias := pressed_bias(evidence.frames, firm_contact_bias(preset, rig), power_m4)) is not None:
            found.append(Disagreement.in_firm_contact(bias))
    if not found:
        raise AdviceError(
            "alignment: a bias between the cameras can't be told from a gap here; set the mask to the colour of prints "
            "that reflect infrared, press an object firmly (10 cm² or more), or paint the contact in a frame"
        )
    best, *others = sorted(found, key=lambda each: each.bias.sigma_m)
    return best, [other for other in others if _apart(best.bias, other.bias)]


def _blocks(difference: Float32Array, depth: Float32Array) -> Iterator[tuple[float, float]]:
    """Yield median difference and median depth of blocks that are mostly known."""
    height, width = difference.shape
    for top in range(0, height, _BLOCK_PX):
        for left in range(0, width, _BLOCK_PX):
            part = np.s_[top : top + _BLOCK_PX, left : left + _BLOCK_PX]
            known = np.isfinite(difference[part])
            if np.count_nonzero(known) >= _BLOCK_PIXELS:
                yield float(np.median(difference[part][known])), float(np.median(depth[part][known]))


def _fit(blocks: Float64Array, bias_m: float) -> MeasuredBias:
    """Return a bias with slope over depth, and the uncertainties that follow from the scatter between blocks."""
    difference, depth = blocks.T
    spread = float(np.std(depth))
    per_m = float(np.polyfit(depth, difference, 1)[0]) if spread > 0 else 0.0
    scatter = float(np.std(difference - per_m * (depth - depth.mean()))) / np.sqrt(len(blocks))
    sigma_m = float(np.hypot(scatter, _FLOOR_M))
    return MeasuredBias(bias_m, sigma_m, "unknown", per_m, scatter / spread if spread > 0 else 0.0, float(depth.mean()))


def _painted_bias(evidence: Evidence, power_m4: float) -> MeasuredBias | None:
    """Return the median difference in painted contact."""
    values, areas = [], []
    for example in evidence.examples:
        if example.contact is None:
            continue
        expected, difference = depth_differences(example.frame, evidence.preset, evidence.rig)
        inside = example.contact & np.isfinite(difference)
        area_m2 = float(pixel_areas_m2(expected[inside], evidence.rig.proximity.intrinsics).sum())
        if area_m2 >= _MIN_PAINTED_M2:
            values.append(float(np.median(difference[inside])))
            areas.append(area_m2)
    if not values:
        return None
    sigma_m = float(np.hypot(np.sqrt(power_m4 / sum(areas)), _FLOOR_M))
    return MeasuredBias(float(np.average(values, weights=areas)), sigma_m, "contact")


def _apart(first: MeasuredBias, second: MeasuredBias) -> bool:
    return abs(first.bias_m - second.bias_m) > _DISAGREE * float(np.hypot(first.sigma_m, second.sigma_m))
