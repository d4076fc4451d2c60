"""A complete calibration by mouse and keys, from the first snapshot to the preset, and then headless."""

from dataclasses import replace

import numpy as np
import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication

from hands import CONTROL, LEFT
from tactune.app.worker.playback import PlaybackState
from tactune.core.contact.alignment import tactile_pose
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.sources.presets import load_preset

pytestmark = pytest.mark.usefixtures("qapp")

#: Dots that are clicked, spread over the membrane.
CORNERS = (1, 7, 55, 61, 31, 21)
SHIFT = Qt.KeyboardModifier.ShiftModifier


def press_button(button):
    QTest.mouseClick(button, LEFT)


def take_first(wizard, feed, frames, qtbot):
    """Take a snapshot of the frame on the screen: the membrane moves after it."""
    press_button(wizard.frames.take)
    feed.deliver(frames[1.0], PlaybackState(index=1, length=2))
    qtbot.waitUntil(lambda: len(wizard.session.state.snapshots) == 1)


def choose(box, index):
    box.setFocus()
    QTest.keyClick(box, Qt.Key.Key_Home)
    for _ in range(index):
        QTest.keyClick(box, Qt.Key.Key_Down)


def test_a_whole_calibration_by_mouse_and_keys(  # noqa: PLR0915 - one flow, step by step
    open_wizard, hand, scene, frames, feed, document, qtbot, tmp_path
):
    wizard = open_wizard()
    state = lambda: wizard.session.state

    # Frames: two inflation levels
    take_first(wizard, feed, frames, qtbot)
    first = state().choices.snapshot
    press_button(wizard.frames.take)
    feed.deliver(frames[0.2], PlaybackState(index=0, length=2))
    qtbot.waitUntil(lambda: len(state().snapshots) == 2)
    second = state().choices.snapshot
    press_button(wizard.next)
    assert wizard.stack.currentIndex() == 1
    page = wizard.points
    left, right = page.images["proximity"], page.images["tactile"]
    QApplication.processEvents()

    # Points: six pairs on the high level, clicked beside the dots, either side first; snapping puts them right
    places = {level: (scene.proximity_pixels(level), scene.tactile_pixels(level)) for level in (0.2, 1.0)}

    def click_pair(level, dot, right_first=False):
        sides = [(left, places[level][0][dot]), (right, places[level][1][dot])]
        for image, place in reversed(sides) if right_first else sides:
            hand.click(image, place + np.array((1.6, -1.2)))

    for number, dot in enumerate(CORNERS):
        click_pair(1.0, dot, right_first=number % 2 == 1)
    assert len(state().complete_pairs) == 6
    for pair, dot in zip(state().pairs, CORNERS, strict=True):
        np.testing.assert_allclose(pair.proximity, places[1.0][0][dot], atol=0.12)
        np.testing.assert_allclose(pair.tactile, places[1.0][1][dot], atol=0.12)
        assert pair.proximity_image == "color"
        assert pair.snapshot == 1
        assert pair.tactile_depth_m == pytest.approx(tactile_depth(scene, 1.0, dot), abs=4e-4)
    shown = page.image.currentIndex()
    choose(page.image, 1 - shown)
    assert not left.layer.marks, "they were clicked in the other image"
    choose(page.image, shown)
    assert len(left.layer.marks) == 6

    # The other level, through the combo box
    choose(page.snapshot, 0)
    assert state().choices.snapshot == first
    for dot in (10, 52):
        click_pair(0.2, dot)
    assert len(state().complete_pairs) == 8

    # Drag one away: the fit shows it; undo brings it back
    before = state().pairs[6].proximity
    hand.drag(left, before, (before[0] + 30, before[1] + 9))
    assert np.hypot(*(np.array(state().pairs[6].proximity) - before)) > 20
    QTest.keyClick(wizard, Qt.Key.Key_Z, CONTROL)
    assert state().pairs[6].proximity == before

    # Delete one by its row, and undo
    model = page.table.model()
    index = next(model.index(n, 3) for n in range(model.rowCount()) if model.index(n, 0).data() == "3")
    page.table.scrollTo(index)
    row = page.table.visualRect(index)
    QTest.mouseClick(page.table.viewport(), LEFT, Qt.KeyboardModifier.NoModifier, row.center())
    assert wizard.session.selected == ("3",)
    QTest.keyClick(page.table, Qt.Key.Key_Delete)
    assert [pair.id for pair in state().pairs] == list("1245678")
    QTest.keyClick(wizard, Qt.Key.Key_Z, CONTROL)
    assert [pair.id for pair in state().pairs] == list("12345678")

    # Ghosts: the partner is predicted and accepted with one key
    qtbot.waitUntil(lambda: wizard.outcome.report is not None and wizard.outcome.pairs == state().complete_pairs)
    choose(page.snapshot, 0)
    for dot in (40, 16):
        hand.click(left, places[0.2][0][dot] + np.array((1.0, 1.0)))
        assert page.ghost is not None and page.ghost[0] == "tactile"
        QTest.keyClick(left, Qt.Key.Key_Return)
        np.testing.assert_allclose(state().pairs[-1].tactile, places[0.2][1][dot], atol=0.12)
        qtbot.waitUntil(lambda: wizard.outcome.pairs == state().complete_pairs)

    # Nudge by keys: a tenth there and back
    nudged = state().pairs[-1].proximity
    QTest.keyClick(left, Qt.Key.Key_Right, SHIFT)
    assert state().pairs[-1].proximity == (pytest.approx(nudged[0] + 0.1), nudged[1])
    QTest.keyClick(wizard, Qt.Key.Key_Z, CONTROL)
    assert state().pairs[-1].proximity == nudged

    # While the partner is awaited, others can be dragged; a click beside one places it and selects nothing else
    hand.click(left, (places[0.2][0][25] + places[0.2][0][24]) / 2)
    assert state().pending is not None and page.ghost is None, "nothing to snap to: the fit would confirm itself"
    hand.click(left, places[0.2][0][25])
    before = state().pairs[9].tactile
    hand.drag(right, before, (before[0] + 30, before[1] + 9))
    assert state().pending is not None and np.hypot(*(np.array(state().pairs[9].tactile) - before)) > 20
    hand.click(right, places[0.2][1][40] + np.array((1.0, 1.0)))
    assert state().pending is None
    assert wizard.session.selected == (state().pairs[-1].id,) == ("11",)
    np.testing.assert_allclose(state().pairs[-1].tactile, places[0.2][1][40], atol=0.12)
    for _ in range(4):
        QTest.keyClick(wizard, Qt.Key.Key_Z, CONTROL)
    assert len(state().pairs) == 10 and state().pairs[9].tactile == before

    # Quality with the model, save
    qtbot.waitUntil(lambda: not wizard.fitter.job.busy)
    QTest.keyClick(wizard, Qt.Key.Key_3, CONTROL)
    assert wizard.stack.currentIndex() == 2
    report = wizard.outcome.report
    assert report is not None and report.recommended == "rigid"
    assert "depth" in wizard.quality.reason.text()
    assert wizard.quality.grade.text() in {"Good", "Usable"}
    press_button(wizard.next)
    with qtbot.waitSignal(feed.context.saveRequested):
        press_button(wizard.save)
    assert document.undo_stack.count() == 1

    # Headless from here on
    path = tmp_path / "membrane.json"
    document.save(path)
    preset = load_preset(path)
    assert scene.alignment_error_px(tactile_pose(preset.alignment, scene.rig)) < 0.25
    assert scene.alignment_error_px(np.asarray(scene.rig.T_proximity_tactile)) > 1
    record = preset.alignment.calibration
    assert [point.id for point in record.points] == [str(number) for number in range(1, 11)]
    assert {snapshot.sha256 for snapshot in record.snapshots} == {first, second}
    assert record.tactile_serial == "t1"
    assert ContactPipeline(preset, scene.rig).process(frames[1.0]).mask.shape == (240, 320)
    document.undo_stack.undo()
    assert document.preset.alignment.calibration is None


def tactile_depth(scene, level, dot):
    T = np.linalg.inv(scene.T_p_t)
    return float((T[:3, :3] @ scene.points(level)[dot] + T[:3, 3])[2])


def test_nothing_is_lost_by_closing(open_wizard, hand, feed, frames, scene, qtbot):
    wizard = open_wizard()
    take_first(wizard, feed, frames, qtbot)
    QTest.keyClick(wizard, Qt.Key.Key_2, CONTROL)
    left = wizard.points.images["proximity"]
    QApplication.processEvents()
    hand.click(left, scene.proximity_pixels(0.2)[30])
    kept = wizard.session.state
    assert kept.pending is not None
    press_button(wizard.leave)

    again = open_wizard()
    assert again.session.state.pairs == kept.pairs
    assert again.session.state.choices == kept.choices
    assert [snap.digest for snap in again.session.state.snapshots] == [snap.digest for snap in kept.snapshots]
    np.testing.assert_array_equal(again.session.state.snapshots[0].frame.tactile_depth, frames[0.2].tactile_depth)
    assert again.stack.currentIndex() == 1
    assert "Restored the calibration of tiny" in again.restored.text()
    assert again.restored.text().endswith(": 0 pairs, 1 snapshot.")
    QTest.keyClick(again, Qt.Key.Key_1, CONTROL)
    assert not again.restored.isVisible()

    press_button(again.over)
    assert again.session.state.empty
    QTest.keyClick(again, Qt.Key.Key_Z, CONTROL)
    assert again.session.state.pairs == kept.pairs


def test_a_restored_calibration_of_another_source_says_so(open_wizard, feed, frames, qtbot):
    wizard = open_wizard()
    take_first(wizard, feed, frames, qtbot)
    press_button(wizard.leave)
    feed.info = replace(feed.info, name="other")
    feed.deliver(frames[0.2], PlaybackState(index=0, length=2))

    again = open_wizard()
    assert again.stack.currentIndex() == 0, "the page on which snapshots of this source are taken"
    sentence = again.restored.text()
    assert again.restored.isVisible() and "calibration of tiny" in sentence and "other is open now" in sentence
    assert again.frames.list.item(0).text().endswith("tiny")


def test_points_file_round_trip(open_wizard, scene, qtbot, tmp_path):
    wizard = open_wizard()
    proximity, tactile = scene.proximity_pixels(0.2), scene.tactile_pixels(0.2)
    for dot in (0, 8, 40, 60):
        wizard.session.click("proximity", *proximity[dot])
        wizard.session.click("tactile", *tactile[dot])
    wizard.session.enable("2", False)
    before = [(pair.proximity, pair.tactile, pair.enabled, pair.proximity_image) for pair in wizard.session.state.pairs]
    path = tmp_path / "points.csv"
    wizard.export_points(path)
    wizard.start_over()
    wizard.import_points(path)
    after = [(pair.proximity, pair.tactile, pair.enabled, pair.proximity_image) for pair in wizard.session.state.pairs]
    assert after == before
    assert wizard.session.undo_stack.undoText() == "Import 4 pairs"

    wizard.import_points(tmp_path / "missing.csv")
    assert any("missing.csv" in sentence for sentence in wizard.messages.sentences())
