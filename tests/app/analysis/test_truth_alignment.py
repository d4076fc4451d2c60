"""An aligned scan follows the patch, is scored, moved, refined and saved, by real mouse and key events."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import numpy as np
import pytest
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication

from hands import CONTROL, LEFT, type_into, type_path
from tactune.app.analysis import truth_flow, truth_work
from tactune.app.cli.scan import parse_paint
from tactune.core.evaluation.scan.pose import load_transform
from tactune.widgets.clouds.pick_view import STEP_M
from truth_scene import (
    DISC_CENTRE_BESIDE,
    EndlessWork,
    click_pair,
    click_three_pairs,
    corners,
    drag,
    pixel_of,
    pose_of,
    settle,
    true_pose,
)

# Following


def test_the_patch_follows_until_alignment_begins(qtbot, ready, window):
    window.worker.seek(5)
    qtbot.waitUntil(lambda: "frame 6" in ready.views.patch_name.text())
    click_pair(ready, corners(ready)[0])
    window.worker.seek(6)
    qtbot.waitUntil(lambda: window.result.frame.sequence == 6)
    assert "frame 6" in ready.views.patch_name.text()
    QTest.mouseClick(ready.views.present, LEFT)
    assert ready.flow.state.patch.frame == 6
    assert len(ready.flow.state.pairs) == 1


def test_an_aligned_scan_is_scored_against_each_frame_while_it_follows(qtbot, ready, window):
    click_three_pairs(ready)
    qtbot.waitUntil(lambda: ready.flow.scores is not None)
    QTest.mouseClick(ready.views.follow, LEFT)
    window.worker.seek(7)
    qtbot.waitUntil(lambda: "Live: frame 8" in ready.views.patch_name.text())
    larger = ready.flow.patch.area_mm2
    qtbot.waitUntil(lambda: ready.flow.scores is not None and ready.flow.scores.patch_area_mm2 == larger)
    assert ready.result.values["patch_area"].text() == f"{larger:,.0f} mm²"
    assert "--frame 7" in ready.result.command.text()
    QTest.keyClick(ready.views.patch, Qt.Key.Key_Right, CONTROL)
    assert ready.flow.state.patch.frame == 7, "an edit holds the frame fast"


def test_a_change_is_drawn_once_and_the_scan_placed_once(qtbot, ready, window, monkeypatch):
    click_three_pairs(ready)
    QTest.mouseClick(ready.views.follow, LEFT)
    qtbot.waitUntil(lambda: ready.flow.scores is not None)
    drawn, placed = [], []
    draw, place = ready.views.patch.set_cloud, truth_work.scan_truth
    monkeypatch.setattr(ready.views.patch, "set_cloud", lambda cloud: drawn.append(1) or draw(cloud))
    monkeypatch.setattr(truth_work, "scan_truth", lambda *rest: placed.append(1) or place(*rest))
    for index in (5, 6, 7):
        window.worker.seek(index)
        qtbot.waitUntil(lambda index=index: f"Live: frame {index + 1} " in ready.views.patch_name.text())
        area = ready.flow.patch.area_mm2
        qtbot.waitUntil(lambda area=area: ready.flow.scores.patch_area_mm2 == area)
    assert len(drawn) == 3 and not placed
    QTest.keyClick(ready.views.patch, Qt.Key.Key_Right, CONTROL)
    assert len(drawn) == 4
    qtbot.waitUntil(lambda: len(placed) == 1)
    window.worker.seek(4)
    qtbot.waitUntil(lambda: window.result.frame.sequence == 4)
    QTest.mouseClick(ready.views.present, LEFT)
    assert "Held: frame 5 " in ready.views.patch_name.text() and len(drawn) == 5


# Nudging


def test_handles_keys_and_numbers_move_the_scan_and_are_undone(ready):
    QTest.mouseClick(ready.align.center, LEFT)
    laid = pose_of(ready)
    np.testing.assert_allclose(ready.flow.pivot(), ready.flow.patch.points.mean(axis=0), atol=1e-6)
    view = ready.views.patch
    start = pixel_of(view, DISC_CENTRE_BESIDE)
    drag(view, start, start + QPoint(40, 0), CONTROL)
    moved = pose_of(ready)
    right = view.camera().axes()[0]
    assert (moved - laid)[:3, 3] @ right > 0.005
    view.setFocus()
    QTest.keyClick(view, Qt.Key.Key_Right, CONTROL)
    np.testing.assert_allclose((pose_of(ready) - moved)[:3, 3], STEP_M * right, atol=1e-9)
    QTest.keyClick(view, Qt.Key.Key_Z, CONTROL)
    np.testing.assert_allclose(pose_of(ready), moved, atol=1e-12)
    QTest.keyClick(view, Qt.Key.Key_Z, CONTROL)
    np.testing.assert_allclose(pose_of(ready), laid, atol=1e-12)
    yaw = ready.align.turns[2]
    type_into(yaw, "22.9")
    np.testing.assert_allclose(pose_of(ready)[:3, :3], true_pose()[:3, :3], atol=2e-3)
    np.testing.assert_allclose(ready.flow.pivot(), ready.flow.patch.points.mean(axis=0), atol=1e-6)
    QTest.keyClick(yaw, Qt.Key.Key_Up)
    assert yaw.value() == pytest.approx(23.0)


# ICP, files and the command line


def test_icp_brings_the_scan_nearer_and_can_be_undone(qtbot, ready):
    click_three_pairs(ready)
    x = ready.align.places[0]
    x.setFocus()
    QTest.keyClick(x, Qt.Key.Key_PageUp)
    QTest.keyClick(x, Qt.Key.Key_PageUp)
    QTest.keyClick(x, Qt.Key.Key_PageUp)
    start = pose_of(ready)
    QTest.mouseClick(ready.align.refine, LEFT)
    assert ready.align.cancel.isVisible()
    qtbot.waitUntil(lambda: ready.flow.refinement is not None)
    refinement = ready.flow.refinement
    assert refinement.found.rmse_m < refinement.before_m
    assert f"{1e3 * refinement.before_m:.2f} mm before" in ready.align.outcome.text()
    assert "Refined" in ready.guide.text()
    QTest.keyClick(ready.views.patch, Qt.Key.Key_Z, CONTROL)
    np.testing.assert_array_equal(pose_of(ready), start)
    assert not ready.align.outcome.text()


def test_icp_can_be_given_up(qtbot, ready, monkeypatch):
    work = EndlessWork()
    click_three_pairs(ready)
    pose = pose_of(ready)
    monkeypatch.setattr(truth_flow, "refine", lambda *rest: work(rest[-1]))
    QTest.mouseClick(ready.align.refine, LEFT)
    qtbot.waitUntil(work.began.is_set)
    QTest.mouseClick(ready.align.cancel, LEFT)
    qtbot.waitUntil(lambda: not ready.flow.busy_refining)
    np.testing.assert_array_equal(pose_of(ready), pose)
    assert ready.align.refine.isEnabled() and not ready.align.cancel.isVisible()


def test_icp_out_of_reach_is_told(qtbot, ready):
    click_three_pairs(ready)
    z = ready.align.places[2]
    type_into(z, "400")
    QTest.mouseClick(ready.align.refine, LEFT)
    qtbot.waitUntil(lambda: any("nowhere within 10 mm" in sentence for sentence in ready.messages.sentences()))
    assert ready.align.refine.isEnabled()


def test_the_command_line_repeats_what_is_shown(qtbot, ready, plate):
    click_three_pairs(ready)
    qtbot.waitUntil(lambda: ready.flow.scores is not None)
    low = ready.paint.rows["hue"].widget.entries[0]
    type_into(low, "140")
    settle(qtbot, ready)
    QTest.mouseClick(ready.result.copy, LEFT)
    words = shlex.split(QApplication.clipboard().text())
    assert words[:3] == ["tactune", "evaluate", "recording"]
    options = dict(zip(words[3::2], words[4::2], strict=True))
    assert (options["--source"], options["--frame"], options["--scan"]) == ("tiny", "3", str(plate))
    assert parse_paint([options["--paint"]]) == ready.flow.state.paint
    qtbot.waitUntil(Path(options["--transform"]).exists)
    np.testing.assert_array_equal(load_transform(options["--transform"]), pose_of(ready))
    assert "preset" in ready.result.note.text(), "this preset was never saved"


def test_a_transform_is_saved_and_loaded_again(qtbot, ready, tmp_path):
    click_three_pairs(ready)
    pose = pose_of(ready)
    QTest.mouseClick(ready.result.save, LEFT)
    type_path(qtbot, tmp_path / "plate.json")
    qtbot.waitUntil((tmp_path / "plate.json").exists)
    assert set(json.loads((tmp_path / "plate.json").read_text())) == {"T_proximity_scan"}
    assert str(tmp_path / "plate.json") in ready.result.command.text()
    QTest.mouseClick(ready.align.center, LEFT)
    assert (pose_of(ready) != pose).any()
    QTest.mouseClick(ready.result.load, LEFT)
    type_path(qtbot, tmp_path / "plate.json")
    qtbot.waitUntil(lambda: ready.flow.state.origin == "file")
    np.testing.assert_array_equal(pose_of(ready), pose)
