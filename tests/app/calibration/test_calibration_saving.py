"""What happens to the preset and its file when a calibration is saved."""

from __future__ import annotations

import numpy as np
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest

from hands import answer_question, press
from pairs import with_pairs
from tactune.core.sources.presets import load_preset

LEFT = Qt.MouseButton.LeftButton
CONTROL = Qt.KeyboardModifier.ControlModifier
GEOMETRY = "alignment.rigid.T_proximity_tactile"


def fitted(qtbot, wizard, state):
    wizard.session.edit("all", state)
    qtbot.waitUntil(lambda: wizard.outcome.report is not None and wizard.outcome.pairs == state.complete_pairs)


def careless(state, sigma_px=6.0):
    """The same pairs, clicked carelessly."""
    rng = np.random.default_rng(5)
    for pair in state.pairs:
        moved = tuple((np.array(pair.proximity) + rng.normal(0, sigma_px, 2)).tolist())
        state = state.with_pair(pair.model_copy(update={"proximity": moved}))
    return state


def test_a_worse_calibration_asks_before_it_replaces_a_better_one(open_wizard, scene, frames, feed, document, qtbot):
    document.edit(GEOMETRY, scene.T_p_t.tolist())
    before = document.preset.alignment
    wizard = open_wizard()
    fitted(qtbot, wizard, careless(with_pairs(scene, frames, feed, dots=range(0, 63, 16))))
    QTest.mouseClick(wizard.save, LEFT)
    words = answer_question(qtbot, "Cancel")
    assert "worse than the present" in words and "px new" in words and "px present" in words
    assert document.preset.alignment == before
    QTest.keyClick(wizard, Qt.Key.Key_S, CONTROL)
    answer_question(qtbot, "Replace anyway")
    qtbot.waitUntil(lambda: document.preset.alignment != before)


def test_a_better_calibration_is_saved_without_a_question_also_twice(open_wizard, scene, frames, feed, document, qtbot):
    wizard = open_wizard()
    state = careless(with_pairs(scene, frames, feed), sigma_px=0.3)
    fitted(qtbot, wizard, state)
    for _ in range(2):
        with qtbot.waitSignal(wizard.saved):
            QTest.mouseClick(wizard.save, LEFT)
    fewer = state.__class__(state.snapshots, state.pairs[:4]).with_choices(snapshot=state.choices.snapshot)
    fitted(qtbot, wizard, fewer)
    QTest.mouseClick(wizard.save, LEFT)
    assert "worse" in answer_question(qtbot, "Cancel"), "four pairs do not replace what 26 gave"


def test_present_stays_the_old_alignment_until_the_file_is_saved(
    open_wizard, scene, frames, feed, document, qtbot, tmp_path
):
    wizard = open_wizard()
    before = document.preset.alignment
    fitted(qtbot, wizard, with_pairs(scene, frames, feed))
    wizard.go_to(5)
    page = wizard.check
    qtbot.waitUntil(lambda: page.image.empty_label.text() == "" and "cm²" in page.note.text(), timeout=60_000)
    with qtbot.waitSignal(wizard.saved):
        QTest.mouseClick(wizard.save, LEFT)
    assert document.preset.alignment != before
    assert page.present_preset().alignment == before
    new = page.image.grab().toImage()
    QTest.mouseClick(page.which.button(1), LEFT)
    qtbot.waitUntil(lambda: page.image.grab().toImage() != new)
    document.save(tmp_path / "saved.json")
    assert page.present_preset().alignment == document.preset.alignment


def test_a_fresh_wizard_has_nothing_to_save_and_says_why(open_wizard, scene, frames, feed, qtbot):
    wizard = open_wizard()
    assert not wizard.save.isEnabled()
    assert "0 pairs; 4 are needed" in wizard.save.toolTip()
    wizard.session.click("proximity", 100.0, 100.0)
    wizard.session.click("tactile", 80.0, 100.0)
    qtbot.waitUntil(lambda: "1 pair; 3 pairs more" in wizard.save.toolTip())
    fitted(qtbot, wizard, with_pairs(scene, frames, feed))
    assert wizard.save.isEnabled() and "Ctrl+S" in wizard.save.toolTip()


def test_after_saving_into_the_preset_its_file_can_be_saved(
    open_wizard, scene, frames, feed, document, qtbot, tmp_path
):
    document.save(tmp_path / "tiny.json")
    wizard = open_wizard()
    wizard.fileSaveRequested.connect(lambda: document.save(tmp_path / "tiny.json"))
    fitted(qtbot, wizard, with_pairs(scene, frames, feed))
    QTest.mouseClick(wizard.save, LEFT)
    qtbot.waitUntil(lambda: wizard.messages.message("saved") is not None)
    assert "file is not saved yet" in wizard.messages.message("saved").sentence
    press(wizard.messages.message("saved"), "Save preset")
    assert not document.dirty
    assert load_preset(tmp_path / "tiny.json").alignment.calibration is not None
    assert "tiny.json" in wizard.messages.message("saved").sentence
