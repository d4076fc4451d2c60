"""``tactune record``, ``tactune convert``, ``tactune run --out patches.mcap`` and ``tactune preset create-rig``."""

import signal
import subprocess
import sys
import time
from xml.etree import ElementTree

import cv2
import h5py
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from capture_sources import same_frame
from ros_messages import points_of
from tactune.core import ContactPipeline, Preset, load_preset, open_source
from tactune.core.model.rig_file import load_rig
from tactune.core.preset.file import save_preset
from tactune.core.rig.untouched import untouched_frame
from tactune.core.sources.lens_files import read_lenses
from tactune.core.sources.tactune_files import McapSource


def assert_same_recording(first, second):
    assert first.rig == second.rig
    assert first.length == second.length
    assert all(map(same_frame, first, second))


def test_a_recording_is_recorded_whole(tmp_path, recording, tactune):
    done = tactune("record", "--source", recording, "--out", tmp_path / "new" / "a.mcap", "--preset", "default")
    assert (done.status, done.err) == (0, "")
    assert done.out.startswith(f"recorded 4 frames of folder:{recording}, ")
    tactune("record", "-s", recording, "-o", tmp_path / "short.mcap", "--frames", 3)
    with McapSource(tmp_path / "short.mcap") as short, McapSource(tmp_path / "new" / "a.mcap") as source:
        assert short.length == 3
        assert source.preset() == load_preset("default")
        with open_source(str(recording)) as original:
            assert_same_recording(source, original)


def test_converting_there_and_back_changes_no_bit(tmp_path, recording, tactune):
    assert tactune("convert", recording, tmp_path / "a.mcap", "--preset", "simulator").status == 0
    done = tactune("convert", tmp_path / "a.mcap", tmp_path / "back")
    assert done.status == 0
    assert done.out == f"wrote 4 frames of mcap:{tmp_path / 'a.mcap'} to {tmp_path / 'back'}\n"
    assert "a folder cannot hold a preset; 'simulator' was not written" in done.err
    assert tactune("convert", tmp_path / "a.mcap", tmp_path / "b.mcap").err == ""
    with McapSource(tmp_path / "b.mcap") as source:
        assert source.preset() == load_preset("simulator")
    for copy in ("back", "b.mcap"):
        with open_source(str(recording)) as original, open_source(str(tmp_path / copy)) as source:
            assert_same_recording(source, original)


def test_patches_go_into_one_bag_with_the_stamps_of_their_frames(tmp_path, recording, tactune):
    out = tmp_path / "patches.mcap"
    done = tactune("run", "--source", recording, "--preset", "default", "--out", out)
    assert done.status == 0
    assert f"wrote {out}\n" in done.out
    with out.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        clouds = [(message, cloud) for _, _, message, cloud in reader.iter_decoded_messages(["/contact/patch"])]
        assert set(reader.get_summary().statistics.channel_message_counts.values()) == {len(clouds)}
    with open_source(str(recording)) as source:
        pipeline = ContactPipeline(load_preset("default"), source.rig)
        for frame, (message, cloud) in zip(source, clouds, strict=True):
            stamp = cloud.header.stamp
            assert stamp.sec * 10**9 + stamp.nanosec == round(frame.proximity_time_s * 1e9)
            assert message.sequence == frame.sequence
            assert cloud.header.frame_id == "proximity_depth_optical_frame" and cloud.is_dense
            np.testing.assert_array_equal(points_of(cloud)[0], pipeline.process(frame).points)
    assert len(clouds[-1][1].data) > 0
    assert "patches.mcap is already there" in tactune("run", "-s", recording, "--out", out).sentence
    assert "holds contact patches only" in tactune("run", "-s", out).sentence


def test_a_bag_of_patches_holds_their_force_and_pressure(tmp_path, tactune):
    source, out, gauge_pa = "sim:cup?press=medium&cameras=tactile", tmp_path / "force.mcap", 2000.0
    preset = Preset(contact_test="pressure").with_value("pressure.gauge_pa", gauge_pa)
    save_preset(preset, tmp_path / "a.json")
    assert tactune("run", "-s", source, "-p", tmp_path / "a.json", "-n", 1, "-o", out).status == 0
    with open_source(source) as opened:
        patch = ContactPipeline(preset, opened.rig, untouched_frame(opened)).process(opened.next_frame())
    with AnyReader([out]) as reader:
        seen = {of.topic: reader.deserialize(data, of.msgtype) for of, _, data in reader.messages()}
    force = seen["/contact/wrench"].wrench.force
    assert (force.x, force.y, force.z) == patch.force_n
    assert seen["/contact/relative_force_mm2"].vector.z == patch.pressure.force_mm2[2]
    assert len(seen["/contact/force_arrow"].points) == 2
    reasons = next(pair.value for pair in seen["/contact/doubt"].status[0].values if pair.key == "doubt")
    assert reasons == ", ".join(patch.doubt.reasons) != ""
    values = points_of(seen["/contact/patch"], "relative_pressure", "pressure_pa")[0]
    np.testing.assert_array_equal(values[:, :3], patch.points)
    np.testing.assert_array_equal(values[:, 4], patch.pressure_pa[patch.mask])


def test_sigterm_ends_a_live_source_with_a_whole_file(tmp_path, recording):
    out = tmp_path / "a.mcap"
    command = [sys.executable, "-m", "tactune.app", "record", "-s", f"live:folder:{recording}", "-o", str(out)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as child:
        end = time.monotonic() + 300
        while not (out.exists() and out.stat().st_size > 20_000) and time.monotonic() < end:
            time.sleep(0.05)
        child.send_signal(signal.SIGTERM)
        printed, said = child.communicate(timeout=300)
    assert child.returncode == 0, said
    assert str(out) in printed
    with out.open("rb") as file:
        assert make_reader(file).get_summary().statistics.message_count > 0


def test_a_recording_becomes_hdf5_and_its_calibration_urdf(tactune, recording, tmp_path):
    done = tactune("convert", recording, tmp_path / "a.h5", "-n", "3")
    assert done.status == 0 and "wrote 3 frames" in done.out
    with h5py.File(tmp_path / "a.h5") as file:
        assert len(file["sequence"]) == 3
    assert tactune("convert", recording, tmp_path / "a.urdf").status == 0
    assert ElementTree.parse(tmp_path / "a.urdf").getroot().tag == "robot"
    assert tactune("convert", "simulator", tmp_path / "b.yaml", "--to", "kalibr").status == 0
    assert len(read_lenses(tmp_path / "b.yaml")) == 3


@pytest.fixture
def bare(recording):
    """A recording without its rig."""
    (recording / "rig.json").unlink()
    return recording


def test_the_message_of_a_folder_without_a_rig_names_the_command_and_that_makes_it_a_source(tactune, bare):
    refused = tactune("run", "--source", bare, "--json")
    assert refused.status == 2 and "rig.json" in refused.err and "tactune preset create-rig" in refused.err
    assert tactune("preset", "create-rig", bare, "--proximity", "L515=60,61,31.5,23.5", "--tactile", "D405").status == 0
    rig = load_rig(bare / "rig.json")
    lens = rig.proximity.intrinsics
    assert (lens.fx, lens.fy, lens.cx, lens.cy) == (60, 61, 31.5, 23.5)
    assert (rig.proximity.model, rig.tactile.model) == ("L515", "D405")
    assert (rig.proximity.depth_unit_m, rig.tactile.depth_unit_m) == (0.00025, 0.0001)
    info = tactune("preset", "create-rig", bare, "--proximity", "L515", "--tactile", "D405")
    assert info.status == 2 and "already there" in info.err


def test_what_is_assumed_is_said(tactune, bare):
    for path in bare.rglob("proximity_color.png"):
        cv2.imwrite(str(path), cv2.resize(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), (48, 30)))
    unknown = tactune("create-rig", bare, "--proximity", "D435=60,61,31.5,23.5")
    assert unknown.status == 2 and "lens of the tactile camera is unknown" in unknown.err
    done = tactune("create-rig", bare, "--proximity", "D435=60,61,31.5,23.5", "--tactile", "D405", "--unit", "mm")
    assert done.status == 0
    assert "the pose of the colour camera is unknown, so its images are left out" in done.err
    assert load_rig(bare / "rig.json").proximity_color is None
    assert "the depth lens of the D405 is the maker's" in done.err
    assert "depth lens of the D435" not in done.err
