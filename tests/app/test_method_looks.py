"""The colours of the methods: told apart by everybody, in both themes."""

from __future__ import annotations

import itertools

import cv2
import numpy as np
import pytest

from tactune.app.analysis.method_looks import FALSE_RGB, MISSED_RGB, RIGHT_RGB, TRUTH, method_rgb, method_tip
from tactune.core.methods.registry import method_names
from tactune.widgets.basics.colormaps import patch_lut
from tactune.widgets.basics.theme import contrast_ratio, theme_colors

#: Machado, Oliveira and Fernandes 2009, severity 1, on linear RGB.
EYES = {
    "all colours": np.eye(3),
    "no red": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "no green": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
}


def seen(rgb, eye):
    """CIE L*a*b* of a colour as an eye sees it."""
    share = np.asarray(rgb) / 255
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    linear = np.clip(np.asarray(EYES[eye]) @ linear, 0, 1)
    back = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return cv2.cvtColor(back.astype(np.float32)[None, None], cv2.COLOR_RGB2LAB)[0, 0]


def nearest(colors, eye):
    points = {name: seen(rgb, eye) for name, rgb in colors.items()}
    return min((float(np.linalg.norm(points[a] - points[b])), a, b) for a, b in itertools.combinations(points, 2))


@pytest.mark.parametrize("eye", EYES)
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_methods_and_truth_are_told_apart(eye, theme):
    assert nearest({name: method_rgb(name, theme) for name in (TRUTH, *method_names())}, eye)[0] > 15


@pytest.mark.parametrize("eye", EYES)
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_patches_stand_out_from_the_scene_around_them(eye, theme):
    for name in (TRUTH, *method_names()):
        for row in (0, 127, 250):
            assert nearest({"patch": method_rgb(name, theme), "scene": patch_lut(theme)[row, :3]}, eye)[0] > 10


@pytest.mark.parametrize("theme, least", [("light", 2), ("dark", 3)])
def test_patches_are_seen_on_the_background(theme, least):
    for name in (TRUTH, *method_names()):
        assert contrast_ratio("#" + bytes(method_rgb(name, theme)).hex(), theme_colors(theme).base) > least, name


@pytest.mark.parametrize("eye", EYES)
def test_right_false_and_missed_are_told_apart(eye):
    assert nearest({"right": RIGHT_RGB, "false": FALSE_RGB, "missed": MISSED_RGB}, eye)[0] > 30


def test_every_method_says_what_it_is():
    tips = [method_tip(name) for name in (TRUTH, *method_names())]
    assert all(tips) and len(set(tips)) == len(tips)
