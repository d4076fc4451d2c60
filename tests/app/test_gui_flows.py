"""Complete user flows of tuning, playing and colouring, by real mouse and key events."""

import numpy as np
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication

from fakes import HEIGHT, MEMBRANE_RGB, WIDTH, at_rest
from hands import (
    CONTROL,
    CONTROL_SHIFT,
    LEFT,
    drag_slider,
    image_position,
    shows_preset_of_document,
    strip_position,
    tolerance_slider,
    type_into,
)
from tactune.app.worker.results import CloudName, ColorBy
from tactune.core.contact.membrane.test import MembraneTest
from tactune.core.model.patch import Provenance
from tactune.widgets.basics.colormaps import CONTACT_RGB


def test_a_field_leaves_the_playback_keys_to_the_window(window, qtbot):
    entry = window.panel.rows["tolerance.t"].widget.entry
    pressed = []
    window.actions_.play.triggered.connect(lambda: pressed.append("play"))
    window.actions_.previous.triggered.connect(lambda: pressed.append("previous"))
    window.activateWindow()
    entry.setFocus()
    QTest.keyClick(entry, Qt.Key.Key_Space)
    QTest.keyClick(entry, Qt.Key.Key_Comma)
    assert pressed == ["play", "previous"]
    type_into(entry, "5")
    assert window.document.preset.tolerance.t == 0.05
    assert not entry.hasFocus(), "Return gives the keyboard back"
    QTest.keyClick(QApplication.focusWidget(), Qt.Key.Key_Space)
    assert pressed == ["play", "previous", "play"]


def test_drag_a_slider_then_undo_and_redo(window, qtbot):
    before = window.document.preset
    points_before = len(window.result.patch.points)
    drag_slider(tolerance_slider(window), 0.6, 0.7, 0.8, 0.95)
    qtbot.waitUntil(lambda: shows_preset_of_document(window))
    t = window.document.preset.tolerance.t
    assert t > 0.1
    assert len(window.result.patch.points) > points_before
    assert window.document.undo_stack.count() == 1
    assert window.isWindowModified()
    assert window.mode_bar.preset.text() == "Preset: tiny *"

    QTest.keyClick(window, Qt.Key.Key_Z, CONTROL)
    assert window.document.preset is before
    assert window.panel.rows["tolerance.t"].editor.value() == before.tolerance.t
    assert not window.isWindowModified()
    qtbot.waitUntil(lambda: shows_preset_of_document(window))
    assert len(window.result.patch.points) == points_before
    QTest.keyClick(window, Qt.Key.Key_Z, CONTROL_SHIFT)
    assert window.document.preset.tolerance.t == t


def test_pick_works_while_the_mask_is_off_and_turns_it_on_in_the_same_step(window, qtbot):
    before = window.document.preset
    assert not before.mask.enabled
    pick = window.panel.eyedroppers["set"]
    window.panel.ensureWidgetVisible(pick)
    QTest.mouseClick(pick, LEFT)
    pane = window.strip.panes["color"]
    QTest.mouseClick(pane.view.viewport(), LEFT, pos=image_position(pane, 8, 8).toPoint())
    mask = window.document.preset.mask
    assert mask.enabled
    assert mask.hue[0] <= 115 <= mask.hue[1]
    assert mask.saturation[0] > 0, "not the whole image"
    assert window.document.undo_stack.undoText() == "Pick the mask's colour"
    qtbot.waitUntil(lambda: shows_preset_of_document(window))
    assert len(window.result.patch.points) > 0, "the object's red is not masked"
    window.document.undo_stack.undo()
    assert window.document.preset is before
    assert window.eyedropper.mode == "set", "the next click picks again"
    QTest.keyClick(window.panel, Qt.Key.Key_Escape)
    assert window.eyedropper.mode == "off"


def test_while_picking_a_banner_says_what_to_click_and_the_line_tells_the_colour(window, qtbot):
    strip, pane = window.strip, window.strip.panes["color"]
    window.actions_.show_strip.trigger()
    assert not strip.isVisible()
    pick = window.panel.eyedroppers["set"]
    window.panel.ensureWidgetVisible(pick)
    QTest.mouseClick(pick, LEFT)
    assert strip.isVisible(), "a click there is wanted"
    assert strip.banner.isVisible()
    assert "print" in strip.banner.text.text()
    QApplication.processEvents()
    covered = strip.banner.geometry().bottom() - pane.view.mapTo(strip, QPoint(0, 0)).y()
    assert covered < 4, "the image that is clicked is not covered"
    for place in ((20, 20), (8, 8)):  # a move to where the pointer is already would be dropped
        QTest.mouseMove(pane.view.viewport(), image_position(pane, *place).toPoint())
    qtbot.waitUntil(lambda: "H 116  S 204  V 200" in window.status.readout.text())
    QTest.mouseClick(strip.banner.done, LEFT)
    assert window.eyedropper.mode == "off"
    assert not pick.isChecked()
    assert not strip.banner.isVisible()


def test_the_mask_tints_the_image_until_it_is_hidden(window, qtbot):
    panel, pane = window.panel, window.strip.panes["color"]
    assert not panel.masked_share.isVisible()
    assert not panel.show_mask.isEnabled() and [name for name, _ in pane.header.entries] == ["contact"], "no mask"
    QTest.mouseClick(panel.eyedroppers["set"], LEFT)
    QTest.mouseClick(pane.view.viewport(), LEFT, pos=image_position(pane, 8, 8).toPoint())
    qtbot.waitUntil(panel.masked_share.isVisible)
    share = np.mean((window.result.frame.proximity_color == MEMBRANE_RGB).all(-1))
    assert f"{100 * share:.1f} % of the colour image" in panel.masked_share.text()

    def tinted():
        corner = window.result.rendered.strip.panes["color"][4:8, 4:8, :3]
        seen = bool((corner != MEMBRANE_RGB[::-1]).any(axis=2).all())
        return seen, "masked" in pane.toolTip()

    assert tinted() == (True, True)
    QTest.mouseClick(panel.show_mask, LEFT)
    qtbot.waitUntil(lambda: tinted() == (False, False))


def test_hovering_says_why_a_pixel_was_kept(window, qtbot):
    pane = window.strip.panes["difference"]
    window.strip.choose("difference")
    QApplication.processEvents()
    QTest.mouseMove(pane.view.viewport(), image_position(pane, WIDTH // 2, HEIGHT // 2).toPoint())
    qtbot.waitUntil(lambda: "Kept" in window.status.readout.text())
    text = window.status.readout.text()
    assert f"({WIDTH // 2}, {HEIGHT // 2})" in text
    assert "dp 0.252" in text
    assert "dt 0.250" in text
    assert "= +0.8% (+2.1 mm)" in text
    QTest.mouseMove(pane.view.viewport(), image_position(pane, 2, 2).toPoint())
    qtbot.waitUntil(lambda: "Dropped" in window.status.readout.text())
    window.resize(window.minimumSize())
    label, text = window.status.readout, window.status.readout.text()
    shown = label.fontMetrics().elidedText(text, Qt.TextElideMode.ElideRight, label.width() - 4)
    assert shown != text and "too far apart here." in shown, "numbers are cut before the reason"


def test_pause_step_and_seek(window, qtbot):
    state = window.transport.state
    assert not state.playing
    QTest.keyClick(window, Qt.Key.Key_Period)
    qtbot.waitUntil(lambda: at_rest(window, 4))
    QTest.keyClick(window, Qt.Key.Key_Comma)
    qtbot.waitUntil(lambda: at_rest(window, 3))
    strip = window.time_strip
    QTest.mousePress(strip.plot_widget.viewport(), LEFT, pos=strip_position(strip, 5).toPoint())
    QTest.mouseMove(strip.plot_widget.viewport(), strip_position(strip, 7).toPoint())
    QTest.mouseRelease(strip.plot_widget.viewport(), LEFT, pos=strip_position(strip, 7).toPoint())
    qtbot.waitUntil(lambda: at_rest(window, 7))
    strip.plot_widget.setFocus()
    QTest.keyClick(strip.plot_widget, Qt.Key.Key_Home)
    qtbot.waitUntil(lambda: at_rest(window, 0))
    QTest.keyClick(strip.plot_widget, Qt.Key.Key_End)
    qtbot.waitUntil(lambda: at_rest(window, 7))


def test_choose_tune_and_undo(window, qtbot):
    """The disc of the tiny frames is 2 mm behind the membrane: within the tolerance, no contact in equilibrium."""
    window.document.edit("membrane.trust_m", 0.008)  # the tiny membrane is flat, as no inflated one is
    before, patch_before = window.document.preset, window.result.patch
    assert len(patch_before.points) > 0
    box = window.panel.rows["contact_test"].widget
    window.activateWindow()
    window.panel.ensureWidgetVisible(box)
    box.setFocus()
    QTest.keyClick(box, Qt.Key.Key_Up)
    qtbot.waitUntil(lambda: shows_preset_of_document(window))
    assert window.document.preset.contact_test == "membrane"
    assert window.document.undo_stack.undoText() == "Contact test membrane"
    assert tuple(window.result.patch.stage_ms) == tuple(MembraneTest.steps)
    assert "raise the largest gap" in window.views.views[CloudName.PATCH].notice.text()
    assert window.result.rendered.histogram.field == "membrane.gap_m"
    assert window.panel.histograms["membrane.gap_m"].isVisible()
    assert not window.panel.histograms["tolerance.t"].isVisible()

    entry = window.panel.rows["membrane.gap_m"].widget.entry
    window.panel.ensureWidgetVisible(entry)
    type_into(entry, "3")
    qtbot.waitUntil(lambda: shows_preset_of_document(window))
    assert window.document.preset.membrane.gap_m == 0.003
    assert len(window.result.patch.points) > 0

    box.setFocus()
    QTest.keyClick(box, Qt.Key.Key_Z, CONTROL)
    QTest.keyClick(box, Qt.Key.Key_Z, CONTROL)
    assert window.document.preset is before
    assert box.value() == "tolerance"
    qtbot.waitUntil(lambda: shows_preset_of_document(window))
    np.testing.assert_array_equal(window.result.patch.points, patch_before.points)
    assert window.panel.histograms["tolerance.t"].isVisible()


PATCH, TACTILE, PROXIMITY = CloudName.PATCH, CloudName.TACTILE, CloudName.PROXIMITY


def choose(window, qtbot, color_by):
    box = window.views.color_by
    box.setFocus()
    QTest.keyClick(box, Qt.Key.Key_Home)
    for _ in range(list(ColorBy).index(color_by)):
        QTest.keyClick(box, Qt.Key.Key_Down)
    assert window.views.colors is color_by
    qtbot.waitUntil(lambda: window.result.rendered.color_by is color_by)


def colors_of(window, name):
    """The colour of every pixel of a cloud, RGBA: int (H, W, 4)."""
    cloud = window.views.views[name].cloud()
    return cloud.lut[cloud.rows()].astype(int)


def test_in_provenance_each_view_answers_its_own_question(window, qtbot):
    window.document.edit("mask.enabled", True)
    window.document.edit("mask.hue", (175, 5))
    choose(window, qtbot, ColorBy.PROVENANCE)
    window.document.edit("region.rectangle", (0, 0, 64, 24))
    window.document.edit("region.enabled", True)
    qtbot.waitUntil(lambda: window.result.preset == window.document.preset)
    names = {name: [text for text, _ in view.header.entries] for name, view in window.views.views.items()}
    verdicts = window.result.patch.provenance
    assert {Provenance.OUTSIDE_REGION, Provenance.OUTSIDE_TOLERANCE} < set(np.unique(verdicts))
    assert "out of region" in names[PROXIMITY] and "out of region" not in names[PATCH]
    assert names[PATCH][-1] == "not touching"
    assert (colors_of(window, PATCH)[verdicts == Provenance.CONTACT][:, :3] == CONTACT_RGB).all()


def test_the_patch_view_shows_what_late_steps_dropped(window, qtbot):
    choose(window, qtbot, ColorBy.PROVENANCE)
    disc = window.result.patch.mask
    values = {"mask.enabled": True, "mask.hue": (0, 179), "mask.saturation": (0, 255), "mask.value": (0, 255)}
    window.document.edit_many(values, 1, "Drop the disc")
    qtbot.waitUntil(lambda: window.result.preset == window.document.preset and not window.result.patch.mask.any())
    patch = {text: color.getRgb()[:3] for text, color in window.views.views[PATCH].header.entries}
    assert (colors_of(window, PATCH)[disc][:, :3] == patch["masked"]).all()
