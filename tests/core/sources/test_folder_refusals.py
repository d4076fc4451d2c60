"""Unreadable folders of images are refused with one sentence that names the file and the value."""

import json

import cv2
import numpy as np
import pytest

from tactune.core.errors import SourceError
from tactune.core.sources.folder import FolderSource


def write(path, *shape, dtype=np.uint16, value=0):
    cv2.imwrite(str(path), np.full(shape, value, dtype))


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
    "wrong bit depth": (
        lambda p: write(p / F / "tactile_depth.png", 4, 6, dtype=np.uint8),
        r"tactile_depth\.png has 1 channels of 8 bits, but 1 of 16 bits",
    ),
    "wrong size": (
        lambda p: write(p / F / "proximity_depth.png", 5, 8),
        r"proximity_depth\.png is 8 x 5 pixels, but rig\.json says 7 x 5",
    ),
    "metres are mm": (
        lambda p: (
            cv2.imwrite(str(p / F / "tactile_depth.tiff"), np.full((4, 6), 400, np.float32))
            and (p / F / "tactile_depth.png").unlink()
        ),
        r"tactile_depth\.tiff has depths of 400 m and more, .* --unit mm",
    ),
    "no PNG": (lambda p: (p / F / "tactile_depth.png").write_bytes(b"oops"), r"tactile_depth\.png is no readable PNG"),
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
