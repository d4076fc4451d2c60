"""The Compare tab: methods side by side on the frame that the main window shows."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication

from fakes import FakeSource, tiny_frame
from hands import show_source
from tactune.app.analysis import compare_work
from tactune.app.analysis.compare_work import TRUTH
from tactune.core.lab.methods import make_method
from tactune.core.model.frames import GroundTruth
from tactune.core.model.metrics import compare_with_truth


def known_frame(index, rig, truth=True):
    """A disc touches; its truth is known, two columns off."""
    frame = tiny_frame(index, rig)
    if not truth:
        return frame
    depth_m = (frame.proximity_depth * np.float32(rig.proximity.depth_unit_m)).astype(np.float32)
    return replace(frame, truth=GroundTruth(np.roll(frame.proximity_color[..., 0] == 200, 2, axis=1), depth_m))


def source(untouched=True, truth=True):
    made = FakeSource(make=lambda index, rig: known_frame(index, rig, truth))
    frame = tiny_frame(0, made.rig)
    deeper = frame.tactile_depth.copy()
    deeper[10:30, 10:40] += 100  # 10 mm: there the membrane has come nearer since
    kept = replace(frame, tactile_depth=deeper) if untouched else None
    return FakeSource(make=lambda index, rig: known_frame(index, rig, truth), untouched=kept)


def open_on(qtbot, window, shown):
    show_source(qtbot, window, shown, 3)
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow)
    QTest.keyClick(window, Qt.Key.Key_F7)
    tab = window.analysis.window.made["compare"]
    settle(qtbot, window, tab)
    return tab


def settle(qtbot, window, tab):
    """Wait until what is shown is what is chosen."""
    qtbot.waitUntil(
        lambda: (
            tab.found is not None
            and tab.found.result.frame is window.result.frame
            and tab.found.result.preset is window.document.preset
            and tab.found.methods == tab.chosen
            and not tab.job.busy
        )
    )


@pytest.fixture
def window(window):
    window.settings.set("compare/methods", "fusion-rigid,tactile-only")
    return window


def outcomes(tab):
    return {outcome.name: outcome for outcome in tab.found.outcomes}


def tick(qtbot, window, tab, name):
    """Select a method's row and tick it by the space bar."""
    tab.table.select([name])
    QTest.keyClick(tab.table, Qt.Key.Key_Space)
    settle(qtbot, window, tab)


def test_each_method_has_a_view_and_the_numbers_that_python_gives(qtbot, window):
    tab = open_on(qtbot, window, source())
    frame, rig = window.result.frame, window.result.source.rig
    assert tab.grid.shown() == [TRUTH, "fusion-rigid", "tactile-only"]
    for name in tab.chosen:
        patch = make_method(name, window.document.preset, rig, source().untouched())(frame)
        known = compare_with_truth(patch, frame.truth, rig)
        assert len(patch.points) > 50
        outcome = outcomes(tab)[name]
        assert (outcome.points, outcome.rmse_mm, outcome.iou) == (len(patch.points), known["rmse_mm"], known["iou"])
        assert outcome.ms > 0
        assert tab.grid.views[name].point_count() == np.count_nonzero(patch.mask)
    assert outcomes(tab)[TRUTH].points == np.count_nonzero(frame.truth.contact)


def test_methods_are_ticked_by_keys_remembered_and_share_one_camera(qtbot, window):
    tab = open_on(qtbot, window, source())
    view = tab.grid.views["fusion-rigid"]
    before = view.camera()
    QTest.mousePress(view, Qt.MouseButton.LeftButton, pos=QPoint(80, 80))
    QTest.mouseMove(view, QPoint(120, 100))
    QTest.mouseRelease(view, Qt.MouseButton.LeftButton, pos=QPoint(120, 100))
    assert view.camera() != before
    tick(qtbot, window, tab, "fusion-homography")
    assert tab.grid.shown() == [TRUTH, "fusion-rigid", "fusion-homography", "tactile-only"]
    assert tab.grid.views["fusion-homography"].camera() == view.camera()
    tick(qtbot, window, tab, "fusion-rigid")
    assert window.settings.text("compare/methods") == "fusion-homography,tactile-only"
    assert not tab.grid.views["fusion-rigid"].isVisible()
    QTest.keyClick(tab.table, Qt.Key.Key_C, Qt.KeyboardModifier.ControlModifier)
    assert "fusion-rigid" in QApplication.clipboard().text()


def test_without_untouched_frame_or_truth_the_rest_is_compared(qtbot, window):
    tab = open_on(qtbot, window, source(untouched=False, truth=False))
    assert tab.grid.shown() == ["fusion-rigid", "tactile-only"]
    assert "untouched" in tab.grid.views["tactile-only"].message()
    assert outcomes(tab)["fusion-rigid"].points > 0


def test_a_method_that_breaks_leaves_the_others_alone(qtbot, window, monkeypatch):
    def broken(name, *rest):
        raise ZeroDivisionError("a defect")

    monkeypatch.setattr(compare_work, "make_method", broken)
    tab = open_on(qtbot, window, source())
    assert "a defect" in tab.grid.views["tactile-only"].message()
    assert outcomes(tab)["fusion-rigid"].points > 0


def test_the_comparison_is_exported_with_a_picture(qtbot, window, tmp_path):
    tab = open_on(qtbot, window, source())
    tab.save_to(tmp_path / "a.png")
    qtbot.waitUntil(lambda: (tmp_path / "a.csv").exists() and (tmp_path / "a.png").exists())
    rows = list(csv.DictReader((tmp_path / "a.csv").read_text().splitlines()))
    assert [row["method"] for row in rows] == [TRUTH, "fusion-rigid", "tactile-only"]
    assert float(rows[1]["rmse_mm"]) == pytest.approx(outcomes(tab)["fusion-rigid"].rmse_mm, rel=1e-4)
