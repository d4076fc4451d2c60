"""The tab Tune: a search in a process of its own, its best trials, the preview of one, and its way into the preset."""

import os

import pytest
from PyQt6 import sip
from PyQt6.QtCore import QProcess, Qt
from PyQt6.QtTest import QTest

from hands import LEFT, show_source, text_of, type_into
from small_recordings import noisy_press, small_rig
from tactune.app.analysis import tune_tab
from tactune.app.analysis.tune_tab import frames_of
from tactune.core.sources.folder import FolderSource, export_folder


@pytest.fixture
def recording(tmp_path):
    export_folder(noisy_press(0, small_rig(64), 3, with_truth=True), tmp_path / "rec")
    return FolderSource(tmp_path / "rec")


@pytest.fixture
def tab(qtbot, window, recording):
    """The tab, opened by its key on a recording with ground truth."""
    show_source(qtbot, window, recording, 1)
    QTest.keyClick(window, Qt.Key.Key_F7, Qt.KeyboardModifier.ShiftModifier)
    qtbot.waitExposed(window.analysis.window)
    made = window.analysis.window.made["tune"]
    qtbot.waitUntil(made.start.isEnabled)
    made.main = window
    return made


def search(qtbot, tab, trials):
    type_into(tab.trials.lineEdit(), str(trials))
    QTest.keyClick(tab, Qt.Key.Key_Return, Qt.KeyboardModifier.ControlModifier)
    qtbot.waitUntil(lambda: tab.run.busy)
    qtbot.waitUntil(lambda: not tab.run.busy, timeout=240_000)


def click_trial(qtbot, tab, number):
    table = tab.table
    row = [trial["number"] for trial in table.model().records].index(number)
    QTest.mouseClick(table.viewport(), LEFT, pos=table.visualRect(table.model().index(row, 0)).center())
    qtbot.waitUntil(lambda: table.selected_keys() == (number,))


def test_a_search_finds_a_better_preset_which_is_previewed_and_used_as_one_step(qtbot, tab):
    document, comparison = tab.main.document, tab.main.context.comparison
    before = document.preset
    assert "Tolerance t" in tab.fields["tolerance.t"].text()
    search(qtbot, tab, 16)
    assert len(tab.run.trials) == 16 and not tab.messages.isVisible(), text_of(tab.messages)
    assert "16 of 16 trials" in tab.status.text()
    best = min(tab.run.front, key=lambda number: tab.run.trials[number]["figures"]["rmse"])
    assert tab.run.trials[best]["figures"]["rmse"] < tab.run.trials[0]["figures"]["rmse"]
    click_trial(qtbot, tab, best)
    value = tab.run.trials[best]["values"]["tolerance.t"]
    assert set(tab.run.front) <= {trial["number"] for trial in tab.table.records()}
    assert f"trial {best}" in tab.use.text()
    assert [side.name for side in comparison.sides] == ["Present", f"Trial {best}"]
    assert comparison.sides[1].preset.tolerance.t == value
    assert document.preset == before
    QTest.mouseClick(tab.use, LEFT)
    assert document.preset.tolerance.t == value
    assert comparison.sides is None
    assert document.undo_stack.undoText() == f"Trial {best} of the search"
    document.undo_stack.undo()
    assert document.preset == before
    use_by_keys(tab)


def use_by_keys(tab):
    """The arrow keys walk along the trials, and Enter uses one."""
    tab.table.setFocus()
    QTest.keyClick(tab.table, Qt.Key.Key_Home, Qt.KeyboardModifier.ControlModifier)
    for _ in tab.table.records():
        (number,) = tab.table.selected_keys()
        if not tab.run.trials[number]["present"]:
            break
        QTest.keyClick(tab.table, Qt.Key.Key_Down)
    QTest.keyClick(tab.table, Qt.Key.Key_Return)
    assert tab.main.document.preset.tolerance.t == tab.run.trials[number]["values"]["tolerance.t"]


def test_a_search_that_was_stopped_continues_with_the_ticked_fields_only(qtbot, tab):
    for path, box in tab.fields.items():
        if path != "tolerance.t":
            QTest.keyClick(box, Qt.Key.Key_Space)
    type_into(tab.trials.lineEdit(), "200")
    QTest.mouseClick(tab.start, LEFT)
    qtbot.waitUntil(lambda: len(tab.run.trials) > 3, timeout=240_000)
    QTest.mouseClick(tab.stop, LEFT)
    qtbot.waitUntil(lambda: not tab.run.busy, timeout=60_000)
    kept = dict(tab.run.trials)
    assert len(kept) < 200 and not tab.messages.isVisible()
    assert all(set(trial["values"]) == {"tolerance.t"} for trial in kept.values())
    assert tab.fields["tolerance.t"].isChecked()
    QTest.keyClick(tab.fields["tolerance.t"], Qt.Key.Key_Space)
    assert not tab.start.isEnabled(), "no field is ticked"
    QTest.keyClick(tab.fields["tolerance.t"], Qt.Key.Key_Space)
    type_into(tab.trials.lineEdit(), "500")
    QTest.mouseClick(tab.start, LEFT)
    qtbot.waitUntil(lambda: len(tab.run.trials) > len(kept), timeout=240_000)
    assert all(tab.run.trials[number] == trial for number, trial in kept.items())
    closing_the_window_ends_the_search(tab)


def closing_the_window_ends_the_search(tab):
    [process] = tab.run.findChildren(QProcess)
    number = process.processId()
    tab.main.close_without_asking()
    with pytest.raises(ProcessLookupError):
        os.kill(number, 0)


def test_a_search_that_ends_after_its_window_is_deleted_then(qtbot, tmp_path):
    class Slow(QProcess):
        def waitForFinished(self, _):
            return False

    run = tune_tab.TuneRun(tmp_path)
    run._process = process = Slow(run)
    run.shut_down()
    assert process.parent() is None and tune_tab._ending == [process]
    process.finished.emit(9, QProcess.ExitStatus.CrashExit)
    assert tune_tab._ending == []
    qtbot.waitUntil(lambda: sip.isdeleted(process))


def test_an_error_of_the_search_is_said_in_the_tab(qtbot, tab, tmp_path):
    (tmp_path / "rec" / "000001" / "tactile_depth.png").unlink()
    type_into(tab.trials.lineEdit(), "4")
    QTest.mouseClick(tab.start, LEFT)
    qtbot.waitUntil(lambda: not tab.run.busy, timeout=240_000)
    assert "tactile_depth.png" in text_of(tab.messages)
    assert tab.start.isEnabled()


def test_frames_are_spread_with_truth_and_consecutive_without_between_the_marks():
    assert list(frames_of(None, 30, 3, 7, has_truth=True)) == [0, 10, 20]
    assert list(frames_of((10, 20), 30, 5, 0, has_truth=True)) == [10, 12, 14, 16, 18]
    assert list(frames_of(None, 30, 4, 28, has_truth=False)) == [26, 27, 28, 29]
    assert list(frames_of((10, 20), 30, 4, 3, has_truth=False)) == [10, 11, 12, 13]
    assert list(frames_of(None, 1, 8, 0, has_truth=True)) == [0]
