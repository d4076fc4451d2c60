"""Folders of images: reading, a lossless export, refusals in one sentence; names of sources."""

import json

import cv2
import numpy as np
import pytest

from capture_sources import same_frame
from folder_scenes import RIG, list_source, make_frame
from tactune.core.errors import SourceError
from tactune.core.model.frames import GroundTruth
from tactune.core.sources.folder import FolderSource, export_folder
from tactune.core.sources.registry import open_source


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


def test_export_starts_at_the_position_and_stops_after_so_many_frames(tmp_path):
    source = list_source([make_frame(seed) for seed in range(5)])
    source.seek(1)
    told = []
    assert export_folder(source, tmp_path / "out", frames=3, progress=lambda share, _: told.append(share)) == 3
    assert [frame.sequence for frame in FolderSource(tmp_path / "out")] == [101, 102, 103]
    assert told == pytest.approx([1 / 3, 2 / 3, 1.0])
    assert export_folder(source, tmp_path / "rest", frames=9, progress=lambda share, _: told.append(share)) == 1
    assert told[-1] == 1.0


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


def edit(path, **changes):
    data = json.loads(path.read_text())
    for key, value in changes.items():
        if value is None:
            del data[key]
        else:
            data[key] = value
    path.write_text(json.dumps(data))


F = "000000"
BAD = {
    "no rig": (lambda p: (p / "rig.json").unlink(), r"there is no file .*rig\.json"),
    "rig is no JSON": (
        lambda p: (p / "rig.json").write_text("{\n oops"),
        r"rig\.json cannot be used: .*line 2",
    ),
    "no frames": (
        lambda p: [(p / F).rename(p / "a"), (p / "000001").rename(p / "b")],
        r"the same image of one frame; number them",
    ),
    "wrong size": (
        lambda p: cv2.imwrite(str(p / F / "proximity_depth.png"), np.zeros((5, 8), np.uint16)),
        r"proximity_depth\.png is 8 x 5 pixels, its rig\.json says 7 x 5",
    ),
    "metres are mm": (
        lambda p: (
            cv2.imwrite(str(p / F / "tactile_depth.tiff"), np.full((4, 6), 400, np.float32))
            and (p / F / "tactile_depth.png").unlink()
        ),
        r"tactile_depth\.tiff has depths of 400 m and more, .* --unit mm",
    ),
    "no PNG": (lambda p: (p / F / "tactile_depth.png").write_bytes(b"oops"), r"_depth\.png: it is no readable PNG"),
    "one sequence twice": (
        lambda p: edit(p / "000001/frame.json", sequence=json.loads((p / F / "frame.json").read_text())["sequence"]),
        r"has two frames of the same sequence in frame\.json; correct it",
    ),
    "pose of 2 m": (
        lambda p: edit(p / "rig.json", T_proximity_tactile=[[1, 0, 0, 2], [0, 1, 0, 0], [0, 0, 1, 1], [0, 0, 0, 1]]),
        r"rig\.json: T_proximity_tactile is .*at most 1 m apart, the translation here is 2 0 1: is it in mm",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_recording_is_refused_in_one_sentence_when_it_is_opened(recording, case):
    FolderSource(recording)
    spoil, sentence = BAD[case]
    spoil(recording)
    with pytest.raises(SourceError, match=sentence) as caught:
        FolderSource(recording)
    assert "\n" not in str(caught.value)


def test_a_later_bad_frame_is_told_when_it_is_read(recording):
    (recording / "000001/proximity_color.png").write_bytes(b"oops")
    source = FolderSource(recording)
    assert source.next_frame() is not None
    with pytest.raises(SourceError, match=r"000001/proximity_color\.png"):
        source.next_frame()


def test_a_folder_is_opened_by_scheme_or_by_its_rig(recording):
    for name in (f"folder:{recording}", str(recording), str(recording / "rig.json")):
        with open_source(name) as source:
            assert isinstance(source, FolderSource)
            assert source.name == f"folder:{recording}"
            assert source.length == 2


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("", r"'' is no source: give an existing path or one of sim:SCENE"),
        ("nowhere/at/all", r"'nowhere/at/all' is no source: there is no such file or folder"),
        ("folder:", r"folder: needs a path, as in folder:PATH"),
        ("bag:", r"bag: needs a path, as in bag:PATH"),
        ("live:", r"live: needs another source, as in live:sim"),
        ("live:folder:nowhere", r"folder:nowhere: there is no folder nowhere"),
        ("cameras:1", r"cameras:1: give both serial numbers, as in cameras:f0090001,130322270002, or none"),
        ("folder:nowhere", r"folder:nowhere: there is no folder nowhere"),
        ("bag:nowhere", r"bag:nowhere: there is no file nowhere"),
        ("sim:table", "scene is 'table'"),
    ],
)
def test_a_name_that_opens_nothing_is_answered_in_one_sentence(name, sentence, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SourceError, match=sentence) as caught:
        open_source(name)
    assert "\n" not in str(caught.value)
