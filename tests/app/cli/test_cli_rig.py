"""``tactune preset capture-untouched | measure-rig``, ``tactune check`` and ``tactune run --watch``."""

import json
import shlex
from datetime import UTC, datetime

import cv2
import numpy as np
import pytest

from drifting import Drift, drifted, record_looks
from side_by_side import HEIGHT, PRINT_MASK, WIDTH, rig, wall_source
from tactune.core.preset import Preset
from tactune.core.preset.file import save_preset
from tactune.core.rig.untouched import load_untouched
from tactune.core.sources.folder import export_folder
from tactune.core.sources.presets import load_preset

__all__ = ["rig"]

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


def test_a_touched_membrane_is_no_untouched_frame_where_the_mask_hides_the_prints(tactune, recording, mine):
    words = ("preset", "capture-untouched", "--source", recording, "--preset", mine)
    finished = tactune(*words)
    assert finished.status == 0 and "averaged 4 frames" in finished.out
    preset = load_preset(mine)
    assert preset.untouched.frames == 4 and preset.created == LAST_YEAR < preset.modified
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
    first = min(recording.glob("**/tactile_depth.png"))
    touched = cv2.imread(str(first), cv2.IMREAD_UNCHANGED)
    touched[:, :16] -= 200
    cv2.imwrite(str(first), touched)  # it begins with a touch
    good = tactune(*words)
    assert good.status == 0
    assert "alignment was not checked" in good.err, "the recording has no tactile colour"
    assert good.out.splitlines() == ["still good: membrane moved by 0.0 mm"]
    for image in recording.glob("**/tactile_depth.png"):
        cv2.imwrite(str(image), cv2.imread(str(image), cv2.IMREAD_UNCHANGED) + np.uint16(25))
    moved = tactune(*words)
    assert moved.status == 1 and len(moved.out.splitlines()) == 1
    assert "The tactile camera has moved by 2.5 mm away from the membrane" in moved.out
    (captured.parent / load_preset(captured).untouched.file).unlink()
    assert tactune(*words).status == 2


@pytest.fixture
def wall(tmp_path, rig):
    export_folder(wall_source(rig, 14), tmp_path / "wall")
    return tmp_path / "wall"


@pytest.fixture
def masked(mine):
    save_preset(load_preset(mine).with_values(PRINT_MASK), mine)
    return mine


def test_noise_and_bias_are_said_and_stored(tactune, wall, masked):
    finished = tactune("preset", "measure-rig", "--source", wall, "--preset", masked)
    assert finished.status == 0
    tactile, proximity, bias, written = finished.out.splitlines()
    assert tactile.startswith("Tactile noise 0.30 mm") and proximity.startswith("Proximity noise 0.60 mm")
    assert bias.startswith("Bias between the cameras: +4.0 ± 0.2 mm, proximity farther")
    assert written == f"wrote {masked}"
    preset = load_preset(masked)
    assert preset.noise.bias_m == pytest.approx(0.004, abs=2e-4)
    assert preset.noise.frames == 14
    assert preset.created == LAST_YEAR < preset.modified


def test_the_untouched_frame_goes_with_the_preset(tactune, wall, masked, tmp_path):
    words = ("--source", wall, "--preset", masked)
    assert tactune("preset", "capture-untouched", *words, "--force").status == 0
    out = tmp_path / "elsewhere" / "copy.json"
    out.parent.mkdir()
    assert tactune("preset", "measure-rig", *words, "--out", out).status == 0
    copied = load_preset(out)
    assert copied.name == "mine"
    assert load_untouched(copied.untouched, out).tactile_depth.shape == (HEIGHT, WIDTH)
    assert load_preset(masked).noise is None


def test_the_inflation_is_measured_from_a_log_of_forces(tactune, masked, tmp_path):
    log = tmp_path / "scale.csv"
    log.write_text("frame,force_n\n0,22.5\n1,22.6\n")
    finished = tactune(
        "preset", "calibrate-force", "--source", "sim:cup?press=medium", "--forces", log, "--preset", masked
    )
    assert finished.status == 0 and finished.out.splitlines()[-1] == f"wrote {masked}"
    section = load_preset(masked).pressure
    assert 1000 < section.gauge_pa < 4000 and section.gauge_sigma_pa > 0.05 * section.gauge_pa
    log.write_text("frame,force_n\n400,22.5\n")
    finished = tactune("preset", "calibrate-force", "--source", "sim:cup?press=medium", "--forces", log)
    assert finished.status == 2 and str(log) in finished.err


@pytest.fixture(scope="module")
def moved(tmp_path_factory):
    """A recording with a frame in ten seconds; after 40 s the tactile camera stands 2 mm beside its place."""
    path = tmp_path_factory.mktemp("moved") / "moved.mcap"
    record_looks(path, [drifted()] * 4 + [drifted(Drift("tactile", (0.002, 0.0, 0.0)))] * 4)
    return path


def test_a_moved_camera_is_logged_once_with_its_number_and_the_re_check(tactune, moved):
    finished = tactune("run", "--source", moved, "--watch", "--json")
    assert finished.status == 0
    said = ["cameras moved" in json.loads(line)["doubt"] for line in finished.out.splitlines()]
    assert not any(said[:4]) and said[-1]
    [line] = [line for line in finished.err.splitlines() if "moved" in line and "has moved" in line]
    assert "The tactile camera has moved by 2.0 mm" in line
    advised = tactune(*shlex.split(line.partition("Check with: tactune ")[2]))
    assert advised.status == 1  # it has moved
    assert "calibrate again" in advised.out
