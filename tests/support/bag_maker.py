"""Makes RealSense bags with rosbags' writer, message by message as librealsense writes them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

STORE = get_typestore(Stores.ROS1_NOETIC)
STORE.register(
    get_types_from_msg("uint32 fps\nstring encoding\nbool is_recommended\n", "realsense_msgs/msg/StreamInfo")
)
T: Any = STORE.types
SECOND = 1_000_000_000


@dataclass(frozen=True)
class Images:
    """One stream: its images with the seconds at which each was recorded and stamped."""

    images: list[np.ndarray]
    recorded_s: list[float]
    stamps_s: list[float]
    encoding: str
    clock: str | None = "Hardware Clock"
    lens: str = "None"
    D: tuple[float, ...] = (0.0,) * 5
    K: tuple[float, float, float, float] = (20.0, 21.0, 3.5, 2.5)
    pose: tuple[Rotation, tuple[float, float, float]] = (Rotation.identity(), (0.0, 0.0, 0.0))
    tf: str | None = "0"
    size: tuple[int, int] | None = None
    missing_bytes: int = 0


@dataclass(frozen=True)
class Device:
    name: str
    depth: Images | None
    color: Images | None = None
    unit_topic: str | None = "Depth Units"
    unit_m: float = 0.00025
    serial: str = ""
    without: set[str] = field(default_factory=set)


def depth_images(seed: int, times: list[float], **changes: Any) -> Images:
    rng = np.random.default_rng(seed)
    images = [rng.integers(0, 65536, (6, 8)).astype(np.uint16) for _ in times]
    return replace(Images(images, times, times, "mono16"), **changes)


def color_images(seed: int, times: list[float], **changes: Any) -> Images:
    rng = np.random.default_rng(seed)
    images = [rng.integers(0, 256, (10, 12, 3)).astype(np.uint8) for _ in times]
    return replace(Images(images, times, times, "rgb8"), **changes)


class BagMaker:
    """Writes what librealsense writes, message by message in the order of time."""

    def __init__(self) -> None:
        self.messages: list[tuple[int, str, str, Any]] = []

    def add(self, recorded_s: float, topic: str, kind: str, **fields: Any) -> None:
        self.messages.append((round(recorded_s * SECOND), topic, kind, T[kind](**fields)))

    def add_device(self, number: int, device: Device) -> None:
        for key, value in (("Name", device.name), ("Serial Number", device.serial or f"sn{number}")):
            self.add(0, f"/device_{number}/info", "diagnostic_msgs/msg/KeyValue", key=key, value=value)
        if device.unit_topic:
            topic = f"/device_{number}/sensor_0/option/{device.unit_topic}/value"
            self.add(0, topic, "std_msgs/msg/Float32", data=device.unit_m)
        for sensor, (name, stream) in enumerate((("Depth_0", device.depth), ("Color_0", device.color))):
            if stream is not None:
                self.add_stream(f"/device_{number}/sensor_{sensor}/{name}", stream, device.without)

    def add_stream(self, topic: str, stream: Images, without: set[str]) -> None:
        header = lambda stamp: T["std_msgs/msg/Header"](
            seq=0,
            stamp=T["builtin_interfaces/msg/Time"](
                sec=int(round(stamp * SECOND) // SECOND), nanosec=int(round(stamp * SECOND) % SECOND)
            ),
            frame_id="0",
        )
        height, width = stream.size or stream.images[0].shape[:2]
        fx, fy, cx, cy = stream.K
        if "info" not in without:
            self.add(0, f"{topic}/info", "realsense_msgs/msg/StreamInfo", fps=15, encoding="x", is_recommended=False)
        if "camera_info" not in without:
            self.add(
                0,
                f"{topic}/info/camera_info",
                "sensor_msgs/msg/CameraInfo",
                header=header(0.0),
                height=height,
                width=width,
                distortion_model=stream.lens,
                D=np.array(stream.D),
                K=np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1], float),
                R=np.zeros(9),
                P=np.zeros(12),
                binning_x=0,
                binning_y=0,
                roi=T["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False),
            )
        if stream.tf is not None:
            rotation, translation = stream.pose
            self.add(
                0,
                f"{topic}/tf/{stream.tf}",
                "geometry_msgs/msg/Transform",
                translation=T["geometry_msgs/msg/Vector3"](*translation),
                rotation=T["geometry_msgs/msg/Quaternion"](*rotation.as_quat()),
            )
        for image, recorded_s, stamp_s in zip(stream.images, stream.recorded_s, stream.stamps_s, strict=True):
            rows = np.ascontiguousarray(image).view(np.uint8).reshape(image.shape[0], -1)
            self.add(
                recorded_s,
                f"{topic}/image/data",
                "sensor_msgs/msg/Image",
                header=header(stamp_s),
                height=image.shape[0],
                width=image.shape[1],
                encoding=stream.encoding,
                is_bigendian=0,
                step=rows.shape[1],
                data=rows.reshape(-1)[: rows.size - stream.missing_bytes],
            )
            if stream.clock is not None:
                for key, value in (("system_time", "0.0"), ("timestamp_domain", stream.clock)):
                    kind = "diagnostic_msgs/msg/KeyValue"
                    self.add(recorded_s, f"{topic}/image/metadata", kind, key=key, value=value)

    def write(self, path: Path, compress: bool = False) -> Path:
        writer = Writer(path)
        writer.chunk_threshold = 500
        if compress:
            writer.set_compression(Writer.CompressionFormat.LZ4)
        with writer:
            connections: dict[str, Any] = {}
            for recorded_ns, topic, kind, message in sorted(self.messages, key=lambda entry: entry[0]):
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
                writer.write(connections[topic], recorded_ns, STORE.serialize_ros1(message, kind))
        return path


def make_bag(path: Path, *devices: Device, compress: bool = False) -> Path:
    maker = BagMaker()
    for number, device in enumerate(devices):
        maker.add_device(number, device)
    return maker.write(path, compress)


D405 = Device("Intel RealSense D405", depth_images(1, [1.0, 2.0, 3.0]), unit_m=0.0001)
L515 = Device("Intel RealSense L515", depth_images(2, [1.1, 2.1, 2.9]), color_images(3, [1.0, 2.0, 3.0]))
