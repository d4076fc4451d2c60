"""Killed writers, full or slow disks, truncated and damaged files: the written part stays playable."""

import os
import random
import threading
import time

import pytest

from tactune.core.errors import AdviceError, SourceError
from tactune.core.output.writer import BagWriter, SessionWriter
from tactune.core.sources.ros.mcap import MAGIC
from tactune.core.sources.tactune_files import McapSource

LZ4_MAGIC = b"\x04\x22\x4d\x18"


def plays(path, frames, same):
    """Check that a file is a prefix of the frames, and return how long it is."""
    with McapSource(path) as source:
        assert all(same(played, frame) for played, frame in zip(source, frames, strict=False))
        assert source.position == source.length
        return source.length


def test_a_file_cut_anywhere_plays_a_prefix_or_is_refused(tmp_path, rig, make_frames, record, same_frame):
    frames = make_frames(4)
    record(tmp_path / "whole.mcap", rig, frames)
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


def test_opening_a_long_recording_can_be_cancelled(tmp_path, rig, make_frames, record):
    path = tmp_path / "long.mcap"
    record(path, rig, make_frames(2) * 150)

    def cancel(share, words):
        assert 0.0 < share < 1.0
        raise AdviceError("cancelled")

    with pytest.raises(AdviceError, match="cancelled"):
        McapSource(path, cancel)


def test_a_damaged_frame_is_told_and_the_others_play(tmp_path, rig, make_frames, record, same_frame):
    frames = make_frames(3)
    record(tmp_path / "whole.mcap", rig, frames)
    data = bytearray((tmp_path / "whole.mcap").read_bytes())
    second = [offset for offset in range(len(data)) if data[offset : offset + 4] == LZ4_MAGIC][1]
    data[second + 300] ^= 0xFF
    (tmp_path / "bad.mcap").write_bytes(data)
    with McapSource(tmp_path / "bad.mcap") as source:
        assert same_frame(source.read(0), frames[0])
        with pytest.raises(SourceError, match=r"bad\.mcap: it is damaged \(.*\); copy it again if it is damaged"):
            source.read(1)
        assert same_frame(source.read(2), frames[2])


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (MAGIC[:5], r"holds no frame"),
        (b"\x89PNG", r"is no MCAP file"),
        (b"#ROSBAG V2.0\n" + bytes(4096), r"is no MCAP file"),
        (MAGIC, r"holds no frame"),
        (MAGIC + os.urandom(10000), r"holds no frame|is damaged"),
    ],
)
def test_what_is_no_recording_is_refused(tmp_path, content, sentence):
    (tmp_path / "a.mcap").write_bytes(content)
    with pytest.raises(SourceError, match=sentence):
        McapSource(tmp_path / "a.mcap")
    with pytest.raises(SourceError, match="there is no file"):
        McapSource(tmp_path / "b.mcap")


def test_a_full_queue_drops_and_counts_or_waits(tmp_path, rig, make_frames, same_frame, monkeypatch):
    go = threading.Event()
    write = BagWriter.write

    def slowly(self, *message):
        assert go.wait(60)
        write(self, *message)

    monkeypatch.setattr(BagWriter, "write", slowly)
    monkeypatch.setattr("tactune.core.output.writer._QUEUE_BYTES", 1)
    frames = make_frames(6)
    writer = SessionWriter(tmp_path / "slow.mcap", rig)
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
