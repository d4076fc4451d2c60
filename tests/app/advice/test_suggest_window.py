"""Suggestions in the window, by mouse and keys."""

from dataclasses import replace
from threading import Event

import numpy as np
import pytest
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtTest import QTest

from fakes import CONTACT_RGB, FakeSource, tiny_frame, tiny_rig
from hands import CONTROL, LEFT, drag_slider, show_source, tolerance_slider
from tactune.app.advice import window as suggest_window

PRINT_RGB = (214, 40, 160)
#: Rows and columns of the prints.
PRINTS = ((slice(8, 28), slice(8, 28)), (slice(90, 112), slice(130, 152)))


class PrintedSource(FakeSource):
    """Frames of 160 x 120 pixels before a wall 60 mm behind; a disc of 2 mm gap grows with the frame number."""

    def __init__(self):
        super().__init__(rig=tiny_rig(160, 120), name="printed")

    def read(self, index):
        frame = tiny_frame(index, self.rig)
        membrane = np.rint(frame.tactile_depth * self.rig.tactile.depth_unit_m / self.rig.proximity.depth_unit_m)
        touching = (frame.proximity_color == CONTACT_RGB).all(axis=2)
        depth = np.where(touching, frame.proximity_depth, membrane + 0.06 / self.rig.proximity.depth_unit_m)
        color = frame.proximity_color.copy()
        for place in PRINTS:  # they reflect infrared, so the proximity camera measures the membrane there
            depth[place], color[place] = membrane[place], PRINT_RGB
        return replace(frame, proximity_depth=depth.astype(np.uint16), proximity_color=color)

    def untouched(self):
        return self.read(-4)  # no disc yet


def ask(qtbot, main, section="mask"):
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


@pytest.fixture
def main(window, qtbot):
    """A window at frame 6 of the printed membrane, its mask off."""
    show_source(qtbot, window, PrintedSource(), 6)
    return window
