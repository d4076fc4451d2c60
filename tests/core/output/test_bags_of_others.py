"""Bags with Tactune's topics from other programs: re-recorded, rewritten, differently compressed, without a rig."""

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from tactune.core.errors import SourceError
from tactune.core.sources.tactune_files import McapSource

LATE_NS = {"/tactune/frame": 0, "/proximity/depth/image": 3_000_000, "/tactile/depth/image": 9_000_000}


@pytest.fixture
def frames(rig, make_frame):
    """Frames at 30 Hz."""
    return [
        make_frame(rig, seed, proximity_time_s=2.0 + seed / 30, tactile_time_s=2.001 + seed / 30) for seed in range(5)
    ]


@pytest.fixture
def ours(tmp_path, rig, frames, record):
    record(tmp_path / "ours.mcap", rig, frames)
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
def test_a_copy_by_other_tools_plays_the_same(tmp_path, ours, rig, frames, same_frame, options):
    with McapSource(rewrite(ours, tmp_path / "copy.mcap", **options)) as source:
        assert source.health().ok
        assert source.rig == rig
        assert source.length == len(frames)
        assert all(map(same_frame, source, frames))
        assert source.frame_rate_hz == pytest.approx(30.0, rel=1e-6)


def test_a_bag_without_a_rig_is_refused(tmp_path, ours):
    with pytest.raises(SourceError, match=r"has no rig\.json and no /tactune/rig"):
        McapSource(rewrite(ours, tmp_path / "plain.mcap", without=("/tactune",)))


def test_a_bag_without_tactile_depth_is_refused(tmp_path, ours, rig, frames):
    for without, sentence in (
        ("/tactile/depth/image", r"holds no frame: there is no image on /tactile/depth/image \(its topics are /prox"),
        ("/", r"holds no frame: .* \(it has no messages\)"),
    ):
        with pytest.raises(SourceError, match=sentence):
            McapSource(rewrite(ours, tmp_path / "part.mcap", without=(without,)))


def test_a_topic_of_another_type_is_refused(tmp_path, ours):
    copy = rewrite(ours, tmp_path / "copy.mcap", compression=CompressionType.NONE)
    copy.write_bytes(copy.read_bytes().replace(b"sensor_msgs/msg/Image", b"sensor_msgs/msg/Imago"))
    with pytest.raises(
        SourceError, match=r"has messages of the type sensor_msgs/msg/Imago in cdr, but sensor_msgs/msg/"
    ):
        McapSource(copy)
