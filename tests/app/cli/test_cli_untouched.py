"""``tactune preset capture-untouched``, the users of the untouched frame, and ``tactune check``."""

from datetime import UTC, datetime

import cv2
import numpy as np
import pytest

from tactune.core.preset import Preset
from tactune.core.preset.file import save_preset
from tactune.core.rig.untouched import load_untouched
from tactune.core.sources.presets import load_preset

LAST_YEAR = datetime(2025, 6, 1, tzinfo=UTC)


@pytest.fixture
def mine(tmp_path):
    """A preset of last year in a folder of its own."""
    save_preset(Preset(name="mine", created=LAST_YEAR, modified=LAST_YEAR), tmp_path / "presets" / "mine.json")
    return tmp_path / "presets" / "mine.json"


@pytest.fixture
def captured(tactune, recording, mine):
    """The preset with the recording's flat membrane, which its frames keep, as its untouched frame."""
    assert tactune("preset", "capture-untouched", "--source", recording, "--preset", mine).status == 0
    return mine


def set_tactile_depth(recording, counts):
    for image in recording.glob("**/tactile_depth.png"):
        shape = cv2.imread(str(image), cv2.IMREAD_UNCHANGED).shape
        cv2.imwrite(str(image), np.full(shape, counts, np.uint16))


def test_capturing_puts_a_file_beside_the_preset(tactune, recording, mine):
    finished = tactune("preset", "capture-untouched", "--source", recording, "--preset", mine)
    assert finished.status == 0
    assert "averaged 4 frames" in finished.out
    preset = load_preset(mine)
    assert preset.untouched.frames == 4
    assert (load_untouched(preset.untouched, mine).tactile_depth == 3000).all()
    assert preset.created == LAST_YEAR < preset.modified


def test_a_touched_membrane_is_no_untouched_frame_where_the_mask_hides_the_prints(tactune, recording, mine):
    words = ("preset", "capture-untouched", "--source", recording, "--preset", mine)
    assert tactune(*words).status == 0
    save_preset(Preset(name="mine").with_values({"mask.enabled": True, "mask.hue": (140, 170)}), mine)
    before = mine.read_bytes()
    sentence = tactune(*words).sentence
    assert "finds contact of" in sentence and "--force" in sentence
    assert mine.read_bytes() == before
    forced = tactune(*words, "--force")
    assert forced.status == 0
    assert load_preset(mine).untouched is not None


def test_check_is_one_line_and_a_status(tactune, recording, captured):
    words = ("check", "--source", recording, "--preset", captured)
    good = tactune(*words)
    assert good.status == 0
    assert "alignment was not checked" in good.err, "the recording has no tactile colour"
    assert good.out.splitlines() == ["still good: membrane moved by 0.0 mm"]
    set_tactile_depth(recording, 3025)
    moved = tactune(*words)
    assert moved.status == 1 and len(moved.out.splitlines()) == 1
    assert "The tactile camera has moved by 2.5 mm away from the membrane" in moved.out
    (captured.parent / load_preset(captured).untouched.file).unlink()
    assert tactune(*words).status == 2
