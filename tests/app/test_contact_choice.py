"""The choice of the contact test in the window: by keyboard, undo, and the widgets that depend on it."""

from __future__ import annotations

import numpy as np
import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest

from fakes import tiny_frame, tiny_rig
from hands import CONTROL, shows_preset_of_document, type_into
from tactune.app.worker.rendering import accepted_difference
from tactune.app.worker.results import CloudName
from tactune.core.contact.membrane.test import MembraneTest
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.model.provenance import Provenance
from tactune.core.preset import Preset
from tactune.widgets.basics.colormaps import provenance_legend


@pytest.fixture
def preset(preset: Preset) -> Preset:
    """The tiny membrane is flat, as no inflated one is: only a short equilibrium length keeps its measured gap."""
    return preset.with_value("membrane.trust_m", 0.008)


def choose_by_keyboard(window, qtbot, key):
    box = window.panel.rows["contact_test"].widget
    window.activateWindow()
    window.panel.ensureWidgetVisible(box)
    box.setFocus()
    QTest.keyClick(box, key)
    qtbot.waitUntil(lambda: shows_preset_of_document(window))
    return box


def type_gap_mm(window, qtbot, text):
    entry = window.panel.rows["membrane.gap_m"].widget.entry
    window.panel.ensureWidgetVisible(entry)
    type_into(entry, text)
    qtbot.waitUntil(lambda: shows_preset_of_document(window))


def test_choose_tune_and_undo(window, qtbot):
    """The disc of the tiny frames is 2 mm behind the membrane: within the tolerance, no contact in equilibrium."""
    before, patch_before = window.document.preset, window.result.patch
    assert len(patch_before.points) > 0
    box = choose_by_keyboard(window, qtbot, Qt.Key.Key_Up)
    assert window.document.preset.contact_test == "membrane"
    assert window.document.undo_stack.undoText() == "Contact test membrane"
    assert tuple(window.result.patch.stage_ms) == tuple(MembraneTest.steps)
    assert "raise the largest gap" in window.views.views[CloudName.PATCH].message()
    assert window.result.rendered.histogram.field == "membrane.gap_m"
    assert window.panel.histograms["membrane.gap_m"].isVisible()
    assert not window.panel.histograms["tolerance.t"].isVisible()

    type_gap_mm(window, qtbot, "3")
    assert window.document.preset.membrane.gap_m == 0.003
    expected = ContactPipeline(window.document.preset, tiny_rig()).process(tiny_frame(3, tiny_rig()))
    assert len(expected.points) > 0
    np.testing.assert_array_equal(window.result.patch.points, expected.points)
    np.testing.assert_array_equal(window.result.patch.provenance, expected.provenance)

    box.setFocus()
    QTest.keyClick(box, Qt.Key.Key_Z, CONTROL)
    QTest.keyClick(box, Qt.Key.Key_Z, CONTROL)
    assert window.document.preset is before
    assert box.value() == "tolerance"
    qtbot.waitUntil(lambda: shows_preset_of_document(window))
    np.testing.assert_array_equal(window.result.patch.points, patch_before.points)
    assert window.panel.histograms["tolerance.t"].isVisible()


def test_the_patch_is_drawn_at_its_own_points(window, qtbot):
    choose_by_keyboard(window, qtbot, Qt.Key.Key_Up)
    type_gap_mm(window, qtbot, "3")
    patch, cloud = window.result.patch, window.result.rendered.clouds[CloudName.PATCH]
    drawn_m = cloud.depth[patch.mask] * cloud.depth_unit_m
    np.testing.assert_allclose(drawn_m, patch.points[:, 2], atol=0.00013)
    assert np.abs(window.result.frame.proximity_depth[patch.mask] * 0.00025 - patch.points[:, 2]).min() > 0.0005


def test_the_rim_has_a_colour_of_its_own_and_a_name():
    for theme in ("light", "dark"):
        legend = {name: color.getRgb() for name, color in provenance_legend(theme)}
        assert len(set(legend.values())) == len(legend) == len(Provenance)
        assert provenance_legend(theme, {Provenance.RIM})[0][0] == "rim"


def test_an_empty_patch_says_what_the_membrane_test_has_dropped():
    provenance = np.full((4, 5), Provenance.OUTSIDE_TOLERANCE, np.uint8)
    assert "largest gap" in MembraneTest.why_no_contact(provenance)[0]
    provenance[0] = Provenance.RIM
    assert "the membrane's equilibrium dropped all" in MembraneTest.why_no_contact(provenance)[0]
    assert "measure the rig's bias" in MembraneTest.why_no_contact(provenance)[0]
    provenance[1:3] = Provenance.SMALL_CLUSTER
    assert "dropped 10 of 15: lower the smallest contact" in MembraneTest.why_no_contact(provenance)[0]


def test_the_colours_middle_band_is_what_the_chosen_test_accepts():
    preset = Preset().with_values({"contact_test": "tolerance", "tolerance.t": 0.02})
    assert accepted_difference(preset, (0.2, 0.4)) == 0.02
    membrane = preset.with_value("contact_test", "membrane")
    assert accepted_difference(membrane, (0.2, 0.4)) == 0.005, "1.5 mm at 0.3 m"
    assert accepted_difference(membrane, (0.0, 0.0)) == 0.0
