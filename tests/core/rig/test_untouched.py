"""The untouched frame of a preset: captured, stored beside it, loaded, and refused with a message."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from fakes import FakeSource, tiny_frame
from rigs import one_place_rig
from tactune.core.calibration.snapshots import content_hash
from tactune.core.errors import CalibrationError, PresetError
from tactune.core.model.frames import SensorFrame
from tactune.core.output.writer import SessionWriter
from tactune.core.preset import Preset, UntouchedRecord
from tactune.core.preset.file import save_preset
from tactune.core.rig.untouched import (
    average_untouched,
    find_untouched,
    frames_to_average,
    load_untouched,
    save_untouched,
)
from tactune.core.sources.presets import load_preset
from tactune.core.sources.registry import open_source
from tactune.core.sources.tactune_files import McapSource

HEIGHT, WIDTH = 96, 128
MEMBRANE = 2800


RIG = one_place_rig(WIDTH, HEIGHT, 90.0)


def untouched_image(number, noise=4.0):
    rng = np.random.default_rng(number)
    return SensorFrame(
        sequence=number,
        proximity_depth=rng.normal(2000, noise, (HEIGHT, WIDTH)).round().astype(np.uint16),
        tactile_depth=rng.normal(MEMBRANE, noise, (HEIGHT, WIDTH)).round().astype(np.uint16),
        proximity_color=np.full((HEIGHT, WIDTH, 3), 90, np.uint8),
    )


def dented(frame, counts, size):
    depth = frame.tactile_depth.copy()
    depth[:size, :size] -= counts
    return replace(frame, tactile_depth=depth)


def still(untouched=None, rig=RIG):
    """A source whose own untouched frame can be chosen."""
    return FakeSource(rig=rig, untouched=untouched)


@pytest.fixture
def kept(tmp_path):
    """A preset with an untouched frame beside it."""
    captured = average_untouched(map(untouched_image, range(5)))
    record = save_untouched(captured.frame, captured.frames, tmp_path / "kept.json")
    preset = Preset(name="kept", untouched=record)
    save_preset(preset, tmp_path / "kept.json")
    return tmp_path / "kept.json", load_preset(tmp_path / "kept.json"), captured.frame


# Capturing


@pytest.mark.parametrize(("counts", "size", "refused"), [(60, 32, True), (6, 96, False)])
def test_something_that_touches_meanwhile_is_refused(counts, size, refused):
    frames = [*map(untouched_image, range(4)), dented(untouched_image(4), counts, size)]
    if not refused:
        assert average_untouched(frames).frames == 5
        return
    with pytest.raises(CalibrationError, match=r"moved while .* frame 5 .* 2\.\d %"):
        average_untouched(frames)
    assert average_untouched([*map(untouched_image, range(8)), frames[-1]]).frames == 8, "those before it are enough"


def test_noise_that_neighbours_share_is_no_movement():
    with open_source("sim:cup?press=none&sensor=heavy") as source:
        assert average_untouched(itertools.islice(source, 5)).frames == 5


def test_noise_of_depth_in_millimetres_is_no_movement():
    """The median of a tile between two counts falls to one or the other: 0.7 % of the depth."""
    noise = np.random.default_rng(0).normal(140.5, 0.4, (5, HEIGHT, WIDTH)).round().astype(np.uint16)
    frames = [replace(untouched_image(index), tactile_depth=noise[index]) for index in range(5)]
    assert average_untouched(frames).frames == 5


# The file


@pytest.mark.parametrize("name", [".bash_profile", "../untouched-0123456789ab.npz", "untouched-0123456789ab.npz\n"])
def test_a_preset_names_no_other_file(name):
    with pytest.raises(ValueError, match="file"):
        UntouchedRecord(file=name, sha256="0" * 64, frames=1)


# Which one is used


def test_the_presets_own_untouched_frame_comes_before_the_sources(kept):
    path, preset, frame = kept
    found = find_untouched(preset, path, still(untouched_image(7)))
    assert found.frame is not None
    assert content_hash(found.frame) == content_hash(frame)
    assert not found.warnings


def test_a_missing_untouched_frame_is_a_warning_and_the_sources_is_taken(kept):
    path, preset, _ = kept
    (path.parent / preset.untouched.file).unlink()
    others = untouched_image(7)
    found = find_untouched(preset, path, still(others))
    assert found.frame is others
    (sentence,) = found.warnings
    assert "missing" in sentence
    assert find_untouched(preset, path, still()).frame is None


def test_an_untouched_frame_of_another_rig_or_without_depth_is_not_used(kept):
    path, preset, _ = kept
    wide = RIG.proximity.model_copy(update={"intrinsics": RIG.proximity.intrinsics.model_copy(update={"width": 200})})
    found = find_untouched(preset, path, still(rig=RIG.model_copy(update={"proximity": wide})))
    assert found.frame is None
    assert "200 x 96" in found.warnings[0]
    blind = replace(untouched_image(7), tactile_depth=np.zeros((HEIGHT, WIDTH), np.uint16))
    assert "tactile depth in 0 %" in find_untouched(Preset(), None, still(blind)).warnings[0]


def test_without_one_the_source_is_asked():
    assert find_untouched(Preset(), None, still()).frame is None
    with open_source("sim:cup?press=medium&sensor=datasheet") as source:
        found = find_untouched(Preset(), "simulator", source).frame
        free = found.tactile_depth[200:280, 280:360].mean() - source.read(0).tactile_depth[200:280, 280:360].mean()
    assert free > 100, "the object is away"


def test_a_recording_holds_the_untouched_frame_of_its_preset(kept, tmp_path):
    _, preset, frame = kept
    path, bare = tmp_path / "both.mcap", tmp_path / "bare.mcap"
    for file, untouched in ((path, frame), (bare, None)):
        with SessionWriter(file, RIG, preset=preset, untouched=untouched) as writer:
            writer.put(untouched_image(3), wait=True)
    assert content_hash(load_untouched(load_preset(path).untouched, path)) == content_hash(frame)
    with McapSource(path) as source:
        for origin in (path, None):
            found = find_untouched(preset, origin, source)
            assert found.frame is not None
            assert not found.warnings
    with pytest.raises(PresetError, match="not the one"):
        load_untouched(preset.untouched, bare)


@pytest.mark.parametrize(("length", "slow"), [(100, 1), (60, 2)])  # the second moves little per frame, and ends at rest
def test_a_recording_is_searched_for_its_longest_rest(length, slow):
    """A release, a rest, a press that bulges the membrane around it, and a press that is held longer than the rest."""

    def make(index, rig):
        frame, pushed = tiny_frame(index, rig), 0
        if index < 10 * slow or index >= 30 * slow:
            pushed = min(20 * abs(index - (10 if index < 20 * slow else 30) * slow) // slow, 200)
        depth = frame.tactile_depth.astype(np.int32)
        depth[:32, :32] -= pushed
        depth[32:] += pushed // 10
        return replace(frame, tactile_depth=depth.astype(np.uint16))

    with frames_to_average(FakeSource(length, make=make), 1) as (first,):
        assert 9 * slow <= first.sequence <= 15 * slow
