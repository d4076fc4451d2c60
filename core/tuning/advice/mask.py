"""The colours of the prints, on which the proximity camera measures the membrane, and the mask that covers them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from ...contact.masking import colors_at, in_hsv_range
from ...contact.membrane.bias import most_frequent_m
from ...errors import AdviceError
from ...model.arrays import BoolArray, Float32Array, Float64Array, Uint8Array
from ...model.clouds import ray_table
from ...model.frames import Rig, SensorFrame
from ...preset import MaskSection, Preset
from ...rig.bias import depth_differences
from ...sources.base import Progress
from .proposal import Evidence, MaskLabel, Proposal

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
    """Where prints and bare membrane are in one frame, and their colours in OpenCV's HSV.

    Attributes
    ----------
    labels : uint8, shape (H, W)
        `MaskLabel`: MISSED on prints, BARE on bare membrane, before there is a mask.
    rgb : uint8, shape (H, W, 3)
        The colour of the membrane at each labelled pixel.
    core : bool, shape (H, W)
        Prints without their rim, on which colours mix.
    """

    labels: Uint8Array
    rgb: Uint8Array
    core: BoolArray

    @property
    def prints(self) -> Uint8Array:
        """The colours of the prints, RGB, shape (N, 3)."""
        return self.rgb[self.core]


def suggest_mask(evidence: Evidence, progress: Progress) -> Proposal:
    """Propose the mask that covers the prints.

    They are found in the untouched frame and in examples of the untouched membrane; without any, apart from marked
    contact; without that, among small groups of the present frame that are near the membrane, if they have one colour.
    """
    known: list[tuple[SensorFrame, BoolArray | None]] = []
    if evidence.untouched is not None:
        known.append((evidence.untouched, None))
    known += [(example.frame, None) for example in evidence.examples if example.contact is None]
    if not known:
        known = [(example.frame, example.contact) for example in evidence.examples]
    if weak := not known:
        known = [(evidence.frame, _large_groups(evidence))]
    found = []
    for number, (frame, contact) in enumerate(known):
        progress(number / len(known), "Looking for prints")
        found.append(_colours(frame, contact, evidence.preset, evidence.rig))
    if weak and not _one_colour(found[0].prints):
        raise AdviceError(
            "mask: in this frame prints can't be told from contact; capture an untouched frame, or mark the contact "
            "in a frame"
        )
    prints = np.concatenate([colours.prints for colours in found])
    if len(prints) < _MIN_PRINT_PIXELS:
        raise AdviceError(
            f"mask: only {len(prints)} pixels outside contact have a proximity depth on the membrane, so no "
            "print reflects infrared; leave the mask off, or check the alignment if you see false contact on prints"
        )
    section = _narrowest_within(prints, found)
    covered, lost = _shares(section, found)
    if covered - lost < _MIN_GAIN:
        raise AdviceError(
            f"mask: the prints have the colour of the rest of the membrane: a mask that covers {100 * covered:.0f} % "
            f"of them drops {100 * lost:.0f} % of the rest; no mask tells them apart"
        )
    return _proposal(evidence.preset, section, _labelled(found[0], section), covered, lost, found, weak)


def _behind(frame: SensorFrame, preset: Preset, rig: Rig) -> tuple[Float32Array, Float32Array]:
    """Return the tactile depth of each proximity pixel, and how far it sees behind the prints, metres."""
    frame.check_against(rig)
    expected_m, difference_m = depth_differences(frame, preset, rig)
    with np.errstate(invalid="ignore"):
        prints_m = most_frequent_m(difference_m[np.abs(difference_m) < _MAX_BIAS_M])
    return expected_m - difference_m, difference_m - prints_m


def _near(behind_m: Float32Array) -> Uint8Array:
    """Return where the proximity camera measures the membrane, or something at it, without single pixels."""
    with np.errstate(invalid="ignore"):
        near = (np.abs(behind_m) < _ON_PRINT_M).view(np.uint8)
    return np.asarray(cv2.morphologyEx(near, cv2.MORPH_OPEN, _THREE))


def _large_groups(evidence: Evidence) -> BoolArray:
    """Return what may be contact in the present frame: groups near the membrane that are much larger than most."""
    near = _near(_behind(evidence.frame, evidence.preset, evidence.rig)[1])
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


def _colours(frame: SensorFrame, contact: BoolArray | None, preset: Preset, rig: Rig) -> _Colours:
    """Tell prints from bare membrane by the depths, and read their colours.

    Parameters
    ----------
    contact : bool, shape (H, W), or None
        Where something touches. What is near the membrane and connected with contact is no print.
    """
    membrane_m, behind_m = _behind(frame, preset, rig)
    on_print = _near(behind_m)
    if contact is not None:
        _, groups = cv2.connectedComponents(on_print | contact.view(np.uint8), connectivity=8)
        on_print[np.isin(groups, np.unique(groups[contact]))] = 0
    labels = np.full(behind_m.shape, MaskLabel.UNKNOWN, np.uint8)
    with np.errstate(invalid="ignore"):
        labels[behind_m > _THROUGH_M] = MaskLabel.BARE
    labels[on_print > 0] = MaskLabel.MISSED
    if contact is not None:
        labels[contact & np.isfinite(behind_m)] = MaskLabel.LOST  # for now, to get the colours there
    rgb = _membrane_colours(frame, labels, membrane_m, rig)
    if contact is not None:
        touched = labels == MaskLabel.LOST
        labels[touched] = MaskLabel.UNKNOWN
        labels[(labels == MaskLabel.MISSED) & _of_object(rgb, labels == MaskLabel.MISSED, touched)] = MaskLabel.UNKNOWN
    return _Colours(labels, rgb, cv2.erode((labels == MaskLabel.MISSED).view(np.uint8), _THREE) > 0)


def _of_object(rgb: Uint8Array, prints: BoolArray, touched: BoolArray) -> BoolArray:
    """Return which pixels have a colour that is as frequent in contact as on prints, so it is that of the object."""
    hue, saturation, _ = np.moveaxis(cv2.cvtColor(rgb, cv2.COLOR_RGB2HSV), 2, 0).astype(np.intp)
    colour = hue // _HUE_BIN * 256 + saturation // _SATURATION_BIN
    there, here = (np.bincount(colour[part], minlength=256 * _HUES) / max(part.sum(), 1) for part in (touched, prints))
    return np.asarray((there * _TYPICAL > here)[colour])


def _membrane_colours(frame: SensorFrame, labels: Uint8Array, membrane_m: Float32Array, rig: Rig) -> Uint8Array:
    """Return the colour of the membrane at each labelled pixel; unlabel pixels that the colour camera misses."""
    pixels = np.flatnonzero(labels)
    depth = membrane_m.reshape(-1)[pixels, None]
    points = np.concatenate([ray_table(rig.proximity.intrinsics).reshape(-1, 2)[pixels] * depth, depth], axis=1)
    colors, seen = colors_at(np.ascontiguousarray(points, np.float32), pixels, frame.proximity_color, rig)
    labels.reshape(-1)[pixels[~seen]] = MaskLabel.UNKNOWN
    image = np.zeros((*labels.shape, 3), np.uint8)
    image.reshape(-1, 3)[pixels] = colors
    return image


def _hues_around_mean(hue: Float64Array) -> tuple[float, Float64Array]:
    """Return the mean of some hues, 0 to 180 around a circle, and how far each is from it, -90 to 90."""
    centre = float(np.angle(np.exp(2j * np.pi / _HUES * hue).mean())) * _HUES / (2 * np.pi)
    return centre, (hue - centre + _HUES / 2) % _HUES - _HUES / 2


def _narrowest_within(prints: Uint8Array, found: Sequence[_Colours]) -> MaskSection:
    """Return the mask of the prints' colours, with margins as wide as the bare membrane allows."""
    hue, saturation, value = cv2.cvtColor(prints[None], cv2.COLOR_RGB2HSV)[0].T.astype(np.float64)
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
    allowed = _shares(sections[-1], found)[1] + _MAX_LOST
    return next(section for section in sections if _shares(section, found)[1] <= allowed)


def _shares(section: MaskSection, found: Sequence[_Colours]) -> tuple[float, float]:
    """Return which share of the prints a mask covers, and which share of the bare membrane it loses."""
    counts = np.zeros(5)
    for colours in found:
        counts += np.bincount(_labelled(colours, section).reshape(-1), minlength=5)
    prints = counts[MaskLabel.COVERED] + counts[MaskLabel.MISSED]
    bare = counts[MaskLabel.LOST] + counts[MaskLabel.BARE]
    return counts[MaskLabel.COVERED] / max(prints, 1), counts[MaskLabel.LOST] / max(bare, 1)


def _labelled(colours: _Colours, section: MaskSection) -> Uint8Array:
    """Return the labels of a frame's pixels under a mask."""
    labels = colours.labels.copy()
    inside = in_hsv_range(colours.rgb, section)
    labels[inside & (labels == MaskLabel.MISSED)] = MaskLabel.COVERED
    labels[inside & (labels == MaskLabel.BARE)] = MaskLabel.LOST
    return labels


def _proposal(
    preset: Preset,
    section: MaskSection,
    picture: Uint8Array,
    covered: float,
    lost: float,
    found: Sequence[_Colours],
    weak: bool,
) -> Proposal:
    """Return the proposal of a mask, or that of no change if the present mask does as well."""
    changes = {
        f"mask.{name}": value for name, value in section.model_dump().items() if value != getattr(preset.mask, name)
    }
    label = f"Mask hue {section.hue[0]} to {section.hue[1]}, saturation from {section.saturation[0]}"
    present = "The present mask is off: prints pass as contact."
    if preset.mask.enabled:
        now_covered, now_lost = _shares(preset.mask, found)
        present = (
            f"The present mask covers {100 * now_covered:.0f} % of the prints and drops {100 * now_lost:.1f} % of the "
            "bare membrane."
        )
        if now_covered >= covered - _AS_GOOD and now_lost <= lost + _MAX_LOST:
            changes, label, picture = {}, "Keep the mask", _labelled(found[0], preset.mask)
    where, doubt = "outside contact", ""
    if weak:
        where, doubt = (
            "in small groups of one colour",
            " An untouched frame would tell prints from contact for certain.",
        )
    pixels = sum(int(np.count_nonzero(colours.core)) for colours in found)
    return Proposal(
        section="mask",
        changes=changes,
        label=label,
        evidence=(
            f"On {pixels:,} pixels {where} the proximity camera measures the membrane itself; a mask of their colours "
            f"covers {100 * covered:.0f} % of the prints and drops {100 * lost:.1f} % of the bare membrane.{doubt}"
        ),
        expected=present,
        weak=weak,
        picture=picture,
    )
