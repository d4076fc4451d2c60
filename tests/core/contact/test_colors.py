"""The compiled colour test is OpenCV's conversion and a comparison."""

from __future__ import annotations

import cv2
import numpy as np

from tactune.core.contact.masking import in_hsv_range
from tactune.core.preset import MaskSection


def test_every_colour_has_opencvs_hue_saturation_and_value():
    steps = np.unique(np.r_[np.arange(0, 256, 5), 1, 2, 127, 128, 254, 255]).astype(np.uint8)
    colors = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    hue, saturation, value = cv2.cvtColor(colors[None], cv2.COLOR_RGB2HSV)[0].T
    for section in (
        MaskSection(hue=(30, 90)), MaskSection(hue=(150, 20)),
        MaskSection(saturation=(60, 200)), MaskSection(value=(3, 99)),
    ):  # fmt: skip
        low, high = section.hue
        expected = (low <= hue) & (hue <= high) if low <= high else (low <= hue) | (hue <= high)
        for channel, (floor, ceiling) in ((saturation, section.saturation), (value, section.value)):
            expected &= (floor <= channel) & (channel <= ceiling)
        assert np.array_equal(in_hsv_range(colors, section), expected)


def test_hue_ranges_wrap_around_red():
    red, green = np.array([255, 0, 8], np.uint8), np.array([0, 255, 0], np.uint8)
    colors = np.stack([red, green])
    assert in_hsv_range(colors, MaskSection(hue=(170, 10))).tolist() == [True, False]
    assert in_hsv_range(colors, MaskSection(hue=(10, 170))).tolist() == [False, True]
