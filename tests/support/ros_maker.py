"""Makes ROS recordings of two depth cameras as other programs write them; every trait is an argument."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

W, H = 32, 24
OPTICAL = (-0.5, 0.5, -0.5, 0.5)
NONE = (0.0, 0.0, 0.0, 1.0)
#: Both cameras on a rig, 50 mm apart, and a colour camera 14 mm beside the proximity camera: all in optical frames.
CHAIN = (
    ("rig", "a_link", (0, 0, 0), NONE),
    ("a_link", "a_optical", (0, 0, 0), OPTICAL),
    ("rig", "b_link", (0, -0.05, 0), NONE),
    ("b_link", "b_optical", (0, 0, 0), OPTICAL),
    ("a_link", "c_link", (0, 0.014, 0), NONE),
    ("c_link", "c_optical", (0, 0, 0), OPTICAL),
)


@dataclass(frozen=True)
class Stream:
    """One stream of images with its lens."""

    topic: str
    frame: str
    images: list[Any]  # arrays (H, W) or (H, W, 3), bytes of a compressed image
    encoding: str = "16UC1"
    stamps_s: tuple[float, ...] = (0.0, 0.1, 0.2)
    late_s: float = 0.0
    stamped: bool = True
    info: str | None = ""  # beside the images; None: no camera_info
    model: str = "plumb_bob"
    d: tuple[float, ...] = (0.0,) * 5
    k: tuple[float, ...] = (30.0, 0.0, 15.5, 0.0, 30.0, 11.5, 0.0, 0.0, 1.0)
    p: tuple[float, ...] = (0.0,) * 12
    size: tuple[int, int] = (W, H)
    binning: int = 0
    roi: tuple[int, int, int, int] = (0, 0, 0, 0)  # x, y, height, width
    empty_infos: int = 0
    padding: int = 0
    big_endian: bool = False


def depth(topic: str, frame: str, millimetres: int = 400, **changes: Any) -> Stream:
    images = [np.full((H, W), millimetres + n, np.uint16) for n in range(len(changes.get("stamps_s", Stream.stamps_s)))]
    return Stream(topic, frame, changes.pop("images", images), **changes)


def color(topic: str, frame: str, value: int = 90, **changes: Any) -> Stream:
    images = [np.full((H, W, 3), value, np.uint8)] * 3
    return Stream(topic, frame, changes.pop("images", images), **{"encoding": "rgb8", **changes})


def make_recording(
    path: Path, streams: list[Stream], transforms: tuple[Any, ...] = CHAIN, kind: str = "mcap", start_s: int = 1_000
) -> Path:
    """Write a recording and return its path: of ROS 2 the folder.

    Kinds: ``mcap``, ``sqlite``, ``ros1``; with zstd ``messages`` (MCAP), ``sqlite messages``, ``file`` (MCAP, whole).
    """
    ros1 = kind == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    if ros1:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    maker = _Messages(store.types, ros1)
    if ros1:
        writer: Any = Writer1(path)
    else:
        plugin = StoragePlugin.SQLITE3 if kind.startswith("sqlite") else StoragePlugin.MCAP
        writer = Writer(path, version=9, storage_plugin=plugin)
        if kind.endswith("messages") or kind == "file":
            mode = CompressionMode.FILE if kind == "file" else CompressionMode.MESSAGE
            writer.set_compression(mode, CompressionFormat.ZSTD)
    messages: list[tuple[float, str, str, Any]] = []
    if transforms:
        messages.append((0.0, "/tf_static", "tf2_msgs/msg/TFMessage", maker.transforms(transforms)))
    for stream in streams:
        info_topic = f"{stream.topic.removesuffix('/compressed').rpartition('/')[0]}/camera_info"
        kind_name = "CompressedImage" if isinstance(stream.images[0], bytes) else "Image"
        for n, (stamp_s, image) in enumerate(zip(stream.stamps_s, stream.images, strict=True)):
            at = stamp_s + stream.late_s
            header = maker.header(start_s + stamp_s if stream.stamped else 0, stream.frame)
            messages.append((at, stream.topic, f"sensor_msgs/msg/{kind_name}", maker.image(header, stream, image)))
            if stream.info is not None:
                info = maker.info(header, stream, empty=n < stream.empty_infos)
                messages.append((at, stream.info or info_topic, "sensor_msgs/msg/CameraInfo", info))
    with writer:
        known: dict[str, Any] = {}
        for at, topic, name, message in sorted(messages, key=lambda each: each[0]):
            if topic not in known:
                known[topic] = writer.add_connection(topic, name, typestore=store)
            data = store.serialize_ros1(message, name) if ros1 else store.serialize_cdr(message, name)
            writer.write(known[topic], round((start_s + at) * 1e9), data)
    return path


@dataclass(frozen=True)
class _Messages:
    types: Any
    ros1: bool
    frames: list[str] = field(default_factory=list)

    def header(self, time_s: float, frame: str) -> Any:
        stamp = self.types["builtin_interfaces/msg/Time"](*divmod(round(time_s * 1e9), 10**9))
        return self.types["std_msgs/msg/Header"](*((0,) if self.ros1 else ()), stamp, frame)

    def image(self, header: Any, stream: Stream, image: Any) -> Any:
        if isinstance(image, bytes):
            return self.types["sensor_msgs/msg/CompressedImage"](
                header, stream.encoding, np.frombuffer(image, np.uint8)
            )
        rows = np.ascontiguousarray(image.byteswap() if stream.big_endian else image)
        rows = rows.reshape(image.shape[0], -1).view(np.uint8)
        height = H if stream.encoding.startswith("nv") else image.shape[0]
        rows = np.pad(rows, ((0, 0), (0, stream.padding)))
        return self.types["sensor_msgs/msg/Image"](
            header, height, image.shape[1], stream.encoding, int(stream.big_endian), rows.shape[1], rows.ravel()
        )

    def info(self, header: Any, stream: Stream, *, empty: bool) -> Any:
        k, p = np.zeros(9) if empty else np.array(stream.k), np.array(stream.p)
        size, d = (stream.size[1], stream.size[0]), np.array(stream.d, np.float64)
        roi = self.types["sensor_msgs/msg/RegionOfInterest"](*stream.roi, False)
        return self.types["sensor_msgs/msg/CameraInfo"](
            header, *size, stream.model, d, k, np.eye(3).ravel(), p, stream.binning, stream.binning, roi
        )

    def transforms(self, poses: tuple[Any, ...]) -> Any:
        vector, quaternion = self.types["geometry_msgs/msg/Vector3"], self.types["geometry_msgs/msg/Quaternion"]
        found = []
        for parent, child, place, turn in poses:
            pose = self.types["geometry_msgs/msg/Transform"](vector(*map(float, place)), quaternion(*turn))
            found.append(self.types["geometry_msgs/msg/TransformStamped"](self.header(0, parent), child, pose))
        return self.types["tf2_msgs/msg/TFMessage"](found)
