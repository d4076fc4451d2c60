"""The guided set-up by mouse: from an empty preset to the verdict, where it stops, and what a person may do there."""

import time
from dataclasses import replace

import numpy as np
import pytest
from PyQt6.QtTest import QTest

from fakes import FakeCameras, FakeSource, tiny_frame, tiny_rig
from hands import LEFT, show_source
from rigs import rig_noise
from tactune.core.model.frames import Rig
from tactune.core.preset import Preset


@pytest.fixture
def set_up(window):
    window.document.new(Preset())
    panel = window.set_up
    panel.window_ = window
    return panel


def click(button):
    assert button.isEnabled()
    QTest.mouseClick(button, LEFT)


def marks(panel):
    return "".join(row.mark.text() for row in panel.rows)


def test_one_click_sets_up_the_simulated_rig(qtbot, make_window, tmp_path):
    window = make_window(Preset())
    set_up = window.set_up
    said = set()
    window.worker.opening.connect(lambda *_: said.add(set_up.source.state.text()))
    window.open_source("sim:cup")
    qtbot.waitUntil(lambda: window.result is not None, timeout=300_000)
    assert said == {"Opening sim:cup…"} and set_up.source.state.text() == "sim:cup, 90 frames."
    window.worker.pause()  # what plays beside the steps takes as long as these
    click(set_up.start)
    qtbot.waitUntil(lambda: not set_up.running, timeout=300_000)
    assert marks(set_up) == "✓" * len(set_up.rows), set_up.headline.text()
    preset, verdict = window.document.preset, window.document.preset.verdict
    assert preset.untouched is not None
    assert preset.alignment.calibration.quality.alignment_px < 0.6
    assert preset.noise.bias_from == "contact"
    assert preset.mask.enabled and preset.contact_test == "membrane"
    assert 0.3 < verdict.error_mm < 3 and verdict.weakest in verdict.links_mm
    assert set_up.press
    window.document.edit("name", "mine")
    assert set_up.verdict.mark.text() == "✓"
    window.document.save(tmp_path / "mine.json")
    window.document.edit("membrane.gap_m", 0.001)
    assert set_up.verdict.mark.text() == "○", "the verdict was about other values"
    assert window.document.undo_stack.text(4) == "Mask, test and limits"
    for _ in range(4):  # each step is one: the suggestions go
        window.document.undo_stack.undo()
    assert not window.document.preset.mask.enabled and window.document.preset.noise is not None
    assert marks(set_up) == "✓✓✓✓✓○○"
    window.document.open(tmp_path / "mine.json")  # as at the next start
    assert marks(set_up) == "✓" * len(set_up.rows) and verdict.sentence in set_up.headline.text()


def test_without_a_source_it_looks_for_cameras_and_says_that_there_are_none(qtbot, make_window):
    window = make_window(Preset())
    set_up = window.set_up
    click(set_up.start)
    qtbot.waitUntil(lambda: not set_up.running, timeout=60_000)
    assert window.messages.by_key.get("source") is not None
    assert set_up.source.mark.text() == "○" and set_up.headline.text() == "Next: source."


def test_a_press_that_was_captured_as_untouched_is_found_out(qtbot, set_up, monkeypatch):
    window = set_up.window_

    def pressed_at_first(index, rig):
        frame = tiny_frame(index, rig)
        return replace(frame, tactile_depth=(frame.tactile_depth - (120 if index < 8 else 0)).astype(np.uint16))

    show_source(qtbot, window, FakeSource(16, make=pressed_at_first), 0)
    monkeypatch.setattr(set_up.untouched.work, "wanted", 5)
    click(set_up.untouched.work.start)
    qtbot.waitUntil(lambda: window.document.preset.untouched is not None and not set_up.untouched.work.busy)
    window.document.edit("noise", rig_noise().model_dump())
    click(set_up.bias.work.start)
    qtbot.waitUntil(lambda: set_up.bias.mark.text() == "!", timeout=60_000)
    assert "captured during a press" in set_up.bias.work.sentence.text()


def test_only_a_press_that_is_held_still_is_worked_on(qtbot, set_up):
    show_source(qtbot, set_up.window_, FakeSource(), 0)
    step, free = set_up.bias.work, tiny_frame(0, tiny_rig())
    step.info = set_up.window_.result.source
    step.prepared(free)

    def share(moves_m):
        unit_m = tiny_rig().tactile.depth_unit_m
        depths = (free.tactile_depth - np.uint16((0.01 + number * moves_m) / unit_m) for number in range(8))
        return step.share([step.keep(replace(free, tactile_depth=depth)) for depth in depths])

    assert share(0.0) == 1.0
    assert share(0.001) < 0.5


def test_without_a_firm_press_the_deepest_dent_is_worked_on(set_up, qtbot):
    show_source(qtbot, set_up.window_, FakeSource(), 0)
    step, free = set_up.suggestions.work, tiny_frame(0, tiny_rig())
    step.info = set_up.window_.result.source
    step.prepared(free)
    for number, counts in enumerate((0, 30, 10)):
        depth = free.tactile_depth.copy()
        depth[:16, :16] -= counts
        step.keep(replace(free, sequence=number, tactile_depth=depth))
    step.work([], step.info)
    assert [frame.sequence for frame in set_up.press] == [1]
    step.ended.emit(False)
    assert not set_up.press, "the next try takes another press"


def failed(panel):
    [row] = [row for row in panel.rows if row.mark.text() == "!"]
    return row


def test_it_stops_at_a_step_that_fails_and_goes_on_without_it(qtbot, set_up):
    show_source(qtbot, set_up.window_, FakeSource(40), 0)
    click(set_up.start)
    qtbot.waitUntil(lambda: not set_up.running, timeout=60_000)
    assert set_up.window_.document.preset.untouched is not None
    first = failed(set_up)
    assert set_up.headline.text() == first.work.sentence.text() != ""
    click(set_up.skip)
    qtbot.waitUntil(lambda: not set_up.running, timeout=60_000)
    assert first.mark.text() == "–"
    assert failed(set_up) is not first
    click(first.work.start)  # a skipped step can still be done
    qtbot.waitUntil(lambda: not first.work.busy, timeout=60_000)
    assert first.mark.text() == "–"


def test_a_step_that_runs_is_skipped_and_stopped_and_the_run_goes_on(qtbot, set_up, monkeypatch):
    begun = []

    def endless(_kept, _info):
        def work(progress):
            begun.append(work)
            while True:  # until it is cancelled
                time.sleep(0.001)
                progress(0.5, "")

        return work

    for step in (set_up.untouched, set_up.noise):
        monkeypatch.setattr(step.work, "work", endless)
        monkeypatch.setattr(step.work, "wanted", 5)
    show_source(qtbot, set_up.window_, FakeSource(80), 0)
    click(set_up.start)
    qtbot.waitUntil(lambda: len(begun) == 1, timeout=60_000)
    click(set_up.skip)
    qtbot.waitUntil(lambda: len(begun) == 2, timeout=60_000)
    qtbot.waitUntil(lambda: marks(set_up)[1:3] == "–…" and not set_up.untouched.work.busy, timeout=60_000)
    assert set_up.running and set_up.noise.work.busy
    click(set_up.start)
    qtbot.waitUntil(lambda: not set_up.noise.work.busy, timeout=60_000)
    assert not set_up.running


def test_another_source_begins_again(qtbot, set_up):
    show_source(qtbot, set_up.window_, FakeSource(), 0)
    click(set_up.skip)
    set_up.press.append(tiny_frame(0, tiny_rig()))
    assert marks(set_up)[1] == "–"
    show_source(qtbot, set_up.window_, FakeSource(), 0)
    assert marks(set_up)[1] == "○" and not set_up.press, "a press into another rig tells nothing about this one"


def test_waiting_for_a_press_is_cancelled_and_changes_nothing(qtbot, set_up):
    window, cameras = set_up.window_, FakeCameras()
    cameras.release()
    show_source(qtbot, window, cameras)
    cameras.run()
    click(set_up.untouched.work.start)
    qtbot.waitUntil(lambda: window.document.preset.untouched is not None, timeout=60_000)
    qtbot.waitUntil(lambda: not set_up.untouched.work.busy)
    noise = rig_noise()
    window.document.edit("noise", noise.model_dump())
    click(set_up.bias.work.start)
    qtbot.waitUntil(lambda: set_up.bias.mark.text() == "…")
    click(set_up.bias.work.cancel)
    qtbot.waitUntil(lambda: set_up.bias.mark.text() == "!" and not set_up.bias.work.busy)
    assert window.document.preset.noise == noise


def test_a_rig_with_one_camera_leaves_steps_out(qtbot, set_up):
    show_source(qtbot, set_up.window_, FakeSource(rig=Rig.of_one_camera(tiny_rig().tactile)), 3)
    assert marks(set_up)[3:5] == "––"
    assert not set_up.bias.work.start.isEnabled()
