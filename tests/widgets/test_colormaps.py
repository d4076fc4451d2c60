import cv2
import numpy as np
import pytest

from colour_vision import EYES, nearest
from tactune.core.model.patch import Provenance
from tactune.widgets.basics import colormaps

THEMES = ("light", "dark")


def lab(colors):
    """CIE L*a*b* of RGB rows."""
    rgb = (np.asarray(colors, dtype=np.float32) / 255).reshape(-1, 1, 3)
    return np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2LAB)).reshape(-1, 3)


def test_depth_colours_are_perceptually_uniform_and_get_darker():
    colors = lab(colormaps.depth_lut()[:, :3])
    assert (np.diff(colors[:, 0]) < 0.5).all(), "lightness falls from near to far, 8-bit rounding aside"
    steps = np.linalg.norm(colors[8:] - colors[:-8], axis=1)
    assert steps.max() / steps.min() < 2.5
    assert (colormaps.depth_lut()[:, 3] == 255).all()


@pytest.mark.parametrize("t", [0.01, 0.03, 0.08])
def test_the_band_is_one_colour_and_ends_at_t(t):
    lut = colormaps.difference_lut(t)
    relative = np.array([[-t - 0.003, -t + 0.001, 0.0, t - 0.001, t + 0.003]], np.float32)
    below, low, middle, high, above = lut[colormaps.scale_index(relative, -0.1, 0.1)[0], :3].tolist()
    assert low == middle == high
    assert below != middle != above
    assert lab([below, middle])[1, 1] - lab([below, middle])[0, 1] > 10, "the band is redder than what is around it"
    assert np.linalg.norm(lab([below])[0] - lab([above])[0]) > 20, "the sign is seen"


@pytest.mark.parametrize("eye", EYES)
def test_the_band_and_both_signs_are_told_apart_with_any_colour_vision(eye):
    lut = colormaps.difference_lut(0.03)
    rows = {"low end": 1, "below": 85, "band": 128, "above": 171, "high end": 255}
    assert nearest({name: lut[row, :3] for name, row in rows.items()}, eye)[0] > 8


@pytest.mark.parametrize("eye", EYES)
@pytest.mark.parametrize("theme", THEMES)
def test_drop_reasons_and_contact_are_told_apart_with_any_colour_vision(theme, eye):
    lut = colormaps.provenance_lut(theme)
    context = {
        Provenance.NO_PROXIMITY_DEPTH,
        Provenance.OUTSIDE_REGION,
        Provenance.OUTSIDE_RANGE,
        Provenance.OUTSIDE_TOLERANCE,
    }
    strong = {provenance: lut[provenance, :3] for provenance in Provenance if provenance not in context}
    assert nearest(strong, eye)[0] > 20
    for provenance in context:
        for reason, rgb in strong.items():
            assert nearest({provenance: lut[provenance, :3], reason: rgb}, eye)[0] > 15


@pytest.mark.parametrize("theme", THEMES)
def test_contact_has_the_same_colour_everywhere(theme):
    contact = colormaps.CONTACT_RGB
    assert tuple(colormaps.provenance_lut(theme)[Provenance.CONTACT, :3]) == contact
    assert tuple(colormaps.patch_lut(theme)[colormaps.CONTACT_ROW, :3]) == contact
    assert colormaps.CONTACT_COLOR.getRgb()[:3] == contact
    assert dict(colormaps.patch_legend(theme))["contact"].getRgb()[:3] == contact
    assert dict(colormaps.provenance_legend(theme))["contact"].getRgb()[:3] == contact
