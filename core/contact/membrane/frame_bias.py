"""The bias between both cameras in one frame: from the rig, and from the frame where contact is firm.

In contact both cameras measure the same surface, so the bias is the median difference there. But where contact is
depends on the bias. Both are unknowns of one problem, which is solved by alternation: solve the obstacle problem for a
bias, then correct the bias by the median residual in contact. The first bias is too large on purpose: then too much
touches, and contact shrinks. With a bias that is too small nothing may touch, and there is no residual.

Where nothing presses, a bias can't be told from a gap: the free membrane above an object looks the same for any bias.
So the bias of a small contact is the rig's measured bias.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from ...model.arrays import Float32Array
from ...model.frames import Rig
from ...model.rig_noise import CameraNoise, RigNoise
from ..kernels.cells import Differences, MembraneImage
from .equilibrium import CELL_PX, GUESS_PX, Cells, Equilibrium, cells_of, settle, surroundings
from .section import LARGEST_BIAS_M

#: For the search for the bias: side of a grid cell, pixels; sigma of the window over the object's shape, pixels; length
#: over which equilibrium is trusted, metres.
COARSE_CELL_PX: Final = 8
_SHAPE_PX: Final = 6.0
_TRUST_M: Final = 0.03
#: The search begins above the most frequent difference by the first; differences nearer than the second to the start
#: take part. Metres.
_START_ABOVE_M: Final = 0.002
_NEAR_M: Final = 0.012
#: The part of the image near a bias serves for another one within this distance, metres.
_SAME_M: Final = 0.004
#: Step between rows and columns that are read where every pixel is not needed. It is odd, so depth that is missing in
#: every second or fourth row or column does not hide the rest.
_STRIDE_PX: Final = 5
SOME: Final = (slice(None, None, _STRIDE_PX),) * 2
#: Bin width of the histogram of differences, metres, and sigma of its smoothing, bins.
_BIN_M, _SMOOTH_BINS = 0.0005, 1.5
#: Contact is firm from this area on: its bias is measured without the rig's.
FIRM_M2: Final = 0.001
#: The search ends when the bias changes by less, metres, or after this number of rounds.
_EXACT_M: Final = 3e-5
_MAX_ROUNDS: Final = 12
#: The frame's bias replaces the rig's where they differ by more than this many standard deviations.
_DISAGREE: Final = 3.0
#: Then contact must be larger than firm contact by this factor; larger ones are less likely noise.
_REPLACING: Final = 2.0
#: Assumed for a rig that was not measured: noise power of a D405 and an L515 at 0.3 m, m^4, and standard deviation of
#: the bias, metres.
_USUAL_NOISE_M4: Final = 1.23e-10
UNKNOWN_BIAS_M: Final = 0.005
#: Lower limits of the noise power, m^4, and of a pixel's standard deviation, metres, for errors of the model.
_MIN_NOISE_M4, _MIN_PIXEL_SIGMA_M = 1e-11, 0.0001
#: Systematic error of a bias measured on prints, metres, and fewest pixels on prints that tell it.
_PRINT_SIGMA_M: Final = 0.0003
_MIN_PRINT_PIXELS: Final = 40
#: On prints most differences agree with their most frequent one within this number of standard deviations of a pixel;
#: where fewer than the second share do, the proximity camera looks through the mask's colour.
_PRINT_SIGMAS, _MIN_AGREEING = 2.5, 0.5


@dataclass(frozen=True)
class RigBias:
    """What is known of the bias, proximity less tactile depth, before a frame is seen."""

    mean_m: float
    sigma_m: float
    noise_m4: float  # Noise power of both cameras at low spatial frequency: the variance of a mean times its area
    measured: bool  # Whether the rig's noise and bias were measured
    tactile_weight: float = 0.5  # Weight of the tactile depth in a mean of both depths, from both cameras' noise
    gap_sigma_m: float = 0.0011  # Standard deviation of a gap averaged over a window of `GUESS_PX`
    pixel_sigma_m: float = 0.0013  # Standard deviation of the gap of one pixel

    @property
    def tactile_m4(self) -> float:
        """Noise power of the tactile camera."""
        return (1 - self.tactile_weight) * self.noise_m4

    def length_m(self, usual_m: float) -> float:
        """Return the length over which equilibrium is trusted, from that at the usual noise.

        A measured gap of noise power S (m^4) against a curvature of error power E (dimensionless): both count the same
        at wavelengths of about (S / E)^(1/4).
        """
        return float(usual_m * (self.noise_m4 / _USUAL_NOISE_M4) ** 0.25)


@dataclass(frozen=True)
class FrameBias:
    """The bias in one frame."""

    bias_m: float = 0.0  # Bias of the differences, beyond the `Differences.bias_m` that was subtracted
    firm_m2: float = 0.0  # Area of the firm contact that it was measured in; 0 if it follows from the rig's bias
    known: bool = True  # Whether firm contact, the measured rig or prints tell it
    seen: bool = False  # Whether prints tell it in this frame
    sigma_m: float = 0.0  # Its standard deviation
    change_m: float = 0.0  # By how much prints disagree with the rig's bias; 0 if they agree or there are none


def rig_bias(noise: RigNoise | None, rig: Rig) -> RigBias:
    """Return what is known of the bias and the noise of a rig, measured or not."""
    if noise is None:
        return RigBias(0.0, UNKNOWN_BIAS_M, _USUAL_NOISE_M4, measured=False)
    proximity = noise.proximity.density_m4(rig.proximity.intrinsics.fx)
    tactile = noise.tactile.density_m4(rig.tactile.intrinsics.fx)
    power = max(proximity + tactile, _MIN_NOISE_M4)
    measured = noise.bias_from != "unknown"
    weight = (proximity + _MIN_NOISE_M4 / 2) / (proximity + tactile + _MIN_NOISE_M4)
    gap_sigma_m = math.hypot(_after_window_m(noise.proximity), _after_window_m(noise.tactile))
    pixel_sigma_m = max(math.hypot(noise.proximity.total_m, noise.tactile.total_m), _MIN_PIXEL_SIGMA_M)
    sigma_m = max(noise.bias_sigma_m, _PRINT_SIGMA_M)
    return RigBias(noise.bias_m, sigma_m, power, measured, weight, gap_sigma_m, pixel_sigma_m)


def _after_window_m(noise: CameraNoise) -> float:
    """Return the standard deviation of a camera's depth averaged over a Gaussian window of `GUESS_PX`."""
    window = GUESS_PX**2
    shared = noise.length_px**2 / (noise.length_px**2 + window)
    return math.sqrt(noise.white_m**2 / (4 * math.pi * window) + noise.correlated_m**2 * shared)


def frame_bias(
    differences: Differences, membrane: MembraneImage, known: RigBias, free_per_m: float, rig: Rig
) -> tuple[FrameBias, Differences | None]:
    """Return the bias in a frame, and the part of the differences with pixels near it or near the search's start."""

    def cells_near(part: Differences | None, centre_m: float) -> Cells | None:
        limits_m = centre_m, _NEAR_M
        return None if part is None else cells_of(part, membrane, COARSE_CELL_PX, _SHAPE_PX, free_per_m, limits_m, rig)

    prior, stated_m, change_m = _with_prints(known, differences, rig)
    seen, change_m = change_m is not None, change_m or 0.0
    start_m = most_frequent_m(differences.difference_m[SOME][differences.usable[SOME]]) + _START_ABOVE_M
    near = _near(differences, start_m)
    if (cells := cells_near(near, start_m)) is not None:
        bias_m, area_m2 = _joint(cells, start_m, None)
        agrees = abs(bias_m - prior.mean_m) < _DISAGREE * math.sqrt(prior.sigma_m**2 + _variance_m2(known, FIRM_M2))
        proved = area_m2 >= (FIRM_M2 if agrees else _REPLACING * FIRM_M2)
        if proved and abs(bias_m + differences.bias_m) <= LARGEST_BIAS_M:
            variance = _variance_m2(known, area_m2)
            if agrees:
                both = 1 / (1 / variance + 1 / prior.sigma_m**2)
                bias_m = both * (bias_m / variance + prior.mean_m / prior.sigma_m**2)
                variance = 1 / (1 / variance + 1 / stated_m**2)
            else:  # contact speaks against the prints, too
                seen, change_m = False, 0.0
            return FrameBias(bias_m, area_m2, True, seen, math.sqrt(variance), change_m), near
    bias_m = prior.mean_m
    if near is None or abs(bias_m - start_m) > _SAME_M:
        near = _near(differences, bias_m)
    # small contact does not tell a measured bias better
    if not prior.measured and (cells := cells_near(near, bias_m)) is not None:
        bias_m, _ = _joint(cells, bias_m, prior)
    return FrameBias(bias_m, 0.0, prior.measured, seen, stated_m, change_m), near


def _with_prints(known: RigBias, differences: Differences, rig: Rig) -> tuple[RigBias, float, float | None]:
    """Return the bias relative to that of the differences, from the rig and from prints, and how far they disagree.

    Both are combined by their variances. Where they disagree for certain, the bias has changed, and prints count alone.
    The second is the standard deviation with the error of prints, which both share; `RigBias.sigma_m`, without it,
    weighs the bias against that of contact. Without prints the third is None.
    """
    rigs = replace(known, mean_m=known.mean_m - differences.bias_m)
    prints, depth = differences.on_prints_m, differences.counts[SOME]
    if len(prints) < _MIN_PRINT_PIXELS or not depth.any():
        return rigs, rigs.sigma_m, None
    centre_m = most_frequent_m(prints)
    agreeing = prints[np.abs(prints - np.float32(centre_m)) < _PRINT_SIGMAS * known.pixel_sigma_m]
    if len(agreeing) < max(_MIN_AGREEING * len(prints), _MIN_PRINT_PIXELS):
        return rigs, rigs.sigma_m, None
    pixel_m = float(np.median(differences.depth_m(depth[depth > 0]))) / rig.proximity.intrinsics.fx
    sigma_m = math.sqrt(known.noise_m4 / (len(agreeing) * (_STRIDE_PX * pixel_m) ** 2)) + _PRINT_SIGMA_M
    mean_m = float(np.median(agreeing))
    change_m = mean_m - rigs.mean_m
    if not known.measured or abs(change_m) > _DISAGREE * math.hypot(sigma_m, known.sigma_m):
        alone = replace(rigs, mean_m=mean_m, sigma_m=sigma_m, measured=True)
        return alone, sigma_m, change_m if known.measured else 0.0
    # what the errors of both do not explain is drift since the rig was measured
    rig_m2, prints_m2 = known.sigma_m**2 + max(change_m**2 - sigma_m**2 - known.sigma_m**2, 0.0), sigma_m**2
    weight = rig_m2 / (rig_m2 + prints_m2)
    stated_m2 = weight * prints_m2 + 2 * weight * (1 - weight) * _PRINT_SIGMA_M**2
    both = replace(rigs, mean_m=rigs.mean_m + weight * change_m, sigma_m=math.sqrt(weight * prints_m2))
    return both, math.sqrt(stated_m2), 0.0


def most_frequent_m(differences_m: Float32Array) -> float:
    """Return the most frequent of some differences, shape (N,), metres; 0 without any."""
    import cv2

    if len(differences_m) == 0:
        return 0.0
    low = float(differences_m.min()) - _BIN_M
    counts = np.bincount(((differences_m - low) / _BIN_M).astype(np.int64)).astype(np.float32)
    smooth = cv2.GaussianBlur(counts[None], (0, 0), _SMOOTH_BINS, borderType=cv2.BORDER_CONSTANT)[0]
    return low + (int(np.argmax(smooth)) + 0.5) * _BIN_M


def _near(differences: Differences, centre_m: float) -> Differences | None:
    """Return the part of the differences with all pixels near a difference; None without any."""
    near = differences.usable[SOME] & (np.abs(differences.difference_m[SOME] - np.float32(centre_m)) < _NEAR_M)
    if (box := surroundings(near, 2)) is None:
        return None
    grid = math.lcm(COARSE_CELL_PX, CELL_PX)  # so that the cells are the same wherever the part begins
    return differences.cut(*(slice(side.start * _STRIDE_PX // grid * grid, side.stop * _STRIDE_PX) for side in box))


def _variance_m2(known: RigBias, area_m2: float) -> float:
    """Return the variance of a bias from contact of an area."""
    # noise that is taken for contact hides a gap, but hardly one as wide as large contact
    hidden_m = known.gap_sigma_m * min(_REPLACING * FIRM_M2 / area_m2, 1.0)
    return known.noise_m4 / area_m2 + hidden_m**2


def _joint(cells: Cells, bias_m: float, prior: RigBias | None) -> tuple[float, float]:
    """Return bias and contact area that agree with each other, from a first guess of the bias.

    Without a prior the guess must be too large; then contact shrinks, and the search ends where it is not firm.
    """
    solution: Equilibrium | None = None
    area_m2 = 0.0
    for _ in range(_MAX_ROUNDS):
        solution = settle(cells, bias_m, _TRUST_M, solution)
        along_ray = (solution.residual_m / cells.facing)[solution.touching]
        area_m2 = float(cells.area_m2[solution.touching].sum())
        if prior is None and area_m2 < FIRM_M2:
            break
        # the median: cells at the edge of contact are partly open
        middle = len(along_ray) // 2
        shift = float(np.partition(along_ray, middle)[middle]) if len(along_ray) else 0.0
        if prior is not None:
            weight = area_m2 * _variance_m2(prior, area_m2) / prior.sigma_m**2 if area_m2 > 0 else 1.0
            shift = (area_m2 * shift + weight * (prior.mean_m - bias_m)) / (area_m2 + weight)
        bias_m += shift
        if abs(shift) < _EXACT_M:
            break
    return bias_m, area_m2
