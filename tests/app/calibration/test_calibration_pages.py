"""Single pages and windows of the wizard: snapshots, helpers, check, saved state."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest

from hands import LEFT
from pairs import moved, snapshot_of, with_pairs
from tactune.app.calibration.correspondence import overlay, proximity_partner, tactile_partner
from tactune.app.calibration.fitting import fit
from tactune.app.calibration.keeping import Keeper
from tactune.app.calibration.session import Session, SessionState
from tactune.app.worker.playback import PlaybackState
from tactune.core.calibration.geometry import Alignment

SAVE = 3


# Frames


def recorded(frames, length, *indices):
    """Frames of a looped recording, and where they lie in it."""
    for index in indices:
        yield replace(frames[0.2], sequence=index), PlaybackState(index=index, length=length, playing=True)


def test_a_snapshot_ends_where_a_recording_begins_again(open_wizard, feed, frames, qtbot):
    wizard = open_wizard()
    first, *others = recorded(frames, 9, 6, 7, 8, 0, 1)
    feed.deliver(*first)
    QTest.mouseClick(wizard.frames.take, LEFT)
    for frame, playback in others:
        feed.deliver(frame, playback)
    qtbot.waitUntil(lambda: len(wizard.session.state.snapshots) == 1)
    taken = wizard.session.state.snapshots[0]
    assert (taken.name, taken.averaged) == ("Frames 6 to 8", 3)
    assert "Averaged 3 frames instead of 10" in wizard.frames.note.text()


@pytest.mark.parametrize("length", [9, None])
def test_a_snapshot_ends_where_the_membrane_moves(open_wizard, feed, frames, qtbot, length):
    wizard = open_wizard()
    for index, level in enumerate((0.2, 0.2, 1.0)):
        if index == 1:
            QTest.mouseClick(wizard.frames.take, LEFT)
        frame = replace(frames[level], sequence=index)
        feed.deliver(frame, PlaybackState(index=index, length=length, playing=False))
    qtbot.waitUntil(lambda: len(wizard.session.state.snapshots) == 1)
    taken = wizard.session.state.snapshots[0]
    assert (taken.name, taken.averaged) == ("Frames 0 to 1", 2)
    assert "Averaged 2 frames instead of 10: then the membrane moved" in wizard.frames.note.text()
    np.testing.assert_array_equal(taken.frame.tactile_depth, frames[0.2].tactile_depth)


# Pictures and predictions


def test_partners_are_found_both_ways(scene, frames):
    alignment = Alignment(pose=scene.T_p_t)
    left, right = scene.proximity_pixels(1.0), scene.tactile_pixels(1.0)
    for dot in (5, 31, 50):
        found = proximity_partner(alignment, scene.rig, frames[1.0], "color", tuple(right[dot]))
        assert found == pytest.approx(tuple(left[dot]), abs=0.05)
        found = tactile_partner(alignment, scene.rig, frames[1.0], "color", tuple(left[dot]))
        assert found == pytest.approx(tuple(right[dot]), abs=0.05)
    assert tactile_partner(alignment, scene.rig, frames[1.0], "color", (-5000.0, 0.0)) is None


# Points


def test_a_wrong_pair_is_rejected_highlighted_and_named(open_wizard, scene, frames, feed, qtbot, hand):
    state = with_pairs(scene, frames, feed)
    wizard = open_wizard()
    wizard.session.edit("all", state.with_pair(moved(state.pairs[4], 25, -11)))
    qtbot.waitUntil(lambda: wizard.outcome.report is not None)
    rows = {row.pair.id: row for row in wizard.points.table.records()}
    assert [name for name, row in rows.items() if row.marked] == ["5"]
    assert "Rejected" in rows["5"].note
    assert "pair 5" in wizard.quality.step.text()

    wizard.go_to(2)
    quality_map = wizard.quality.map
    qtbot.waitUntil(lambda: bool(quality_map.layer.marks) and not wizard.quality.job.busy)
    wrong = next(mark for mark in quality_map.layer.marks if mark.key == "5")
    hand.click(quality_map, (wrong.u, wrong.v))
    assert wizard.session.selected == ("5",)

    wizard.go_to(1)
    shown = wizard.points.table.model()
    assert shown.index(0, 0).data() == "5", "the worst is on top"
    assert wizard.points.drop.text().replace("&", "") == "Remove 1 rejected pair"
    QTest.mouseClick(wizard.points.drop, LEFT)
    assert [pair.id for pair in wizard.session.state.pairs] == [name for name in rows if name != "5"]
    qtbot.waitUntil(lambda: not wizard.points.drop.isVisible())
    QTest.mouseClick(wizard.undo, LEFT)
    assert len(wizard.session.state.pairs) == len(rows)


def test_pairs_with_large_residuals_are_named_before_points_elsewhere(scene, frames, feed):
    state = with_pairs(scene, frames, feed, dots=(0, 1, 2, 9, 10, 11, 18, 19, 20, 27, 28, 29))  # none at the right
    assert "save it" in fit(state, scene.rig).report.verdict, "exact pairs need none elsewhere"
    shaken, rng = state, np.random.default_rng(0)
    for pair in state.pairs:
        shaken = shaken.with_pair(moved(pair, *rng.normal(0, 0.7, 2).tolist()))
    assert "Add points" in fit(shaken, scene.rig).report.verdict
    for key, (u, v) in ((7, (2.2, -2.0)), (18, (-2.1, 2.0))):
        state = state.with_pair(moved(state.pairs[key - 1], u, v))
    outcome = fit(state, scene.rig)
    report = outcome.report
    assert not report.chosen.excluded
    assert outcome.standing_out == {"7", "18"}
    assert "Click pairs" in report.verdict
    assert {"7", "18"} == set(report.verdict.split("Click pairs ")[1].split(" again")[0].split(" and "))


# Find points


def chessboard_snapshot(frames, feed):
    """A snapshot of a board with 10 x 7 inner corners, 8 px farther left in the tactile image."""
    squares = (np.indices((8, 11)).sum(axis=0) % 2 * 255).astype(np.uint8)
    board = np.full((240, 320), 255, np.uint8)
    board[30 : 30 + 8 * 20, 40 : 40 + 11 * 20] = cv2.resize(squares, (220, 160), interpolation=cv2.INTER_NEAREST)
    color = np.repeat(board[:, :, None], 3, axis=2)
    frame = replace(frames[0.2], sequence=0, proximity_color=color, tactile_color=np.roll(color, -8, axis=1))
    return snapshot_of(frame, feed)


def test_a_chessboard_is_found_and_undone(open_wizard, feed, frames, qtbot):
    wizard = open_wizard()
    assert wizard.redo.toolTip() == "Redo (Ctrl+Shift+Z)"
    wizard.session.add_snapshot(chessboard_snapshot(frames, feed))
    QTest.mouseClick(wizard.steps.button(1), LEFT)
    finder = wizard.points.finder
    assert not finder.columns.isVisible()
    QTest.keyClick(finder.target, Qt.Key.Key_Down)
    assert finder.columns.isVisible()
    assert wizard.undo.toolTip() == "Undo Look for: Chessboard (Ctrl+Z)"
    finder.columns.setValue(10)
    finder.rows.setValue(7)
    QTest.mouseClick(finder.search, LEFT)
    qtbot.waitUntil(lambda: len(wizard.session.state.pairs) == 70)
    first = wizard.session.state.pairs[0]
    assert first.tactile == pytest.approx((first.proximity[0] - 8, first.proximity[1]), abs=0.05)
    assert not wizard.session.selected and "70 pairs found" in finder.words.text()
    QTest.mouseClick(finder.search, LEFT)
    qtbot.waitUntil(lambda: "70 of them were pairs already" in finder.words.text())

    assert wizard.undo.toolTip() == "Undo Find 70 pairs (Ctrl+Z)"
    QTest.mouseClick(wizard.undo, LEFT)
    assert not wizard.session.state.pairs and not finder.words.isVisible()
    while wizard.undo.isEnabled():
        QTest.mouseClick(wizard.undo, LEFT)
    assert finder.target.currentText() == "Membrane texture" and not finder.columns.isVisible()


def test_next_waits_for_the_search_and_the_search_can_be_cancelled(open_wizard, feed, frames, qtbot, monkeypatch):
    def endless(choices, snapshots, rig, progress):
        while True:
            progress(0.5, "Searching")

    monkeypatch.setattr("tactune.app.calibration.finder.find_pairs", endless)
    wizard = open_wizard()
    wizard.session.add_snapshot(chessboard_snapshot(frames, feed))
    wizard.go_to(1)
    QTest.keyClick(wizard, Qt.Key.Key_F, Qt.KeyboardModifier.ControlModifier)
    finder = wizard.points.finder
    qtbot.waitUntil(finder.running.cancel.isVisible)
    assert "not complete" in wizard.verdict.text() and not wizard.next.isEnabled()
    QTest.mouseClick(finder.running.cancel, LEFT)
    qtbot.waitUntil(lambda: "Cancelled" in finder.words.text())
    assert finder.search.isEnabled() and not wizard.session.state.pairs


def test_every_page_is_undone(open_wizard, scene, frames, feed, qtbot):
    wizard = open_wizard()
    before = wizard.session.state
    wizard.session.edit("all", with_pairs(scene, frames, feed))
    qtbot.waitUntil(lambda: wizard.outcome.report is not None)
    wizard.go_to(2)
    wizard.quality.model.setFocus()
    QTest.keyClicks(wizard.quality.model, "H")
    qtbot.waitUntil(lambda: wizard.outcome.report.model == "homography")
    assert wizard.steps.button(2).text().endswith("!")
    wizard.go_to(0)
    taken, kept = wizard.session.state.snapshots
    page, images = wizard.frames, []
    for _ in range(3):
        images.append(page.previews["tactile", "depth"].grab().toImage())
        QTest.mouseClick(page.list.viewport(), LEFT, pos=page.list.visualItemRect(page.list.item(1)).center())
    assert images[0] == images[2] != images[1] and "as taken" in page.note.text(), "shown, no longer, and shown again"
    page.list.setCurrentRow(0)
    QTest.mouseClick(page.remove, LEFT)
    left = wizard.session.state
    assert {left.snapshot_of(pair) for pair in left.pairs} == {kept} and taken not in left.snapshots
    assert wizard.undo.toolTip() == "Undo Remove a snapshot (Ctrl+Z)"
    for _ in range(3):
        QTest.keyClick(wizard, Qt.Key.Key_Z, Qt.KeyboardModifier.ControlModifier)
    assert wizard.session.state == before


# Check


def test_the_overlay_fits_with_the_true_pose_and_not_with_a_wrong_one(scene, frames):
    def difference(pose):
        tactile, both = (
            image[..., 0].astype(float) for image in overlay(Alignment(pose=pose), scene.rig, frame, "color")
        )
        np.testing.assert_array_equal(both[hidden], tactile[hidden])
        return np.abs(both - tactile).mean()

    depth = frames[1.0].tactile_depth.copy()
    depth[100:140] = 0
    frame, hidden = replace(frames[1.0], tactile_depth=depth), depth == 0
    moved = scene.T_p_t.copy()
    moved[0, 3] += 0.004
    assert difference(scene.T_p_t) < 0.4 * difference(moved)


def test_the_check_page_shows_both_alignments(open_wizard, scene, frames, feed, qtbot):
    wizard = open_wizard()
    page = wizard.check
    wizard.session.add_snapshot(snapshot_of(frames[0.2], feed))
    wizard.go_to(SAVE)
    qtbot.waitUntil(lambda: "No calibration yet" in page.image.notice.text())
    wizard.session.edit("all", with_pairs(scene, frames, feed))
    qtbot.waitUntil(lambda: page.image.notice.text() == "")
    assert "px new" in page.errors.text() and "px present" in page.errors.text()
    shown = page.image.grab().toImage()
    QTest.keyClick(page.share, Qt.Key.Key_End)
    assert page.image.grab().toImage() != shown
    QTest.keyClick(page.share, Qt.Key.Key_Home)
    new = page.image.grab().toImage()
    QTest.mouseClick(page.which.button(1), LEFT)
    qtbot.waitUntil(lambda: page.image.grab().toImage() != new)


# Kept state


def test_two_windows_on_one_rig_keep_apart_and_share_images(scene, frames, feed, tmp_path, qapp):
    sessions = [Session(scene.rig) for _ in range(2)]
    keepers = [Keeper(session, tmp_path) for session in sessions]
    assert keepers[0].file != keepers[1].file
    for session in sessions:
        session.edit("all", with_pairs(scene, frames, feed))
    for keeper in keepers:
        keeper.flush()
        keeper.wait()
    sessions[1].edit("Start over", SessionState())
    for keeper in reversed(keepers):
        keeper.close()
    assert len(list(tmp_path.glob("snapshot-*.npz"))) == len(sessions[0].state.snapshots) > 0


def places_of(state):
    return [(pair.id, pair.proximity, pair.tactile, pair.tactile_depth_m) for pair in state.pairs]


@pytest.mark.parametrize("damage", ["lost", "half"])
def test_lost_or_damaged_images_keep_their_points(scene, frames, feed, tmp_path, qapp, damage):
    session = Session(scene.rig)
    keeper = Keeper(session, tmp_path)
    state = with_pairs(scene, frames, feed)
    session.edit("all", state)
    keeper.close()
    file = next(iter(tmp_path.glob("snapshot-*.npz")))
    data = file.read_bytes()
    file.unlink()
    if damage == "half":
        file.write_bytes(data[: len(data) // 2])

    again = Session(scene.rig)
    second = Keeper(again, tmp_path)
    assert second.restore() is not None
    assert places_of(again.state) == places_of(state)
    assert {again.state.snapshot_of(pair) for pair in again.state.pairs} == {None, *again.state.snapshots}
    second.close()
