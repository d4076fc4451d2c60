"""The choice of the contact test in the window: by keyboard, undo, and the widgets that depend on it."""

import numpy as np
import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest

from fakes import tiny_frame, tiny_rig
from hands import CONTROL, shows_preset_of_document, type_into
from tactune.app.worker.results import CloudName
from tactune.core.contact.membrane.test import MembraneTest
from tactune.core.contact.pipeline import ContactPipeline


@pytest.fixture
def preset(preset):
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
    assert "raise the largest gap" in window.views.views[CloudName.PATCH].notice.text()
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
