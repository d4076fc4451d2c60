"""The worker with live cameras: orders without frames, faults, and no endless waiting."""

import pytest

from fakes import FakeCameras, FakeSource
from tactune.app.worker import reading
from tactune.app.worker.worker import SourceRequest
from watched_worker import Watched


@pytest.fixture
def cameras(watched, qtbot):
    """Cameras that have given their first frame, which is shown."""
    made = FakeCameras()
    watched.open(made)
    made.release()
    qtbot.waitUntil(lambda: watched.last is not None)
    return made


def test_a_preset_is_used_at_once_while_no_frame_comes(watched, cameras, qtbot, preset):
    watched.worker.set_preset(preset.with_value("tolerance.t", 0.5))
    qtbot.waitUntil(lambda: watched.last.preset.tolerance.t == 0.5)
    assert watched.last.frame is cameras.given[0]
    assert len(cameras.given) == 1


def test_another_source_opens_while_no_frame_comes(watched, cameras, qtbot):
    watched.open(FakeSource(length=1))
    qtbot.waitUntil(lambda: watched.last.source.name == "tiny")
    assert cameras.closed


def test_shutting_down_while_no_frame_comes(qtbot, preset):
    watched = Watched(preset)
    cameras = FakeCameras()
    watched.open(cameras)
    qtbot.waitUntil(lambda: cameras.waits > 1)
    watched.worker.shut_down()
    assert watched.worker.isFinished()
    assert cameras.closed, "its thread was not abandoned"


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


def test_a_paused_live_source_is_drained_and_goes_on_with_the_newest(watched, cameras, qtbot):
    watched.worker.pause()
    qtbot.waitUntil(lambda: bool(watched.modes) and not watched.modes[-1].playing)
    cameras.give(qtbot, 5)
    assert watched.last.frame.sequence == 0
    watched.worker.play()
    qtbot.waitUntil(lambda: watched.last.frame.sequence == 5)
    shown = {result.frame.sequence for result in watched.results}
    assert shown == {0, 5}


def test_no_frame_for_a_while_is_stale_and_the_next_one_is_not(watched, cameras, qtbot, monkeypatch):
    monkeypatch.setattr(reading, "STALE_AFTER_S", 0.3)
    qtbot.waitUntil(lambda: bool(watched.states) and watched.states[-1].stale)
    cameras.release()
    qtbot.waitUntil(lambda: not watched.states[-1].stale)


def test_an_error_of_the_source_is_told_and_it_is_asked_again(watched, cameras, qtbot):
    cameras.fail("the D405 sends frames of 1280 x 720, the rig says 640 x 480: unplug it and plug it in again")
    qtbot.waitUntil(lambda: bool(watched.states) and "1280 x 720" in watched.states[-1].problem)
    assert watched.modes[-1].playing
    cameras.error = ""
    cameras.release()
    qtbot.waitUntil(lambda: watched.states[-1].problem == "")
    qtbot.waitUntil(lambda: watched.last.frame.sequence == 1)


def test_the_end_of_a_live_source_is_told(watched, cameras, qtbot):
    cameras.end()
    qtbot.waitUntil(lambda: bool(watched.states) and "has ended: open it again" in watched.states[-1].problem)
    assert watched.states[-1].stale


def test_an_option_is_set_between_frames_and_the_newest_value_counts(watched, cameras, qtbot):
    for value in (10.0, 20.0, 30.0):
        watched.worker.set_option("proximity", "laser_power", value)
    qtbot.waitUntil(lambda: bool(watched.options) and watched.options[-1][0].value == 30.0)
    assert watched.refusals == []


def test_frames_that_come_too_fast_are_dropped_and_counted(watched, cameras, qtbot):
    released = 1

    def some_were_dropped():
        nonlocal released
        cameras.release(200)
        released += 200
        return watched.last.dropped > 0

    qtbot.waitUntil(some_were_dropped)
    qtbot.waitUntil(lambda: watched.last.frame.sequence == released - 1)
    assert watched.last.processed < released <= watched.last.processed + watched.last.dropped


def test_cameras_are_closed_before_they_are_opened_again(watched, cameras, qtbot):
    order = []

    def open_again(progress):
        order.append(cameras.closed)
        return FakeCameras()

    watched.worker.open(SourceRequest("cameras", open_again, exclusive=True))
    qtbot.waitUntil(lambda: order == [True])
