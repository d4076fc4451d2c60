"""Folders of images: reading, and a lossless export."""

import json

import cv2
import numpy as np
import pytest

from capture_sources import same_frame
from folder_scenes import RIG, list_source, make_frame
from tactune.core.model.frames import GroundTruth
from tactune.core.sources.folder import FolderSource, export_folder

# --- round trip ------------------------------------------------------------------------------------


def test_an_export_gives_back_every_bit(tmp_path):
    frames = [
        make_frame(0),
        make_frame(1, tactile_color=None, truth=None),
        make_frame(2, truth=GroundTruth(np.zeros((5, 7), bool))),
    ]
    untouched = make_frame(3, sequence=4, truth=None)
    assert export_folder(list_source(frames, untouched=untouched), tmp_path / "out") == 3
    with FolderSource(tmp_path / "out") as source:
        assert source.rig == RIG
        assert source.length == 3
        read = list(source)
        for before, after in zip(frames, read, strict=True):
            assert same_frame(before, after)
        stored = source.untouched()
    assert stored is not None
    assert same_frame(untouched, stored)


# --- reading ---------------------------------------------------------------------------------------


def test_one_frame_may_lie_beside_rig_json(recording):
    single = recording / "000001"
    (recording / "rig.json").rename(single / "rig.json")
    (single / "frame.json").unlink()
    source = FolderSource(single)
    assert source.length == 1
    assert source.frame_rate_hz == 30.0
    assert source.untouched() is None
    assert same_frame(source.read(0), make_frame(1, sequence=0, proximity_time_s=0.0, tactile_time_s=0.0))


def test_numbered_frames_come_in_numeric_order_with_gaps(recording):
    (recording / "000000").rename(recording / "10")
    (recording / "000001").rename(recording / "9")
    (recording / "notes").mkdir()
    (recording / "10" / "frame.json").unlink()
    source = FolderSource(recording)
    assert [frame.sequence for frame in source] == [101, 1]
    assert source.read(1).proximity_time_s == source.read(1).tactile_time_s == pytest.approx(1 / 30)
    source.seek(1)
    last = source.next_frame()
    assert last.sequence == 1
    assert source.next_frame() is None


def test_the_real_pair_is_read_as_it_is(tmp_path, shared_data):
    folder = shared_data / "real_pair"
    source = FolderSource(folder)
    frame = source.read(0)
    rig = json.loads((folder / "rig.json").read_text())
    assert source.rig.proximity.intrinsics.fx == rig["proximity"]["fx"]
    assert source.rig.tactile.depth_unit_m == rig["tactile"]["depth_unit_m"]
    np.testing.assert_array_equal(source.rig.T_proximity_tactile, rig["T_proximity_tactile"])
    for name in ("proximity_depth", "tactile_depth"):
        np.testing.assert_array_equal(getattr(frame, name), cv2.imread(str(folder / f"{name}.png"), -1))
    for name in ("proximity_color", "tactile_color"):
        np.testing.assert_array_equal(getattr(frame, name), cv2.imread(str(folder / f"{name}.png"))[:, :, ::-1])
    export_folder(source, tmp_path / "copy")
    copy = FolderSource(tmp_path / "copy")
    assert copy.rig == source.rig
    assert same_frame(frame, copy.read(0))
