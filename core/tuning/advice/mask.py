"""The colours of the prints, on which the proximity camera measures the membrane, and the mask that covers them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from ...contact.masking import in_hsv_range
from ...contact.membrane.frame_bias import most_frequent_m
from ...contact.pixels import colors_at
from ...errors import AdviceError
from ...model.arrays import BoolArray, Float64Array, Uint8Array
from ...model.clouds import ray_table
from ...model.frames import Rig, SensorFrame
from ...preset import MaskSection, Preset
from ...rig.bias import depth_differences
from ...sources.base import Progress
from .proposal import Evidence, Proposal

#: Largest bias between the cameras at which prints are recognised, metres.
_MAX_BIAS_M: Final = 0.04
#: A pixel is on a print if its difference is within the first of the prints' bias, and sees through the membrane if it
#: is beyond the second. Metres.
_ON_PRINT_M, _THROUGH_M = 0.004, 0.010
#: Fewest pixels on prints.
_MIN_PRINT_PIXELS: Final = 300
#: Bins of colours, and how much more frequent the colour of a print is outside contact than in it.
_HUE_BIN, _SATURATION_BIN, _TYPICAL = 6, 16, 2.0
#: Share of the prints' colours that the narrowest mask leaves out at each end.
_TAIL: Final = 0.01
#: The widest mask exceeds the colours of the prints by this much: hue, saturation, and a share of the brightness, for
#: light that changes where the membrane is pressed. It is narrowed until it costs at most this share of bare membrane.
_HUE_MARGIN, _SATURATION_MARGIN, _VALUE_MARGIN, _MAX_LOST = 14, 60, 0.5, 0.005
_NARROWER: Final = (1.0, 0.75, 0.5, 0.25, 0.1, 0.0)
#: Without an untouched frame: fewest groups that may be prints, fewest pixels of one, a larger group than most by this
#: factor may be contact, and the prints' hues and saturations are this near each other.
_MIN_GROUPS, _MIN_GROUP_PIXELS, _LARGE, _ONE_HUE, _ONE_SATURATION = 4, 30, 3.0, 20.0, 60.0
#: The present mask is as good if it covers at most this share less.
_AS_GOOD: Final = 0.02
#: Prints whose colour tells them from bare membrane by less cannot be masked.
_MIN_GAIN: Final = 0.5

_HUES: Final = 180
_THREE: Final = np.ones((3, 3), np.uint8)


@dataclass(frozen=True, eq=False)
class _Colours:
    """Where prints and bare membrane are in one frame, bool (H, W), and the colour of the membrane there, RGB."""

    prints: BoolArray
    bare: BoolArray
    rgb: Uint8Array

    @property
    def core(self) -> Uint8Array:
        """The colours of the prints without their rim, on which colours mix: RGB, shape (N, 3)."""
        return self.rgb[cv2.erode(self.prints.view(np.uint8), _THREE) > 0]

    def shares(self, section: MaskSection) -> tuple[float, float]:
        """Return which share of the prints a mask covers, and which share of the bare membrane it loses."""
        inside = in_hsv_range(self.rgb, section)
        covered, lost = (np.count_nonzero(inside & part) / max(part.sum(), 1) for part in (self.prints, self.bare))
        return float(covered), float(lost)


def suggest_mask(evidence: Evidence, progress: Progress) -> Proposal:
    """Propose the mask that covers the prints."""
    progress(0.0, "Looking for prints")
    return find_prints(evidence)[0]


def find_prints(evidence: Evidence) -> tuple[Proposal, BoolArray]:
    """Propose the mask that covers the prints, and return its pixels; without untouched frame, of one colour."""
    preset, rig = evidence.preset, evidence.rig
    free = evidence.untouched
    colours = _colours(free or evidence.frame, preset, rig, pressed=free is None)
    if free is None and not _one_colour(colours.core):
        raise AdviceError("mask: in this frame prints can't be told from contact; capture an untouched frame")
    if len(colours.core) < _MIN_PRINT_PIXELS:
        raise AdviceError(
            f"mask: only {len(colours.core)} pixels outside contact have a proximity depth on the membrane, so no "
            "print reflects infrared; leave the mask off, or check the alignment if you see false contact on prints"
        )
    section = _widest(colours)
    covered, lost = colours.shares(section)
    if covered - lost < _MIN_GAIN:
        raise AdviceError(
            f"mask: the prints have the colour of the rest of the membrane: a mask that covers {100 * covered:.0f} % "
            f"of them drops {100 * lost:.0f} % of the rest; no mask tells them apart"
        )
    changes = {
        f"mask.{name}": value for name, value in section.model_dump().items() if value != getattr(preset.mask, name)
    }
    label = f"Mask hue {section.hue[0]} to {section.hue[1]}, saturation from {section.saturation[0]}"
    present = "The present mask is off: prints pass as contact."
    if preset.mask.enabled:
        now_covered, now_lost = colours.shares(preset.mask)
        present = (
            f"The present mask covers {100 * now_covered:.0f} % of the prints and drops {100 * now_lost:.1f} % of the "
            "bare membrane."
        )
        if now_covered >= covered - _AS_GOOD and now_lost <= lost + _MAX_LOST:
            changes, label = {}, "Keep the mask"
    sentence = (
        f"On {len(colours.core):,} pixels {'outside contact' if free else 'in small groups of one colour'} the "
        "proximity camera measures the membrane itself; a mask of their colours covers "
        f"{100 * covered:.0f} % of the prints and drops {100 * lost:.1f} % of the bare membrane."
    )
    if free is None:
        sentence += " An untouched frame would tell prints from contact for certain."
    covering = colours.prints & in_hsv_range(colours.rgb, section)
    return Proposal("mask", changes, label, sentence, present), covering


def _large_groups(near: Uint8Array) -> BoolArray:
    """Return what may be contact: groups near the membrane that are much larger than most."""
    _, groups, stats, _ = cv2.connectedComponentsWithStats(near, connectivity=8)
    areas = stats[:, cv2.CC_STAT_AREA]
    prints = np.flatnonzero(areas[1:] >= _MIN_GROUP_PIXELS) + 1
    if len(prints) < _MIN_GROUPS:
        return near > 0
    large = areas > _LARGE * np.median(areas[prints])
    large[0] = False
    return np.asarray(large[groups])


def _one_colour(rgb: Uint8Array) -> bool:
    """Return whether colours have nearly one hue and saturation, as prints have."""
    if len(rgb) == 0:
        return False
    hue, saturation, _ = cv2.cvtColor(rgb[None], cv2.COLOR_RGB2HSV)[0].T.astype(np.float64)
    ends = (2 * _TAIL, 1 - 2 * _TAIL)
    hues, saturations = (np.ptp(np.quantile(part, ends)) for part in (_hues_around_mean(hue)[1], saturation))
    return bool(hues <= _ONE_HUE and saturations <= _ONE_SATURATION)


def _colours(frame: SensorFrame, preset: Preset, rig: Rig, *, pressed: bool) -> _Colours:
    """Tell prints from bare membrane by the depths, and read their colours."""
    frame.check_against(rig)
    expected_m, difference_m = depth_differences(frame, preset, rig)
    with np.errstate(invalid="ignore"):
        behind_m = difference_m - most_frequent_m(difference_m[np.abs(difference_m) < _MAX_BIAS_M])  # the prints
        bare = behind_m > _THROUGH_M
        near = (np.abs(behind_m) < _ON_PRINT_M).view(np.uint8)
    near = np.asarray(cv2.morphologyEx(near, cv2.MORPH_OPEN, _THREE))  # without single pixels
    pixels = np.flatnonzero(bare | (near > 0))
    depth = (expected_m - difference_m).reshape(-1)[pixels, None]  # of the membrane
    points = np.concatenate([ray_table(rig.proximity.intrinsics).reshape(-1, 2)[pixels] * depth, depth], axis=1)
    colors, known = colors_at(np.ascontiguousarray(points, np.float32), pixels, frame.proximity_color, rig)
    rgb, seen = np.zeros((*bare.shape, 3), np.uint8), np.zeros(bare.shape, bool)
    rgb.reshape(-1, 3)[pixels] = colors
    seen.reshape(-1)[pixels[known]] = True
    prints, bare = (near > 0) & seen, bare & (near == 0) & seen
    if pressed:
        large = _large_groups(near)
        prints &= ~large
        # a colour that is as frequent in contact as on prints is that of the object
        hue, saturation, _ = np.moveaxis(cv2.cvtColor(rgb, cv2.COLOR_RGB2HSV), 2, 0).astype(np.intp)
        colour = hue // _HUE_BIN * 256 + saturation // _SATURATION_BIN
        touched, printed = (
            np.bincount(colour[part], minlength=256 * _HUES) / max(part.sum(), 1) for part in (large & seen, prints)
        )
        prints &= ~(touched * _TYPICAL > printed)[colour]
    return _Colours(prints, bare, rgb)


def _hues_around_mean(hue: Float64Array) -> tuple[float, Float64Array]:
    """Return the mean of some hues, 0 to 180 around a circle, and how far each is from it, -90 to 90."""
    centre = float(np.angle(np.exp(2j * np.pi / _HUES * hue).mean())) * _HUES / (2 * np.pi)
    return centre, (hue - centre + _HUES / 2) % _HUES - _HUES / 2


def _widest(colours: _Colours) -> MaskSection:
    """Return the mask of the prints' colours, with margins as wide as the bare membrane allows."""
    hue, saturation, value = cv2.cvtColor(colours.core[None], cv2.COLOR_RGB2HSV)[0].T.astype(np.float64)
    centre, around = _hues_around_mean(hue)
    hue_low, hue_high = np.quantile(around, (_TAIL, 1 - _TAIL))
    saturation_low, value_low = np.quantile(saturation, _TAIL), np.quantile(value, _TAIL)
    sections = [
        MaskSection(
            enabled=True,
            hue=(
                round(centre + hue_low - share * _HUE_MARGIN) % _HUES,
                round(centre + hue_high + share * _HUE_MARGIN) % _HUES,
            ),
            saturation=(max(round(saturation_low - share * _SATURATION_MARGIN), 0), 255),
            value=(max(round(value_low * (1 - share * _VALUE_MARGIN)), 0), 255),
        )
        for share in _NARROWER
    ]
    allowed = colours.shares(sections[-1])[1] + _MAX_LOST
    return next(section for section in sections if colours.shares(section)[1] <= allowed)
