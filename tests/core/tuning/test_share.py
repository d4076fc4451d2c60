"""A recording to share: readers of other makes see patch and findings, and Tactune finds all that belongs to it."""

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.sources.presets import load_preset
from tactune.core.sources.registry import open_source
from tactune.core.sources.tactune_files import McapSource
from tactune.core.tuning.advice.findings import Examiner
from tactune.core.tuning.share import share_mcap

FIRST, COUNT = 28, 4


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    """Return the file, the frames in it, the preset with prints that no mask removes, and the untouched frame."""
    path = tmp_path_factory.mktemp("share") / "a.mcap"
    preset = load_preset("simulator").with_value("mask.enabled", False)
    with open_source("sim:cup") as source, source.with_object_away() as away:
        frames, untouched = [source.read(FIRST + index) for index in range(COUNT)], away.read(0)
        source.seek(FIRST)
        assert share_mcap(source, path, COUNT, preset, untouched) == COUNT
    return path, frames, preset, untouched


def test_other_readers_see_patch_and_findings(shared):
    path, frames, preset, untouched = shared
    with open_source("sim:cup") as source:
        pipeline, examiner = ContactPipeline(preset, source.rig, untouched), Examiner(source.rig)
    patches = [pipeline.process(frame) for frame in frames]
    found = examiner.findings(frames[0], patches[0], preset, untouched)
    assert found and all(len(patch.points) for patch in patches)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        read = [(channel.topic, message) for _, channel, _, message in reader.iter_decoded_messages()]
    clouds = [message for topic, message in read if topic == "/contact/patch"]
    for patch, cloud in zip(patches, clouds, strict=True):
        assert np.array_equal(np.frombuffer(cloud.data, "<f4").reshape(-1, 3), patch.points)
    said = [message.data for topic, message in read if topic == "/contact/findings"]
    assert said == ["\n".join(finding.sentence for finding in found)] * COUNT
    with AnyReader([path]) as bag:
        (connection,) = (each for each in bag.connections if each.topic == "/contact/patch")
        assert sum(1 for _ in bag.messages([connection])) == COUNT


def test_tactune_opens_it_with_preset_and_untouched_frame(shared):
    path, frames, preset, untouched = shared
    with McapSource(path) as recording:
        assert recording.preset() == preset
        assert np.array_equal(recording.untouched().tactile_depth, untouched.tactile_depth)
        for frame, read in zip(frames, recording, strict=True):
            assert np.array_equal(read.proximity_depth, frame.proximity_depth)


def test_the_command_shares_with_the_usual_preset(tactune, tmp_path):
    path = tmp_path / "b.mcap"
    assert tactune("convert", "sim:cup", path, "--share", "--frames", 2).status == 0
    with McapSource(path) as recording:
        assert recording.preset().name == load_preset("simulator").name
    assert "--share" in tactune("convert", "sim:cup", tmp_path / "folder", "--share").sentence
