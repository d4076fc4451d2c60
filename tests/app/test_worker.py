"""The worker thread, its playback and its mailbox."""

import numpy as np
import pytest

from fakes import FakeSource
from tactune.app.worker import processing
from tactune.app.worker.playback import Playback
from tactune.app.worker.results import CloudName, ColorBy, Wanted
from tactune.app.worker.threads import Mailbox
from tactune.app.worker.worker import SourceRequest, Worker
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


def test_an_unexpected_error_is_a_sentence_too(watched, qtbot):
    source = FakeSource(length=1)
    source.read = lambda index: 1 / 0
    watched.open(source)
    qtbot.waitUntil(lambda: len(watched.failures) == 1)
    assert watched.failures[0] == "Frame 1 of tiny could not be read (ZeroDivisionError: division by zero)."


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
    worker.shut_down()
    assert len(taken) < taken[-1].processed
    assert taken[-1].processed - taken[-1].dropped >= len(taken) - 1


def test_the_newest_item_wins_and_older_ones_are_counted():
    box = Mailbox()
    assert box.put(1) is True
    assert box.put(2) is False
    assert box.put(3) is False
    assert box.take() == 3
    assert box.take() is None
    assert box.put(4) is True
    assert box.dropped == 2
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


def test_playing_at_the_end_starts_over():
    playback = started(length=2)
    playback.loop = False
    playback.shown(1, now_s=0.0)
    playback.pause()
    playback.play()
    assert playback.next_index() == 0


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
