"""Recordings in the official MCAP reader, ones to share, and bags with Tactune's topics that other programs wrote."""

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from capture_sources import same_frame
from folder_scenes import RIG, make_frame, make_frames, record
from tactune.core import load_preset
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.errors import SourceError
from tactune.core.preset.file import preset_json
from tactune.core.sources.registry import open_source
from tactune.core.sources.tactune_files import McapSource
from tactune.core.tuning.advice.findings import Examiner
from tactune.core.tuning.share import share_mcap

TYPES = {
    "/tactune/frame": "std_msgs/msg/String",
    "/tactune/rig": "std_msgs/msg/String",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/proximity/depth/image": "sensor_msgs/msg/Image",
    "/proximity/depth/camera_info": "sensor_msgs/msg/CameraInfo",
    "/proximity/color/image": "sensor_msgs/msg/Image",
    "/proximity/color/camera_info": "sensor_msgs/msg/CameraInfo",
    "/tactile/depth/image": "sensor_msgs/msg/Image",
    "/tactile/depth/camera_info": "sensor_msgs/msg/CameraInfo",
    "/tactile/color/image": "sensor_msgs/msg/Image",
    "/tactile/color/camera_info": "sensor_msgs/msg/CameraInfo",
    "/truth/contact/image": "sensor_msgs/msg/Image",
    "/truth/depth/image": "sensor_msgs/msg/Image",
}
COUNT = 3
FRAMES = make_frames(COUNT)


@pytest.fixture
def path(tmp_path):
    record(tmp_path / "a.mcap", RIG, FRAMES, preset=load_preset("default"))
    return tmp_path / "a.mcap"


def decode(path):
    """Read all messages with checksums on, by topic."""
    found = {}
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
            assert schema.name == TYPES[channel.topic]
            found.setdefault(channel.topic, []).append((message, decoded))
    return found


def test_the_container_has_all_that_readers_seek_by(path):
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        attachments = {attachment.name: attachment for attachment in reader.iter_attachments()}
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
    assert {channel.topic for channel in summary.channels.values()} == set(TYPES)
    assert summary.statistics.message_count == 2 + COUNT * (len(TYPES) - 2)
    assert summary.statistics.chunk_count == len(summary.chunk_indexes) == COUNT
    assert {index.compression for index in summary.chunk_indexes} == {"lz4"}
    assert attachments["preset.json"].data.decode() == preset_json(load_preset("default"))
    assert attachments["rig.json"].media_type == "application/json"
    assert metadata["tactune"]["frame_rate_hz"] == "30.0"


def test_topics_images_and_stamps(path):
    found = decode(path)
    assert {topic: len(messages) for topic, messages in found.items()} == {
        topic: 1 if topic in ("/tactune/rig", "/tf_static") else COUNT for topic in TYPES
    }
    for index, frame in enumerate(FRAMES):
        images = {
            "/proximity/depth/image": ("16UC1", "proximity_depth_optical_frame", frame.proximity_depth),
            "/proximity/color/image": ("rgb8", "proximity_color_optical_frame", frame.proximity_color),
            "/tactile/depth/image": ("16UC1", "tactile_depth_optical_frame", frame.tactile_depth),
            "/tactile/color/image": ("rgb8", "tactile_depth_optical_frame", frame.tactile_color),
            "/truth/contact/image": (
                "mono8",
                "proximity_depth_optical_frame",
                frame.truth.contact.astype(np.uint8) * 255,
            ),
            "/truth/depth/image": ("32FC1", "proximity_depth_optical_frame", frame.truth.depth_m),
        }
        for topic, (encoding, frame_id, pixels) in images.items():
            message, image = found[topic][index]
            assert (image.encoding, image.header.frame_id) == (encoding, frame_id)
            assert (image.height, image.width) == pixels.shape[:2]
            assert (image.is_bigendian, image.step) == (0, pixels.nbytes // len(pixels))
            assert bytes(image.data) == pixels.tobytes()
            time_s = frame.tactile_time_s if topic.startswith("/tactile") else frame.proximity_time_s
            stamp = image.header.stamp
            assert stamp.sec * 10**9 + stamp.nanosec == message.publish_time == round(time_s * 1e9)
            assert message.log_time == round(frame.proximity_time_s * 1e9)
            assert message.sequence == frame.sequence


def test_static_transforms_are_the_factory_poses(path):
    ((_, message),) = decode(path)["/tf_static"]
    poses = {}
    for transform in message.transforms:
        assert transform.header.frame_id == "proximity_depth_optical_frame"
        q, t = transform.transform.rotation, transform.transform.translation
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
        pose[:3, 3] = t.x, t.y, t.z
        poses[transform.child_frame_id] = pose
    np.testing.assert_allclose(poses["tactile_depth_optical_frame"], RIG.T_proximity_tactile, atol=1e-12)
    T_depth_color = np.linalg.inv(RIG.proximity_color.T_color_depth)
    np.testing.assert_allclose(poses["proximity_color_optical_frame"], T_depth_color, atol=1e-12)


LATE_NS = {"/tactune/frame": 0, "/proximity/depth/image": 3_000_000, "/tactile/depth/image": 9_000_000}


#: At 30 Hz.
TIMED = [make_frame(n, proximity_time_s=2.0 + n / 30, tactile_time_s=2.001 + n / 30) for n in range(5)]


@pytest.fixture
def ours(tmp_path):
    record(tmp_path / "ours.mcap", RIG, TIMED)
    return tmp_path / "ours.mcap"


def rewrite(ours, target, without=(), late=False, **options):
    """Copy the messages with the official library, as a converter or a recorder in ROS does: no attachments."""
    with ours.open("rb") as source, target.open("wb") as file:
        writer = Writer(file, **options)
        writer.start("ros2")
        schemas = {}
        channels = {}
        for schema, channel, message in make_reader(source).iter_messages():
            if channel.topic.startswith(without):
                continue
            if schema.name not in schemas:
                schemas[schema.name] = writer.register_schema(schema.name, schema.encoding, schema.data)
            if channel.topic not in channels:
                channels[channel.topic] = writer.register_channel(channel.topic, "cdr", schemas[schema.name])
            delay = LATE_NS.get(channel.topic, 5_000_000) if late else 0
            writer.add_message(
                channels[channel.topic], message.log_time + delay, message.data, message.publish_time, message.sequence
            )
        writer.finish()
    return target


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"compression": CompressionType.LZ4, "chunk_size": 200},
        {"compression": CompressionType.NONE},
        {"use_chunking": False},
        {"index_types": IndexType.NONE},
        {"index_types": IndexType.CHUNK},
        {"use_statistics": False, "repeat_channels": False},
        {"late": True, "chunk_size": 300},
    ],
)
def test_a_copy_by_other_tools_plays_the_same(tmp_path, ours, options):
    with McapSource(rewrite(ours, tmp_path / "copy.mcap", **options)) as source:
        assert source.health().ok
        assert source.rig == RIG
        assert source.length == len(TIMED)
        assert all(map(same_frame, source, TIMED))
        assert source.frame_rate_hz == pytest.approx(30.0, rel=1e-6)


def test_a_bag_without_a_rig_is_refused(tmp_path, ours):
    with pytest.raises(SourceError, match=r"has no rig\.json and no /tactune/rig"):
        McapSource(rewrite(ours, tmp_path / "plain.mcap", without=("/tactune",)))


def test_a_bag_without_tactile_depth_is_refused(tmp_path, ours):
    for without, sentence in (
        ("/tactile/depth/image", r"holds no frame: no image is on /tactile/depth/image \(its topics are /prox"),
        ("/", r"holds no frame: .* \(it has no messages\)"),
    ):
        with pytest.raises(SourceError, match=sentence):
            McapSource(rewrite(ours, tmp_path / "part.mcap", without=(without,)))


FIRST = 28


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


def test_the_command_shares_with_the_usual_preset(tactune, tmp_path):
    path = tmp_path / "b.mcap"
    assert tactune("convert", "sim:cup", path, "--share", "--frames", 2).status == 0
    with McapSource(path) as recording:
        assert recording.preset().name == load_preset("simulator").name
    assert "--share" in tactune("convert", "sim:cup", tmp_path / "folder", "--share").sentence
