"""A recording is bit-identical: images, times, rig, truth, preset, and the patches computed from them."""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactune.core import load_preset
from tactune.core.errors import FrameError, PresetError
from tactune.core.model.frames import GroundTruth
from tactune.core.output.writer import SessionWriter
from tactune.core.sources.tactune_files import McapSource

SIZES = st.tuples(st.integers(1, 40), st.integers(1, 24))
#: Seconds of clocks that jump by decades; log times that follow four such jumps still fit into 63 bits.
TIMES = st.floats(-1e9, 2e9)


@settings(max_examples=40)
@given(data=st.data(), proximity=SIZES, tactile=SIZES, color=st.none() | SIZES)
def test_every_bit_of_random_frames_comes_back(
    make_rig, make_frame, record, same_frame, data, proximity, tactile, color
):
    rig = make_rig(proximity, tactile, color)
    frames = []
    for seed in range(data.draw(st.integers(1, 5))):
        frame = make_frame(rig, seed)
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


def test_a_frame_that_does_not_fit_is_refused_and_the_recording_goes_on(tmp_path, rig, make_frame, same_frame):
    good = make_frame(rig)
    with SessionWriter(tmp_path / "a.mcap", rig) as writer:
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


def test_no_file_is_left_empty(tmp_path, rig):
    path = tmp_path / "a.mcap"
    status = SessionWriter(path, rig).close()
    assert status.error == f"no frame arrived for {path}, so there is no file; check the source"
    assert not path.exists()


def test_a_damaged_preset_says_so_and_the_frames_still_play(tmp_path, rig, make_frames, record):
    record(tmp_path / "a.mcap", rig, make_frames(1), preset=load_preset("default"))
    data = (tmp_path / "a.mcap").read_bytes()
    (tmp_path / "b.mcap").write_bytes(data.replace(b'"tactune.preset"', b'"tactune.nonsens'))
    with McapSource(tmp_path / "b.mcap") as source:
        assert source.next_frame() is not None
        with pytest.raises(PresetError, match=r"b\.mcap: it is damaged \(the checksum of preset\.json is wrong\)"):
            source.preset()
