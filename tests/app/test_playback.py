import pytest

from tactune.app.worker.playback import Playback


def started(length: int | None = 5, rate_hz: float = 10.0) -> Playback:
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


def test_loops_or_stops_at_the_end():
    playback = started(length=2)
    playback.shown(1, now_s=0.0)
    assert playback.next_index() == 0
    playback.loop = False
    assert playback.next_index() is None
    assert not playback.playing


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


@pytest.mark.parametrize("hold", ["frozen", "held"])
def test_a_held_recording_waits(hold):
    recording = started()
    setattr(recording, hold, True)
    assert recording.wait_s(1e9) is None


def test_a_live_source_is_never_due_since_it_paces_itself():
    live = started(length=None)
    assert live.wait_s(1e9) is None
    assert live.state.running


def test_a_single_frame_stands_still():
    playback = started(length=1)
    assert playback.wait_s(1e9) is None
    playback.play()
    assert not playback.playing
