"""Recordings in other readers: the official MCAP reader with its ROS 2 decoder, and rosbags."""

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from scipy.spatial.transform import Rotation

from tactune.core import load_preset
from tactune.core.preset.file import preset_json

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


@pytest.fixture
def frames(make_frames):
    return make_frames(COUNT)


@pytest.fixture
def path(tmp_path, rig, frames, record):
    record(tmp_path / "a.mcap", rig, frames, preset=load_preset("default"))
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


def stamp_ns(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


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


def test_topics_images_and_stamps(path, rig, frames):
    found = decode(path)
    assert {topic: len(messages) for topic, messages in found.items()} == {
        topic: 1 if topic in ("/tactune/rig", "/tf_static") else COUNT for topic in TYPES
    }
    for index, frame in enumerate(frames):
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
            assert stamp_ns(image) == message.publish_time == round(time_s * 1e9)
            assert message.log_time == round(frame.proximity_time_s * 1e9)
            assert message.sequence == frame.sequence


def test_static_transforms_are_the_factory_poses(path, rig):
    ((_, message),) = decode(path)["/tf_static"]
    poses = {}
    for transform in message.transforms:
        assert transform.header.frame_id == "proximity_depth_optical_frame"
        q, t = transform.transform.rotation, transform.transform.translation
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
        pose[:3, 3] = t.x, t.y, t.z
        poses[transform.child_frame_id] = pose
    np.testing.assert_allclose(poses["tactile_depth_optical_frame"], rig.T_proximity_tactile, atol=1e-12)
    T_depth_color = np.linalg.inv(rig.proximity_color.T_color_depth)
    np.testing.assert_allclose(poses["proximity_color_optical_frame"], T_depth_color, atol=1e-12)
