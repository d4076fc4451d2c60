"""A recording played live: in a loop, at its frame rate, with increasing time stamps."""

import numpy as np
import pytest

from capture_sources import Troubled, make_frame, make_rig, recorded
from tactune.core.errors import SourceError
from tactune.core.sources import play_as_live
from tactune.core.sources.capture.child import create_memory, read_frame, write_frame
from tactune.core.sources.play_as_live import PlayAsLive
from tactune.core.sources.registry import open_source

RIG = make_rig()


class Clock:
    """Time that passes only where somebody sleeps or reads."""

    def __init__(self):
        self.now_s = 1000.0

    def monotonic(self):
        return self.now_s

    def time(self):
        return self.now_s + 1.7e9

    def sleep(self, seconds):
        assert seconds >= 0
        self.now_s += seconds


@pytest.fixture
def clock(monkeypatch):
    made = Clock()
    monkeypatch.setattr(play_as_live, "time", made)
    return made


def recording(count, rate_hz=30.0):
    return recorded(RIG, [make_frame(RIG, number) for number in range(count)], rate_hz)


def test_it_loops_in_time_and_without_drift(clock):
    source = PlayAsLive(recording(7, 50.0))
    shown = []
    for _ in range(100):
        assert source.wait(1.0)
        frame = source.next_frame()
        shown.append((clock.now_s, frame))
        clock.sleep(0.0007)  # whatever the caller does
    times_s = np.array([moment for moment, _ in shown])
    np.testing.assert_allclose(times_s - times_s[0], np.arange(100) / 50.0, atol=1e-6)
    assert [frame.sequence for _, frame in shown] == list(range(100))
    stamps_s = np.array([frame.proximity_time_s for _, frame in shown])
    np.testing.assert_allclose(stamps_s, 1.7e9 + times_s, atol=1e-5)
    assert all(frame.skew_s == pytest.approx(0.0021, abs=1e-5) for _, frame in shown)
    assert all(
        np.array_equal(frame.tactile_depth, make_frame(RIG, n % 7).tactile_depth) for n, (_, frame) in enumerate(shown)
    )
    assert source.health().dropped == 0
    assert source.length is None


def test_frames_whose_time_has_passed_are_left_out(clock):
    source = PlayAsLive(recording(5, 10.0))
    assert source.next_frame().sequence == 0
    clock.sleep(0.75)
    assert source.next_frame().sequence == 7
    assert source.health().dropped == 6
    assert source.next_frame().sequence == 8
    assert source.health().dropped == 6


def test_what_is_live_already_or_empty_is_refused(tmp_path):
    with pytest.raises(SourceError, match="live:troubled: troubled is live already; leave out live:"):
        PlayAsLive(Troubled(tmp_path, RIG))
    with pytest.raises(SourceError, match="there are no frames to play"):
        PlayAsLive(recording(0))


def test_a_folder_plays_live_by_name(nothing_left, tmp_path):
    from tactune.core.sources.folder import export_folder

    export_folder(recording(3), tmp_path / "scene")
    with open_source(f"live:{tmp_path / 'scene'}") as source:
        assert source.name == f"live:folder:{tmp_path / 'scene'}"
        frames = [source.next_frame() for _ in range(8)]
    for frame in frames:
        assert np.array_equal(frame.tactile_depth, make_frame(RIG, frame.sequence % 3).tactile_depth)


def test_a_frame_of_the_simulator_fits_its_slot_with_all_of_its_truth():
    with open_source("sim:cup?press=medium") as source:
        frame, memory = source.next_frame(), create_memory(source.rig)
    try:
        copied = read_frame(memory, write_frame(memory, 0, frame))
    finally:
        memory.close()
        memory.unlink()
    np.testing.assert_array_equal(copied.truth.pressure_pa, frame.truth.pressure_pa)
    np.testing.assert_array_equal(copied.tactile_depth, frame.tactile_depth)
