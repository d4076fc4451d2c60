"""Recordings are bit-identical; of a cut, damaged or slow one the written part stays playable."""

import random
import tempfile
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture_sources import same_frame
from folder_scenes import RIG, make_frame, make_frames, make_rig, record
from tactune.core import load_preset
from tactune.core.errors import AdviceError, ExportError, FrameError, PresetError, SourceError
from tactune.core.model.frames import GroundTruth
from tactune.core.output.messages import LogClock
from tactune.core.output.writer import BagWriter, SessionWriter
from tactune.core.sources.tactune_files import McapSource

SIZES = st.tuples(st.integers(1, 40), st.integers(1, 24))
#: Seconds of clocks that jump by decades; log times that follow four such jumps still fit into 63 bits.
TIMES = st.floats(-1e9, 2e9)


@settings(max_examples=40)
@given(data=st.data(), proximity=SIZES, tactile=SIZES, color=st.none() | SIZES)
def test_every_bit_of_random_frames_comes_back(data, proximity, tactile, color):
    rig = make_rig(proximity, tactile, color)
    frames = []
    for seed in range(data.draw(st.integers(1, 5))):
        frame = make_frame(seed, rig)
        changes = {
            "sequence": data.draw(st.integers(0, 2**40)),
            "proximity_time_s": data.draw(TIMES),
            "tactile_time_s": data.draw(TIMES),
        }
        if data.draw(st.booleans()):
            changes["tactile_color"] = None
        if data.draw(st.booleans()):
            changes["truth"] = None
        elif data.draw(st.booleans()):
            changes["truth"] = GroundTruth(frame.truth.contact)
        frames.append(replace(frame, **changes))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "session.mcap"
        status = record(path, rig, frames, frame_rate_hz=29.97)
        with McapSource(path) as source:
            assert source.rig == rig
            assert source.length == status.frames == len(frames)
            assert source.frame_rate_hz == 29.97
            assert all(map(same_frame, source, frames))
            for index in reversed(range(len(frames))):
                source.seek(index)
                assert same_frame(source.next_frame(), frames[index])


def test_frames_of_nearly_one_moment_stay_apart_in_seconds_after_a_clock_jumped_by_years():
    clock = LogClock(1 / 30)
    log_s = 1e-9 * np.array([clock.tick(stamp_ns) for stamp_ns in (0, 2**29 * 10**9, -20, -10, 0)])
    assert (np.diff(log_s) > 0).all()


def test_a_frame_that_does_not_fit_is_refused_and_the_recording_goes_on(tmp_path):
    good = make_frame(0)
    with SessionWriter(tmp_path / "a.mcap", RIG) as writer:
        for bad, reason in (
            (replace(good, proximity_depth=np.zeros((5, 8), np.uint16)), r"/proximity/depth/image is uint16, \(5, 8\)"),
            (replace(good, tactile_color=np.zeros((9, 9, 3), np.uint8)), r"/tactile/color/image is uint8, \(9, 9, 3\)"),
            (replace(good, truth=GroundTruth(np.zeros((1, 1), bool))), r"/truth/contact/image is uint8, \(1, 1\)"),
        ):
            with pytest.raises(FrameError, match=reason):
                writer.put(bad, wait=True)
        assert writer.put(good, wait=True)
    assert writer.status().frames == 1
    with McapSource(tmp_path / "a.mcap") as source:
        assert same_frame(source.next_frame(), good)


def test_a_name_in_work_is_refused_and_no_file_is_left_empty(tmp_path):
    path = tmp_path / "a.mcap"
    writer = SessionWriter(path, RIG)
    with pytest.raises(ExportError, match="already there"):
        SessionWriter(path, RIG)
    assert path.exists()
    status = writer.close()
    assert status.error == f"no frame arrived for {path}, so there is no file; check the source"
    assert not path.exists()


def test_a_damaged_preset_says_so_and_the_frames_still_play(tmp_path):
    record(tmp_path / "a.mcap", RIG, make_frames(1), preset=load_preset("default"))
    data = (tmp_path / "a.mcap").read_bytes()
    (tmp_path / "b.mcap").write_bytes(data.replace(b'"tactune.preset"', b'"tactune.nonsens'))
    with McapSource(tmp_path / "b.mcap") as source:
        assert source.next_frame() is not None
        with pytest.raises(PresetError, match=r"b\.mcap: it is damaged \(the checksum of preset\.json is wrong\)"):
            source.preset()


LZ4_MAGIC = b"\x04\x22\x4d\x18"


def plays(path, frames, same):
    """Check that a file is a prefix of the frames, and return how long it is."""
    with McapSource(path) as source:
        assert all(same(played, frame) for played, frame in zip(source, frames, strict=False))
        assert source.position == source.length
        return source.length


def test_a_file_cut_anywhere_plays_a_prefix_or_is_refused(tmp_path):
    frames = make_frames(4)
    record(tmp_path / "whole.mcap", RIG, frames)
    data = (tmp_path / "whole.mcap").read_bytes()
    cut = tmp_path / "cut.mcap"
    lengths = []
    for size in [0, 7, *random.Random(0).sample(range(len(data)), 60), len(data) - 1]:
        cut.write_bytes(data[:size])
        try:
            lengths.append((size, plays(cut, frames, same_frame)))
        except SourceError as error:
            assert "holds no frame: it was cut off before its first frame" in str(error)
            lengths.append((size, 0))
    lengths.sort()
    assert [count for _, count in lengths] == sorted(count for _, count in lengths)
    assert {count for _, count in lengths} == {0, 1, 2, 3, 4}


def test_opening_a_long_recording_can_be_cancelled(tmp_path):
    path = tmp_path / "long.mcap"
    record(path, RIG, make_frames(2) * 150)

    def cancel(share, words):
        assert 0.0 < share < 1.0
        raise AdviceError("cancelled")

    with pytest.raises(AdviceError, match="cancelled"):
        McapSource(path, cancel)


def test_a_damaged_frame_is_told_and_the_others_play(tmp_path):
    frames = make_frames(3)
    record(tmp_path / "whole.mcap", RIG, frames)
    data = bytearray((tmp_path / "whole.mcap").read_bytes())
    second = [offset for offset in range(len(data)) if data[offset : offset + 4] == LZ4_MAGIC][1]
    data[second + 300] ^= 0xFF
    (tmp_path / "bad.mcap").write_bytes(data)
    with McapSource(tmp_path / "bad.mcap") as source:
        assert same_frame(source.read(0), frames[0])
        with pytest.raises(SourceError, match=r"bad\.mcap: it is damaged \(.*\); copy it again if it is damaged"):
            source.read(1)
        assert same_frame(source.read(2), frames[2])


def test_a_full_queue_drops_and_counts_or_waits(tmp_path, monkeypatch):
    go = threading.Event()
    write = BagWriter.write

    def slowly(self, *message):
        assert go.wait(60)
        write(self, *message)

    monkeypatch.setattr(BagWriter, "write", slowly)
    monkeypatch.setattr("tactune.core.output.writer._QUEUE_BYTES", 1)
    frames = make_frames(6)
    writer = SessionWriter(tmp_path / "slow.mcap", RIG)
    assert writer.put(frames[0], wait=True)
    end = time.monotonic() + 60
    while not writer.put(frames[1], wait=False):  # until the thread has taken the first
        assert time.monotonic() < end, "the thread takes no frame"
        time.sleep(0.001)
    before = writer.status().dropped
    assert not writer.put(frames[2], wait=False)
    assert not writer.put(frames[3], wait=False)
    assert writer.status().dropped == before + 2
    assert writer.status().error == ""

    waiting = threading.Thread(target=lambda: [writer.put(frame, wait=True) for frame in frames[4:]])
    waiting.start()
    go.set()
    waiting.join(60)
    status = writer.close()
    assert (status.frames, status.dropped) == (4, before + 2)
    kept = [frames[0], frames[1], *frames[4:]]
    assert plays(tmp_path / "slow.mcap", kept, same_frame) == 4
