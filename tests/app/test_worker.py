"""The worker thread, its playback and its mailbox; live cameras in the worker and in the window."""

import time
from dataclasses import replace

import numpy as np
import pytest
from PyQt6.QtCore import Qt
from PyQt6.QtTest import QTest

from fakes import FakeCameras, FakeSource, tiny_frame, tiny_rig
from tactune.app.worker import processing, reading
from tactune.app.worker.playback import Playback, PlaybackState
from tactune.app.worker.processing import FrameProcessor
from tactune.app.worker.results import CloudName, ColorBy, SourceInfo, Wanted
from tactune.app.worker.threads import Mailbox
from tactune.app.worker.worker import SourceRequest, Worker
from tactune.core.preset import Preset
from watched_worker import Watched


class OddSource(FakeSource):
    """Opens, and then fails in a way that nobody foresaw."""

    def preset(self):
        raise ZeroDivisionError("odd")


def test_an_order_that_fails_is_reported_and_the_worker_goes_on(watched, qtbot, monkeypatch):
    told = []
    monkeypatch.setattr("sys.excepthook", lambda kind, error, trace: told.append(error))
    watched.open(OddSource(length=3))
    qtbot.waitUntil(lambda: [str(error) for error in told] == ["odd"])
    watched.open(FakeSource(length=3))
    qtbot.waitUntil(lambda: watched.last is not None)


def test_plays_loops_and_pauses(watched, qtbot):
    watched.open(FakeSource(length=3))
    qtbot.waitUntil(lambda: {result.playback.index for result in watched.results} == {0, 1, 2})
    qtbot.waitUntil(lambda: watched.results[-1].processed > 4)
    watched.worker.pause()
    qtbot.waitUntil(lambda: bool(watched.modes) and not watched.modes[-1].playing)
    assert watched.opened[0].length == 3


def test_stops_at_the_end_without_a_loop(watched, qtbot, monkeypatch):
    monkeypatch.setattr(processing, "STRIP_INTERVAL_S", 3600.0)
    watched.worker.set_loop(False)
    watched.open(FakeSource(length=3))
    qtbot.waitUntil(lambda: watched.shows(2))
    qtbot.waitUntil(lambda: bool(watched.modes) and not watched.modes[-1].playing)
    qtbot.waitUntil(lambda: watched.last.rendered.strip is not None)  # the frame that stays is drawn in full
    before = watched.last.processed
    watched.worker.play()  # from the beginning; on a busy machine its first frames may be dropped
    qtbot.waitUntil(lambda: [mode.playing for mode in watched.modes][-2:] == [True, False])
    qtbot.waitUntil(lambda: watched.last.processed > before and watched.last.playback.index == 2)


def test_only_what_is_looked_at_is_drawn(watched, qtbot):
    watched.worker.set_wanted(Wanted(clouds=frozenset({CloudName.PATCH}), images=frozenset(), histograms=frozenset()))
    watched.open(FakeSource(length=1))
    qtbot.waitUntil(lambda: watched.last is not None)
    rendered = watched.last.rendered
    assert set(rendered.clouds) == {CloudName.PATCH}
    assert rendered.strip is None
    assert rendered.histogram is None
    watched.worker.set_wanted(Wanted(color_by=ColorBy.PROVENANCE))
    qtbot.waitUntil(lambda: set(watched.last.rendered.clouds) == set(CloudName))
    assert watched.last.rendered.strip is not None
    histogram = watched.last.rendered.histogram
    counted = watched.last.patch.relative_difference[::2, ::2]
    assert histogram.counts.sum() == np.isfinite(counted).sum() > 0


def test_while_frames_play_numbers_and_images_are_drawn_at_their_intervals_and_colours_keep_their_range(monkeypatch):
    now_s, rig = [0.0], tiny_rig()
    monkeypatch.setattr(processing.time, "perf_counter", lambda: now_s[0])
    processor, frame = FrameProcessor(), tiny_frame(3, rig)
    nearer = replace(frame, tactile_depth=frame.tactile_depth // 2)
    drawn, ranges = [], []
    for now_s[0], shown, playing in ((0, frame, True), (0.1, frame, True), (0.15, frame, True), (0.25, nearer, True),
                                     (0.26, frame, False)):  # fmt: skip
        playback = PlaybackState(length=5, playing=playing)
        made = processor.process(SourceInfo("tiny", rig, 5, 30.0), shown, Preset(), Wanted(), playback).rendered
        drawn.append((made.histogram is not None, made.strip is not None))
        ranges.append(made.tactile_range_m)
    assert drawn == [(True, True), (False, True), (False, False), (True, True), (True, True)]
    assert ranges[0] == ranges[2] and ranges[3] == ranges[4]
    assert ranges[3][0] < ranges[0][0] and ranges[3][1] == ranges[0][1]


def test_shutting_down_while_a_source_opens(qtbot, preset):
    watched = Watched(preset)

    def slow(progress):
        while True:
            progress(0.5, "solving")

    watched.worker.open(SourceRequest("slow", slow))
    qtbot.waitUntil(lambda: bool(watched.progress))
    watched.worker.shut_down()
    assert watched.worker.isFinished()


def test_slow_consumers_see_the_newest_frame_and_the_drops_are_counted(qtbot, preset):
    worker = Worker(preset)
    worker.start()
    worker.open(SourceRequest("tiny", lambda progress: FakeSource(length=30)))
    worker.set_speed(1000.0)
    taken = []

    def enough():
        result = worker.take()
        if result is not None:
            taken.append(result)
        return bool(taken) and taken[-1].dropped > 20

    qtbot.waitUntil(enough)
    assert len(taken) < taken[-1].processed
    assert taken[-1].processed - taken[-1].dropped >= len(taken) - 1
    replaced = worker._mailbox.dropped
    qtbot.waitUntil(lambda: worker._mailbox.dropped > replaced)  # so a result waits when the next source opens
    worker.open(SourceRequest("still", lambda progress: FakeSource(length=2)))
    worker.pause()
    for index in range(2):
        worker.seek(index)
        qtbot.waitUntil(
            lambda index=index: (
                (newest := worker.take()) is not None
                and (newest.source.length, newest.playback.index, newest.dropped) == (2, index, 0)
            )
        )
    worker.shut_down()


def test_an_item_that_improves_the_one_before_counts_none_as_dropped():
    better = Mailbox(lambda old, new: int(old) == int(new))
    better.put(1.0)
    better.put(1.5)
    assert (better.dropped, better.take()) == (0, 1.5)


def started(length=5, rate_hz=10.0):
    playback = Playback()
    playback.start_source(length, rate_hz)
    return playback


def test_plays_at_the_rate_of_the_source_times_the_speed():
    playback = started()
    playback.shown(0, now_s=100.0)
    assert playback.wait_s(100.0) == pytest.approx(0.1)
    assert playback.wait_s(100.04) == pytest.approx(0.06)
    assert playback.wait_s(100.2) == 0.0
    playback.speed = 2.0
    playback.shown(1, now_s=100.1)
    assert playback.wait_s(100.1) == pytest.approx(0.05)


def test_a_small_delay_is_made_up_and_a_long_one_is_not_chased():
    playback = started()
    playback.shown(0, now_s=100.0)
    playback.shown(1, now_s=100.13)
    assert playback.wait_s(100.13) == pytest.approx(0.07)
    playback.shown(2, now_s=105.0)
    assert playback.wait_s(105.0) == pytest.approx(0.1)


def test_steps_wrap_only_when_looping():
    playback = started(length=3)
    playback.shown(0, now_s=0.0)
    assert playback.step_index(-1) == 2
    playback.loop = False
    assert playback.step_index(-1) is None
    assert playback.step_index(1) == 1


def test_a_held_recording_waits_and_a_live_source_is_never_due_since_it_paces_itself():
    recording, live = started(), started(length=None)
    recording.held = True
    assert recording.wait_s(1e9) is live.wait_s(1e9) is None
    assert live.state.playing


@pytest.fixture
def fed(watched, qtbot):
    """Cameras that have given their first frame, which is shown."""
    made = FakeCameras()
    watched.open(made)
    made.release()
    qtbot.waitUntil(lambda: watched.last is not None)
    return made


def test_a_preset_is_used_at_once_while_no_frame_comes(watched, fed, qtbot, preset):
    watched.worker.set_preset(preset.with_value("tolerance.t", 0.5))
    qtbot.waitUntil(lambda: watched.last.preset.tolerance.t == 0.5)
    assert watched.last.frame is fed.given[0]
    assert len(fed.given) == 1


def test_shutting_down_while_no_frame_comes(qtbot, preset):
    watched = Watched(preset)
    fed = FakeCameras()
    watched.open(fed)
    qtbot.waitUntil(lambda: fed.waits > 1)
    watched.worker.shut_down()
    assert watched.worker.isFinished()
    assert fed.closed, "its thread was not abandoned"


def test_a_driver_that_hangs_does_not_keep_the_window_open(qtbot, preset, monkeypatch):
    monkeypatch.setattr(reading, "PATIENCE_S", 0.1)
    watched = Watched(preset)
    source = FakeSource(live=True, hold=0, hangs=True)
    with qtbot.waitSignal(watched.worker.opened):
        watched.open(source)
    assert source.waiting.wait(60)
    watched.worker.shut_down()
    assert watched.worker.isFinished()
    source.release()


def test_no_frame_for_a_while_is_stale_and_the_next_one_is_not(watched, fed, qtbot, monkeypatch):
    monkeypatch.setattr(reading, "STALE_AFTER_S", 0.3)
    qtbot.waitUntil(lambda: bool(watched.states) and watched.states[-1].stale)
    fed.release()
    qtbot.waitUntil(lambda: not watched.states[-1].stale)


def test_an_error_of_the_source_is_told_and_it_is_asked_again(watched, fed, qtbot):
    fed.fail("the D405 sends frames of 1280 x 720, the rig says 640 x 480: unplug it and plug it in again")
    qtbot.waitUntil(lambda: bool(watched.states) and "1280 x 720" in watched.states[-1].problem)
    assert watched.modes[-1].playing
    fed.error = ""
    fed.release()
    qtbot.waitUntil(lambda: watched.states[-1].problem == "")
    qtbot.waitUntil(lambda: watched.last.frame.sequence == 1)


def test_the_end_of_a_live_source_is_told(watched, fed, qtbot):
    fed.end()
    qtbot.waitUntil(lambda: bool(watched.states) and "has ended: open it again" in watched.states[-1].problem)
    assert watched.states[-1].stale


def test_an_option_is_set_between_frames_and_the_newest_value_counts(watched, fed, qtbot):
    for value in (10.0, 20.0, 30.0):
        watched.worker.set_option("proximity", "laser_power", value)
    qtbot.waitUntil(lambda: bool(watched.options) and watched.options[-1][0].value == 30.0)
    assert watched.refusals == []


def test_frames_that_come_too_fast_are_dropped_and_counted(watched, fed, qtbot):
    released = 1

    def some_were_dropped():
        nonlocal released
        fed.release(200)
        released += 200
        return watched.last.dropped > 0

    qtbot.waitUntil(some_were_dropped)
    qtbot.waitUntil(lambda: watched.last.frame.sequence == released - 1)
    assert watched.last.processed < released <= watched.last.processed + watched.last.dropped


def test_cameras_are_closed_before_they_are_opened_again(watched, fed, qtbot):
    order = []

    def open_again(progress):
        order.append(fed.closed)
        return FakeCameras()

    watched.worker.open(SourceRequest("cameras", open_again, exclusive=True))
    qtbot.waitUntil(lambda: order == [True])


def badges(window):
    return {str(name): view.badge.text() for name, view in window.views.views.items()}


def test_the_view_of_a_missing_camera_says_what_to_do_the_others_wait_and_all_marks_go(window, cameras, qtbot):
    cameras.faults["tactile"] = "missing"
    qtbot.waitUntil(lambda: badges(window)["tactile"] != "")
    said = badges(window)
    assert said["tactile"].startswith("Tactile camera D405 (serial d002) is not connected: plug it in.")
    assert "The last frame is shown." in said["tactile"]
    assert said["proximity"].startswith("Waiting for the tactile camera. The last frame is shown.")
    assert "plug it in" in said["patch"]
    assert all(pane.badge.text() == "old" for pane in window.strip.panes.values())
    assert window.views.views[CloudName.TACTILE].point_count() > 0
    assert window.views.views[CloudName.TACTILE].badge.accessibleName() == said["tactile"]
    assert window.status.state.text() == "No frames"
    cameras.faults.clear()
    cameras.release()
    qtbot.waitUntil(lambda: set(badges(window).values()) == {""})
    assert {pane.badge.text() for pane in window.strip.panes.values()} == {""}
    qtbot.waitUntil(lambda: window.result.frame.sequence == 1)


def test_a_frame_that_cannot_be_processed_is_said_once_and_the_next_ones_are_shown(window, cameras, qtbot, monkeypatch):
    tried, said = [], []
    window.worker.failed.connect(said.append)
    with monkeypatch.context() as broken:
        broken.setattr(FrameProcessor, "process", lambda *_, **__: tried.append(1) or 1 / 0)
        cameras.release()
        qtbot.waitUntil(lambda: window.messages.by_key.get("worker") is not None)
        for count in (2, 3, 4):
            cameras.release()
            qtbot.waitUntil(lambda count=count: len(tried) >= count)
        assert len(said) == 1
    cameras.release()
    qtbot.waitUntil(lambda: window.result.frame.sequence == len(cameras.given) - 1)
    qtbot.waitUntil(lambda: window.messages.by_key.get("worker") is None)


def test_pausing_by_key_holds_the_frame_and_says_nothing_of_old(window, cameras, qtbot):
    QTest.keyClick(window, Qt.Key.Key_Space)
    qtbot.waitUntil(lambda: not window.transport.state.playing)
    too_old_s = time.monotonic() + 1.2 * reading.STALE_AFTER_S
    qtbot.waitUntil(lambda: cameras.release() or time.monotonic() > too_old_s)
    assert window.result.frame.sequence == 0
    assert set(badges(window).values()) == {""}
    assert not window.transport.position.isEnabled() and not window.actions_.next.isEnabled()
    QTest.keyClick(window, Qt.Key.Key_Space)
    qtbot.waitUntil(lambda: window.result.frame.sequence == len(cameras.given) - 1 > 0)
