"""Suggestions in the window, by mouse and keys."""

import time
from threading import Event

from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtTest import QTest

from hands import CONTROL, LEFT, drag_slider, show_source, tolerance_slider
from printed_source import PrintedSource
from tactune.app.advice import window as suggest_window


def ask(qtbot, main, section="mask"):
    """Press a button Suggest and wait for the suggestions."""
    button = main.panel.suggests[section]
    main.panel.ensureWidgetVisible(button)
    QTest.mouseClick(button, LEFT)
    qtbot.waitUntil(lambda: main.suggest.window is not None and main.suggest.window.isActiveWindow())
    qtbot.waitUntil(lambda: not main.suggest.window.job.busy)
    return main.suggest.window


def test_a_suggested_mask_is_compared_applied_as_one_step_and_undone(main, qtbot, tmp_path):
    before = main.document.preset
    window = ask(qtbot, main)
    [card] = window.cards
    assert "prints" in card.evidence.text()
    low, high = card.changes["mask.hue"]
    assert low <= 159 <= high, "the hue of the prints"
    present, suggested = main.context.comparison.sides
    assert present.preset is before
    assert suggested.preset.mask.enabled

    QTest.mouseClick(window.apply, LEFT)
    after = main.document.preset
    assert after.mask.enabled
    assert after.mask.hue == (low, high)
    assert main.context.comparison.sides is None
    assert main.document.undo_stack.count() == 1
    assert main.document.undo_stack.undoText() == card.proposal.label
    assert not window.apply.isEnabled()
    assert window.sentence.text().startswith("Applied: ")

    QTest.keyClick(window, Qt.Key.Key_Z, CONTROL)
    qtbot.waitUntil(lambda: main.document.preset is before)
    main.document.save(tmp_path / "mine.json")
    QTest.mouseClick(window.apply, LEFT)
    assert main.document.dirty
    QTest.keyClick(window, Qt.Key.Key_S, CONTROL)
    qtbot.waitUntil(lambda: not main.document.dirty)


def test_suggest_all_by_keys_takes_only_what_is_ticked(main, qtbot):
    QTest.keyClick(main, Qt.Key.Key_J, CONTROL)
    qtbot.waitUntil(lambda: main.suggest.window is not None and not main.suggest.window.job.busy)
    window = main.suggest.window
    qtbot.waitUntil(lambda: len(window.cards) > 0)
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow)
    ticked = [card for card in window.cards if card.take.isChecked()]
    assert any(card.proposal.section == "mask" for card in ticked)
    for card in ticked:
        QTest.mouseClick(card.take, LEFT, pos=QPoint(8, card.take.height() // 2))
    assert not window.apply.isEnabled()
    assert main.context.comparison.sides is None
    mask = next(card for card in ticked if card.proposal.section == "mask")
    QTest.mouseClick(mask.take, LEFT, pos=QPoint(8, mask.take.height() // 2))
    before = main.document.preset
    QTest.keyClick(window, Qt.Key.Key_Return, CONTROL)
    qtbot.waitUntil(lambda: main.document.preset is not before)
    assert main.document.preset.mask.enabled
    assert main.document.preset.alignment == before.alignment
    assert main.document.undo_stack.count() == 1


def test_closing_ends_the_comparison_and_changes_nothing(main, qtbot):
    before = main.document.preset
    window = ask(qtbot, main)
    assert main.context.comparison.sides is not None
    QTest.keyClick(window, Qt.Key.Key_Escape)
    assert not window.isVisible()
    assert main.context.comparison.sides is None
    assert main.document.preset is before
    drag_slider(tolerance_slider(main), 0.3, 0.5)
    assert main.document.undo_stack.count() == 1
    assert main.context.comparison.sides is None, "an edit does not start it again"


def test_suggestions_of_a_source_that_was_left_while_they_were_made_are_dropped(main, qtbot, monkeypatch):
    found, go_on = suggest_window.find_suggestions, Event()

    def late(*arguments):
        go_on.wait(60)
        return found(*arguments)

    monkeypatch.setattr(suggest_window, "find_suggestions", late)
    QTest.mouseClick(main.panel.suggests["mask"], LEFT)
    show_source(qtbot, main, PrintedSource(), 6)
    go_on.set()
    window = main.suggest.window
    qtbot.waitUntil(lambda: not window.job.busy)
    assert window.sentence.text() == "Another source was opened: measure again." and not window.cards


def test_measuring_can_be_cancelled(main, qtbot, monkeypatch):
    def endless(evidence, progress, sections):
        while True:
            time.sleep(0.005)
            progress(0.5, "Measuring")

    monkeypatch.setattr(suggest_window, "suggest_all", endless)
    QTest.mouseClick(main.panel.suggests["mask"], LEFT)
    window = main.suggest.window
    qtbot.waitUntil(lambda: window.sentence.text() == "Measuring…")
    QTest.mouseClick(window.cancel, LEFT)
    qtbot.waitUntil(lambda: not window.job.busy)
    assert window.sentence.text() == "Cancelled; nothing was changed."
    monkeypatch.undo()
    QTest.mouseClick(window.again, LEFT)
    qtbot.waitUntil(lambda: not window.job.busy and len(window.cards) == 1)
