"""The Compare tab: methods side by side on the frame of the main window, computed on a separate thread."""

from __future__ import annotations

import csv
from dataclasses import replace
from threading import Event

import numpy as np
import pytest
from PyQt6.QtCore import QPoint, Qt
from PyQt6.QtGui import QImage
from PyQt6.QtTest import QTest
from PyQt6.QtWidgets import QApplication, QStyle, QStyleOptionViewItem

from fakes import at_rest, tiny_frame, tiny_rig
from hands import show_source
from tactune.app.analysis import comparer
from tactune.app.analysis.compare_table import comparison_csv
from tactune.app.analysis.comparer import Scores
from tactune.app.analysis.method_looks import CONTACT_ROW, FALSE_ROW, MISSED_ROW, TRUTH
from tactune.app.document.untouched_store import UntouchedStore
from tactune.app.worker.playback import PlaybackState
from tactune.app.worker.processing import FrameProcessor
from tactune.app.worker.reading import SourceRequest
from tactune.app.worker.results import SourceInfo, Wanted, untouched_finder
from tactune.app.worker.threads import wait_for_abandoned
from tactune.core.errors import SourceError
from tactune.core.evaluation.metrics import compare_with_truth
from tactune.core.methods.registry import make_method, method_names
from tactune.core.model.frames import GroundTruth, SensorFrame
from tactune.core.preset import Preset
from tactune.core.rig.untouched import save_untouched
from tactune.core.sources.base import SeekableSource


class KnowingSource(SeekableSource):
    """A disc touches; its truth is known, two columns off, and so is the untouched membrane."""

    def __init__(self, untouched: bool = True, truth: bool = True) -> None:
        super().__init__("knowing", tiny_rig(), 8)
        self._has_untouched, self._has_truth = untouched, truth

    def read(self, index: int) -> SensorFrame:
        frame = tiny_frame(index, self.rig)
        if not self._has_truth:
            return frame
        depth_m = (frame.proximity_depth * np.float32(self.rig.proximity.depth_unit_m)).astype(np.float32)
        touching = np.roll(frame.proximity_color[..., 0] == 200, 2, axis=1)
        return replace(frame, truth=GroundTruth(touching, depth_m))

    def untouched(self) -> SensorFrame | None:
        if not self._has_untouched:
            return None
        frame = tiny_frame(0, self.rig)
        deeper = frame.tactile_depth.copy()
        deeper[10:30, 10:40] += 100  # 10 mm: there the membrane has come nearer since
        return replace(frame, tactile_depth=deeper)


@pytest.fixture(scope="module", autouse=True)
def compiled_methods(compiled) -> None:
    """Run both methods once, so that no test waits for their kernels."""
    source = KnowingSource()
    info = SourceInfo(source.name, source.rig, 8, 30.0)
    result = FrameProcessor().process(info, source.read(3), Preset(), Wanted(), PlaybackState())
    comparer.Comparer().compare(comparer.Task(result, ("fusion-rigid", "tactile-only"), source.untouched()))


def open_on(qtbot, window, source):
    """Open a source at frame 3 and the tab on it."""
    show_source(qtbot, window, source, 3)
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow)
    QTest.keyClick(window, Qt.Key.Key_F7)
    tab = window.analysis.window.made["compare"]
    settle(qtbot, window, tab)
    return tab


def settle(qtbot, window, tab) -> None:
    """Wait until what is shown is what is chosen, with the untouched frame that was found."""

    def settled() -> bool:
        if tab.comparison is None or tab.untouched.searching:
            return False
        task = tab.comparison.task
        return (
            task.result.frame is window.result.frame
            and task.methods == tab.table.chosen()
            and task.untouched is tab.untouched.frame
            and task.no_untouched == tab.untouched.sentence
            and task.by_truth == (tab.color_by.currentIndex() == 1)
        )

    qtbot.waitUntil(settled)


@pytest.fixture
def window(make_window):
    made = make_window()
    made.settings.set("compare/methods", "fusion-rigid,tactile-only")
    return made


@pytest.fixture
def tab(qtbot, window):
    return open_on(qtbot, window, KnowingSource())


def outcomes(tab) -> dict[str, comparer.Outcome]:
    return {outcome.name: outcome for outcome in tab.comparison.outcomes}


def tick(tab, name: str) -> None:
    """Click the box of a method's row."""
    table = tab.table
    item = table.item(1 + method_names().index(name), 0)
    table.scrollToItem(item)
    option = QStyleOptionViewItem()
    table.initViewItemOption(option)
    option.rect = table.visualItemRect(item)
    option.features |= QStyleOptionViewItem.ViewItemFeature.HasCheckIndicator
    box = table.style().subElementRect(QStyle.SubElement.SE_ItemViewItemCheckIndicator, option, table)
    QTest.mouseClick(table.viewport(), Qt.MouseButton.LeftButton, pos=box.center())


def test_each_method_has_a_view_and_the_numbers_that_python_gives(window, tab):
    frame, rig = window.result.frame, window.result.source.rig
    assert tab.grid.shown() == [TRUTH, "fusion-rigid", "tactile-only"]
    for name in tab.table.chosen():
        patch = make_method(name, window.document.preset, rig, KnowingSource().untouched()).find(frame)
        known = compare_with_truth(patch, frame.truth, rig)
        assert len(patch.points) > 50
        text = tab.grid.tiles[name].caption.text()
        assert f"{len(patch.points):,} points" in text and " ms · " in text
        assert f"RMSE {known['rmse_mm']:.2f} mm · IoU {known['iou']:.3f}" in text
        assert tab.grid.tiles[name].view.point_count() == len(patch.points)
    assert tab.grid.tiles[TRUTH].view.point_count() == np.count_nonzero(frame.truth.contact)


def test_a_ticked_method_gets_a_view_and_is_remembered(qtbot, window, tab):
    tick(tab, "fusion-homography")
    settle(qtbot, window, tab)
    assert tab.grid.shown() == [TRUTH, "fusion-rigid", "fusion-homography", "tactile-only"]
    assert outcomes(tab)["fusion-homography"].scores.points
    tick(tab, "fusion-rigid")
    assert window.settings.text("compare/methods") == "fusion-homography,tactile-only"
    assert not tab.grid.tiles["fusion-rigid"].isVisible()


def test_the_space_bar_ticks_the_present_row(qtbot, window, tab):
    row = 1 + method_names().index("proximity-only")
    tab.table.setCurrentCell(row, 2)
    QTest.keyClick(tab.table, Qt.Key.Key_Space)
    assert tab.table.chosen() == ("fusion-rigid", "proximity-only", "tactile-only")
    QTest.keyClick(tab.table, Qt.Key.Key_Space)
    assert tab.table.chosen() == ("fusion-rigid", "tactile-only")


def test_another_source_is_framed_and_compared_anew(qtbot, window, tab):
    assert tab.grid.tiles["fusion-rigid"].view.camera().target[2] < 0.3
    far = KnowingSource()
    far.read = lambda index: moved(KnowingSource.read(far, index + 20))
    window.open_request(SourceRequest("far", lambda progress: far))
    qtbot.waitUntil(lambda: window.result is not None and window.result.frame.proximity_depth.max() > 1200)
    settle(qtbot, window, tab)
    assert tab.grid.tiles["fusion-rigid"].view.camera().target[2] > 0.4


def moved(frame: SensorFrame) -> SensorFrame:
    """The same scene twice as far away."""
    truth = replace(frame.truth, depth_m=2 * frame.truth.depth_m)
    return replace(frame, proximity_depth=2 * frame.proximity_depth, tactile_depth=2 * frame.tactile_depth, truth=truth)


def test_all_views_share_one_camera_also_those_that_come_later(qtbot, window, tab):
    view = tab.grid.tiles["fusion-rigid"].view
    before = view.camera()
    QTest.mousePress(view, Qt.MouseButton.LeftButton, pos=QPoint(80, 80))
    QTest.mouseMove(view, QPoint(120, 100))
    QTest.mouseRelease(view, Qt.MouseButton.LeftButton, pos=QPoint(120, 100))
    assert view.camera() != before
    assert tab.grid.tiles["tactile-only"].view.camera() == view.camera()
    tick(tab, "proximity-only")
    settle(qtbot, window, tab)
    assert tab.grid.tiles["proximity-only"].view.camera() == view.camera() != before


def test_it_follows_the_main_window_and_holds_while_that_stands_still(qtbot, window, tab):
    window.worker.seek(5)
    qtbot.waitUntil(lambda: at_rest(window, 5))
    settle(qtbot, window, tab)
    assert "Frame 6 of knowing" in tab.status.text()
    assert window.transport.position.text().endswith("frame 6 of 8")
    shown = tab.comparison
    qtbot.wait(150)
    assert tab.comparison is shown


def test_the_disk_is_not_asked_for_the_untouched_frame_with_each_frame(qtbot, window, tab, monkeypatch):
    asked = []
    home = UntouchedStore.home
    monkeypatch.setattr(UntouchedStore, "home", lambda *rest: asked.append(1) or home(*rest))
    for index in (4, 5, 6):
        window.worker.seek(index)
        qtbot.waitUntil(lambda index=index: at_rest(window, index))
        settle(qtbot, window, tab)
    assert not asked


def test_another_preset_is_compared_at_once(qtbot, window, tab):
    few = outcomes(tab)["fusion-rigid"].scores.points
    window.document.edit("tolerance.t", 0.2)
    qtbot.waitUntil(lambda: outcomes(tab)["fusion-rigid"].scores.points > few)
    assert outcomes(tab)["fusion-rigid"].scores.points == 64 * 48


def test_without_an_untouched_frame_the_view_says_how_to_get_one(qtbot, window):
    tab = open_on(qtbot, window, KnowingSource(untouched=False))
    tile = tab.grid.tiles["tactile-only"]
    assert "Ctrl+Shift+R" in tile.view.message()
    assert "no patch" in tile.caption.text()
    assert outcomes(tab)["fusion-rigid"].scores.points


def test_without_truth_there_is_no_view_of_it_and_no_score(qtbot, window):
    tab = open_on(qtbot, window, KnowingSource(truth=False))
    assert tab.grid.shown() == ["fusion-rigid", "tactile-only"]
    assert "RMSE" not in tab.grid.tiles["fusion-rigid"].caption.text()
    assert "no truth known" in tab.status.text()
    assert tab.table.isRowHidden(0) and not tab.color_by.isEnabled()


def test_a_damaged_untouched_frame_is_said_and_tried_again(qtbot, window):
    class Damaged(KnowingSource):
        def untouched(self) -> SensorFrame | None:
            raise SourceError("the untouched frame is damaged; capture it again")

    tab = open_on(qtbot, window, Damaged())
    assert "the untouched frame is damaged; capture it again" in tab.grid.tiles["tactile-only"].view.message()


def test_the_untouched_frame_of_the_preset_goes_first(preset, tmp_path):
    source, home = KnowingSource(), tmp_path / "cup.json"
    find = untouched_finder(source)
    assert find(preset, home, lambda share, words: None).frame.tactile_depth[20, 20] > 2500
    own = tiny_frame(5, source.rig)
    kept = preset.model_copy(update={"untouched": save_untouched(own, 1, home)})
    found = find(kept, home, lambda share, words: None)
    assert not found.warnings
    np.testing.assert_array_equal(found.frame.tactile_depth, own.tactile_depth)


def test_preparing_the_untouched_frame_can_be_cancelled_and_begun_again(qtbot, window):
    tab = open_on(qtbot, window, KnowingSource())
    may_end = Event()

    def slow(_preset, _path, progress):
        while not may_end.wait(0.01):
            progress(0.25, "solving")
        return found(_preset, _path, progress)

    found = window.result.source.find_untouched
    slow_info = replace(window.result.source, find_untouched=slow)
    tab.show_result(replace(window.result, source=slow_info))
    qtbot.waitUntil(lambda: tab.progress.isVisible() and tab.progress.value() == 25)
    QTest.mouseClick(tab.give_up, Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: "cancelled" in tab.grid.tiles["tactile-only"].view.message())
    assert not tab.progress.isVisible() and tab.give_up.text() == "Try again"
    may_end.set()
    QTest.mouseClick(tab.give_up, Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: bool(outcomes(tab)["tactile-only"].scores.points))
    assert not tab.give_up.isVisible()


def test_a_method_that_breaks_leaves_the_others_alone(qtbot, window, monkeypatch):
    def broken(name, *rest):
        if name == "tactile-only":
            raise ZeroDivisionError("a defect")
        return make_method(name, *rest)

    monkeypatch.setattr(comparer, "make_method", broken)
    tab = open_on(qtbot, window, KnowingSource())
    assert "ZeroDivisionError: a defect" in tab.grid.tiles["tactile-only"].view.message()
    assert outcomes(tab)["fusion-rigid"].scores.points


def test_a_slow_method_holds_up_nothing_and_its_frames_are_skipped(qtbot, window, monkeypatch):
    go_on = Event()

    class Slow:
        def __init__(self, method) -> None:
            self._method = method
            self.remembers = method.remembers

        def find(self, frame):
            go_on.wait(60)
            return self._method.find(frame)

    monkeypatch.setattr(comparer, "make_method", lambda *args: Slow(make_method(*args)))
    show_source(qtbot, window, KnowingSource())
    window.analysis.actions["compare"].trigger()
    tab = window.analysis.window.made["compare"]
    started = window.result.processed
    qtbot.waitUntil(lambda: window.result.processed > started + 10)
    assert tab.comparison is None
    qtbot.waitUntil(lambda: "Setting up" in tab.grid.tiles["fusion-rigid"].caption.text())
    assert tab.thread_.skipped > 0
    go_on.set()
    qtbot.waitUntil(lambda: tab.comparison is not None)


def test_the_table_says_over_how_many_frames_a_method_has_averaged_and_does_not_jump(qtbot, window, tab):
    tick(tab, "fusion-averaged")
    settle(qtbot, window, tab)
    table, first = tab.table, tab.table.item(1 + method_names().index("fusion-averaged"), 0)
    outcome, width = outcomes(tab)["fusion-averaged"], table.columnWidth(0)
    assert first.text() == "fusion-averaged" and "Currently" not in first.toolTip()
    changes = []
    table.chosenChanged.connect(lambda: changes.append(1))
    for averaged in (7, 15):
        table.show_outcomes({outcome.name: replace(outcome, averaged_frames=averaged)})
        assert first.text() == f"fusion-averaged ({averaged} frames)"
        assert f"mean of {averaged} frames" in first.toolTip()
    assert table.columnWidth(0) == width >= table.sizeHintForColumn(0), "the longest name is seen in full"
    assert not changes
    table.show_outcomes({outcome.name: outcome})
    assert first.text() == "fusion-averaged" and "Currently" not in first.toolTip()


def test_rows_are_copied_as_text(window, tab):
    table = tab.table
    row = 1 + method_names().index("fusion-rigid")
    QTest.mouseClick(table.viewport(), Qt.MouseButton.LeftButton, pos=table.visualItemRect(table.item(row, 3)).center())
    QTest.keyClick(table, Qt.Key.Key_C, Qt.KeyboardModifier.ControlModifier)
    head, values = (line.split("\t") for line in QApplication.clipboard().text().splitlines())
    assert head[:3] == ["Method", "Time (ms)", "Points"]
    assert values[0] == "fusion-rigid"
    assert values[2] == f"{outcomes(tab)['fusion-rigid'].scores.points:,}"


def test_a_comparison_is_saved_as_a_picture_and_as_numbers(qtbot, window, tab, tmp_path):
    path = tmp_path / "compared.png"
    tab.save_to(path)
    qtbot.waitUntil(path.exists)
    assert QImage(str(path)).width() > 400
    rows = list(csv.DictReader((tmp_path / "compared.csv").read_text().splitlines()))
    assert [row["method"] for row in rows] == [TRUTH, "fusion-rigid", "tactile-only"]
    assert [row["averaged_frames"] for row in rows] == ["", "1", "1"]
    assert float(rows[1]["symmetric_rmse_mm"]) == pytest.approx(outcomes(tab)["fusion-rigid"].scores.rmse_mm, rel=1e-4)
    assert rows[0]["median_ms"] == "" and rows[0]["frame"] == "3"


def test_numbers_say_over_how_many_frames_a_patch_was_averaged(tab):
    averaged = [replace(outcome, averaged_frames=7) for outcome in tab.comparison.outcomes]
    failed = replace(averaged[1], scores=Scores(), note="failed", averaged_frames=1)
    text = comparison_csv(replace(tab.comparison, outcomes=(*averaged, failed)))
    assert [row["averaged_frames"] for row in csv.DictReader(text.splitlines())] == ["", "7", "7", ""]


def test_a_csv_of_somebody_else_is_not_replaced(qtbot, window, tab, tmp_path):
    (tmp_path / "mine.csv").write_text("mine")
    tab.save_to(tmp_path / "mine.png")
    qtbot.waitUntil(lambda: "choose another name" in "".join(tab.messages.sentences()))
    assert (tmp_path / "mine.csv").read_text() == "mine"
    assert not (tmp_path / "mine.png").exists()


def test_the_agreement_with_the_truth_is_coloured_pixel_by_pixel(qtbot, window, tab):
    tab.color_by.setFocus()
    QTest.keyClick(tab.color_by, Qt.Key.Key_Down)
    settle(qtbot, window, tab)
    cloud = tab.grid.tiles["fusion-rigid"].view.cloud()
    step = tab.comparison.task.step
    patch = make_method("fusion-rigid", window.document.preset, window.result.source.rig).find(window.result.frame)
    mine, true = patch.mask[::step, ::step], window.result.frame.truth.contact[::step, ::step]
    assert (mine & ~true).any() and (true & ~mine).any()
    for row, pixels in ((CONTACT_ROW, mine & true), (FALSE_ROW, mine & ~true), (MISSED_ROW, true & ~mine)):
        np.testing.assert_array_equal(cloud.index == row, pixels)
    assert [text for text, _ in tab.grid.tiles["fusion-rigid"].view.legend()] == ["right", "false", "missed"]


def test_closing_the_main_window_ends_the_thread(qtbot, window, tab):
    assert tab.thread_.isRunning()
    window.close_without_asking()
    qtbot.waitUntil(tab.thread_.isFinished)


def test_closing_does_not_wait_for_a_method_that_takes_long(qtbot, window, monkeypatch):
    begun, go_on = Event(), Event()

    def stuck(*_args):
        begun.set()
        go_on.wait(60)
        raise ZeroDivisionError

    monkeypatch.setattr(comparer, "make_method", stuck)
    window.open_request(SourceRequest("knowing", lambda progress: KnowingSource()))
    window.analysis.actions["compare"].trigger()
    thread = window.analysis.window.made["compare"].thread_
    qtbot.waitUntil(begun.is_set)
    window.close_without_asking()
    assert not window.isVisible() and thread.isRunning()
    assert not wait_for_abandoned(0.0)
    go_on.set()
    assert wait_for_abandoned(60.0)
