"""What happens to the preset and its file when a calibration is saved."""

import numpy as np
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest

from hands import answer_question, press
from pairs import moved, with_pairs
from tactune.core.sources.presets import load_preset

LEFT = Qt.MouseButton.LeftButton
CONTROL = Qt.KeyboardModifier.ControlModifier
SAVE = 3


def fitted(qtbot, wizard, state):
    wizard.session.edit("all", state)
    qtbot.waitUntil(lambda: wizard.outcome.report is not None and wizard.outcome.pairs == state.complete_pairs)


def careless(state, sigma_px=2.5):
    """The same pairs, clicked carelessly."""
    rng = np.random.default_rng(5)
    for pair in state.pairs:
        state = state.with_pair(moved(pair, *rng.normal(0, sigma_px, 2).tolist()))
    return state


def test_a_worse_calibration_asks_before_it_replaces_a_better_one(open_wizard, scene, frames, feed, document, qtbot):
    wizard = open_wizard()
    fitted(qtbot, wizard, careless(with_pairs(scene, frames, feed), sigma_px=0.3))
    wizard.go_to(SAVE)
    with qtbot.waitSignal(feed.context.saveRequested):
        QTest.mouseClick(wizard.save, LEFT)
    before = document.preset.alignment
    fitted(qtbot, wizard, careless(with_pairs(scene, frames, feed, dots=range(0, 63, 16))))
    assert wizard.steps.button(SAVE).text().endswith("!")
    QTest.mouseClick(wizard.save, LEFT)
    words = answer_question(qtbot, "Cancel")
    assert "px new" in words and "px present" in words
    assert document.preset.alignment == before
    QTest.keyClick(wizard, Qt.Key.Key_S, CONTROL)
    answer_question(qtbot, "Replace anyway")
    qtbot.waitUntil(lambda: document.preset.alignment != before)


def test_a_better_calibration_is_saved_without_a_question_also_twice(open_wizard, scene, frames, feed, document, qtbot):
    wizard = open_wizard()
    state = careless(with_pairs(scene, frames, feed), sigma_px=0.3)
    fitted(qtbot, wizard, state)
    wizard.go_to(SAVE)
    for _ in range(2):
        with qtbot.waitSignal(feed.context.saveRequested):
            QTest.mouseClick(wizard.save, LEFT)
    fewer = state.__class__(state.snapshots, state.pairs[:4]).with_choices(snapshot=state.choices.snapshot)
    fitted(qtbot, wizard, fewer)
    QTest.mouseClick(wizard.save, LEFT)
    answer_question(qtbot, "Cancel")  # four pairs do not replace what 26 gave unasked


def test_next_and_save_wait_for_what_the_footer_says(open_wizard, scene, frames, feed, document, qtbot):
    wizard = open_wizard()
    QTest.keyClick(wizard, Qt.Key.Key_PageDown, CONTROL)
    assert "No snapshot yet" in wizard.verdict.text() and wizard.stack.currentIndex() == 0
    assert not wizard.next.isEnabled()
    wizard.session.click("proximity", 100.0, 100.0)
    wizard.session.click("tactile", 80.0, 100.0)
    QTest.keyClick(wizard, Qt.Key.Key_4, CONTROL)
    QTest.keyClick(wizard, Qt.Key.Key_S, CONTROL)
    assert "1 pair; 3 pairs more" in wizard.verdict.text() and "Find points" in wizard.verdict.text()
    assert not wizard.save.isEnabled() and document.undo_stack.count() == 0
    fitted(qtbot, wizard, with_pairs(scene, frames, feed))
    qtbot.waitUntil(wizard.save.isEnabled)
    step = wizard.quality.step.text().removeprefix("Next: ")
    assert step and step not in wizard.verdict.text(), "the next step is said once, on the page Quality"


def test_a_file_that_was_not_saved_is_said_and_saved_later(open_wizard, scene, frames, feed, document, qtbot, tmp_path):
    wizard = open_wizard()
    fitted(qtbot, wizard, with_pairs(scene, frames, feed))
    QTest.keyClick(wizard, Qt.Key.Key_S, CONTROL)  # nobody answers the request, as if the dialog were cancelled
    assert "file is not saved yet" in wizard.messages.by_key["saved"].sentence
    feed.context.saveRequested.connect(lambda: document.save(tmp_path / "tiny.json"))
    press(wizard.messages.by_key.get("saved"), "Save preset")
    assert not document.dirty
    assert "tiny.json" in wizard.messages.by_key["saved"].sentence
    assert load_preset(tmp_path / "tiny.json").alignment.calibration is not None
    assert wizard.steps.button(SAVE).text().endswith("✓")
